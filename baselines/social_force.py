"""Searches the parameters of `social-force` or `speed-model`.

A candidate is scored by how it walks and by the exam; people have bodies with a radius of 0.15 m in
both. Walking is the mean over ETH and Zara, on the training blocks of fold 0 (see
`crowdbench.run.validation`), of the *walk* score plus a tenth of the mean of motion and
interaction. From this, 1 is subtracted for each test of `TESTS` that is not passed, so a candidate
that passes all is always preferred. The exam ends at the first test that fails; the share of its
limits that are kept counts as a part of a test.

The search is the cross-entropy method (Rubinstein 1999, Methodology and Computing in Applied
Probability 1, 127) in the logarithms of the parameters: each generation of 10 is drawn from
independent Gaussians, which are then fitted to the best four of all candidates so far. The first
Gaussians cover the ranges in `MODELS`; the first candidate has the published parameters.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np

from crowdbench.exam import TRIALS
from crowdbench.exam.examine import BODY_RADIUS_M
from crowdbench.exam.results import result_of
from crowdbench.exam.trial import Run
from crowdbench.files import write_json
from crowdbench.policies import Policy, SocialForce, SpeedModel, social_force, speed_model
from crowdbench.run.validation import Validator
from crowdbench.scene import Scene, load_scene

SCENES = ("eth-v0", "zara1-v0")
SPLIT = "fold0"
GENERATION, ELITE = 10, 4
NARROWEST = 0.15
"""Least standard deviation of the logarithms, which keeps a generation from being all alike."""
TESTS = (
    *("rimea-1", "door", "rimea-6", "rimea-4", "rimea-12"),
    *("rimea-15", "rimea-9", "counterflow"),
)
"""Tests of the exam in this order; dear ones come late, the hardest one last."""


class Model(NamedTuple):
    """A policy whose parameters are searched."""

    policy: Callable[..., Policy]
    parameters: Callable[..., tuple[float, ...]]
    """The named tuple of its parameters."""
    published: tuple[float, ...]
    ranges: tuple[tuple[float, float], ...]
    """From about where to where each parameter is tried."""


MODELS = {
    SocialForce.name: Model(
        SocialForce,
        social_force.Forces,
        social_force.PUBLISHED,
        ((0.2, 1.0), (0.1, 3.0), (0.1, 0.8), (0.1, 1.0), (0.3, 3.0), (0.05, 0.2), (0.02, 0.5)),
    ),
    SpeedModel.name: Model(
        SpeedModel,
        speed_model.Gaps,
        speed_model.PUBLISHED,
        ((0.2, 1.2), (0.1, 0.4), (0.1, 8.0), (0.1, 2.0), (0.1, 5.0), (0.02, 0.3)),
    ),
}


@dataclass(frozen=True)
class Tried:
    """A candidate and its score."""

    parameters: tuple[float, ...]
    score: float
    """What is maximised."""


Candidate = TypeVar("Candidate", bound=Tried)


@dataclass(frozen=True)
class Examined(Tried):
    """A candidate that has walked and taken the exam."""

    walk: tuple[float, ...]
    """*walk* on each scene."""
    motion: tuple[float, ...]
    interaction: tuple[float, ...]
    tests: float
    """Number of tests passed, and the share of limits kept in the first that was not."""


class Judge:
    """Scores candidates of a model; straight walkers, the zero of scores, are walked once."""

    def __init__(self, model: Model) -> None:
        self.model = model
        places = [_with_bodies(load_scene(scene)) for scene in SCENES]
        self._place = places[0]
        self._validators = [Validator(place, SPLIT) for place in places]

    def score(self, parameters: tuple[float, ...]) -> Examined:
        """Walk and judge a candidate."""
        policy = self.model.policy(self.model.parameters(*parameters))
        found = [validator.validate(policy) for validator in self._validators]
        walked = [of.walk + 0.1 * np.mean(list(of.families.values())) for of in found]
        tests = self._examine(policy)
        return Examined(
            parameters=parameters,
            score=float(np.mean(walked)) - (len(TESTS) - tests),
            walk=tuple(of.walk for of in found),
            motion=tuple(of.families["motion"] for of in found),
            interaction=tuple(of.families["interaction"] for of in found),
            tests=tests,
        )

    def _examine(self, policy: Policy) -> float:
        for passed, name in enumerate(TESTS):
            trial = TRIALS[name]
            values = [trial.run(Run(self._place, policy, seed)) for seed in range(trial.seeds)]
            result = result_of(trial, values)
            if not result.passed:
                held = [of.holds for of in result.measured if of.limit is not None]
                return passed + sum(map(bool, held)) / (len(held) + 1)
        return len(TESTS)


def search(
    model: Model, score: Callable[[tuple[float, ...]], Candidate], *, candidates: int, seed: int
) -> Iterator[Candidate]:
    """Score so many candidates; the same seed gives the same ones."""
    rng = np.random.default_rng(seed)
    low, high = np.log(model.ranges).T
    mean, std = (low + high) / 2, (high - low) / 3
    tried: list[Candidate] = []
    while len(tried) < candidates:
        for _ in range(min(GENERATION, candidates - len(tried))):
            drawn = np.exp(np.clip(rng.normal(mean, std), low, high))
            # Three digits, so that what is printed is what was tried.
            rounded = tuple(float(f"{v:.3g}") for v in drawn)
            tried.append(score(rounded if tried else model.published))
            yield tried[-1]
        best = sorted(tried, key=lambda one: -one.score)[:ELITE]
        logs = np.log([one.parameters for one in best])
        mean, std = logs.mean(axis=0), np.maximum(logs.std(axis=0), NARROWEST)


def _with_bodies(scene: Scene) -> Scene:
    motion = msgspec.structs.replace(scene.motion, body_radius_m=BODY_RADIUS_M)
    return replace(scene, motion=motion)


def row(tried: Examined) -> str:
    """A line of the table."""
    walked = "  ".join(
        f"{w:5.2f} ({m:5.2f} {i:5.2f})"
        for w, m, i in zip(tried.walk, tried.motion, tried.interaction, strict=True)
    )
    parameters = " ".join(f"{v:7.3g}" for v in tried.parameters)
    tests = f"{tried.tests:5.2f}/{len(TESTS)}"
    return f"{tried.score:7.3f}  {walked}  {tests}  {parameters}"


def main(arguments: list[str] | None = None) -> None:
    """Search, print a table of the candidates, and write the best one to a file."""
    parser = argparse.ArgumentParser(
        prog="python -m crowdbench.baselines.social_force",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--policy", choices=list(MODELS), default=SocialForce.name, help="default: %(default)s"
    )
    parser.add_argument(
        "--candidates", type=int, default=40, metavar="N", help="default: %(default)s"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="default: %(default)s")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="default: results/POLICY-parameters.json"
    )
    asked = parser.parse_args(arguments)
    out = asked.out or Path("results") / f"{asked.policy}-parameters.json"
    out.parent.mkdir(parents=True, exist_ok=True)
    model = MODELS[asked.policy]
    names = model.parameters._fields  # type: ignore[attr-defined]
    began = time.process_time()
    scenes = "  ".join(f"{scene}: walk (motion, interaction)" for scene in SCENES)
    print(f"score  {scenes}  tests  {' '.join(names)}", flush=True)
    best: Examined | None = None
    judge = Judge(model)
    for one in search(model, judge.score, candidates=asked.candidates, seed=asked.seed):
        print(row(one), flush=True)
        if best is None or one.score > best.score:
            best = one
    if best is None:
        parser.error("--candidates: expected 1 or more")
    found = dict(zip(names, best.parameters, strict=True))
    write_json(out, {"policy": asked.policy, "parameters": found, "score": best.score})
    print(f"best:\n{row(best)}\n{out}, {(time.process_time() - began) / 60:.1f} CPU minutes")


if __name__ == "__main__":
    main()
