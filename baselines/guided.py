"""Finds the parameters of `guided-walker` for the recorded scenes.

The parameters `LOCAL` are fitted in each place (`crowdbench.scene_building.walker`): how unsteadily
people walk, how far they turn their ways, and how near to walls they walk. The parameters `SHARED`
are searched in several places at once: how people avoid each other, keep together and come to their
goals. Those for a scene are searched in the other places.

A candidate for `SHARED` walks in each place under the recorded arrivals, with local parameters that
are fitted once, at the start. Its value there is the score of interaction, plus half of the score
of motion if that is positive (see `crowdbench.run.validation`). Half of the mean of
|log(simulated / recorded)| is subtracted, for three quantities that are not scored: the distance of
companions, their distance across the direction of walking, and how often people overlap. If the
candidate does not pass the gate of the place, 1 is subtracted. The search is that of
`crowdbench.baselines.social_force`. Scores of single rollouts are noisy, so the result is the
geometric mean of the best candidates.

For each scene, `guided-walker.json` is written to its folder: parameters for each split of the
recording, and those of a walker who has never been there (the searched ones, and medians of the
local ones of the other places).
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from crowdbench.errors import CrowdbenchError
from crowdbench.metrics.interaction import OverlapRate
from crowdbench.policies.guided import ANYWHERE, FILE, GuidedWalker, Parameters
from crowdbench.run.validation import COMPANIONS, Validation, Validator
from crowdbench.scene import load_scene
from crowdbench.scene_building.walker import fit_walker, fitted

from .social_force import ELITE, Model, Tried, search

PLACES = ("eth-v0", "hotel-v0", "zara1-v0", "gc-v0", "forum-v0")
HORIZON_S = {"gc-v0": 600.0, "forum-v0": 7200.0}
"""Only this time is simulated of long recordings in the search."""
ROLLOUTS = {"eth-v0": 2, "hotel-v0": 2, "zara1-v0": 2}
"""Rollouts of a candidate, where one has few people."""
SHARED = {
    "avoid": (20.0, 80.0),
    "avoid_m": (0.25, 0.7),
    "avoid_s": (1.5, 6.0),
    "room": (4.0, 24.0),
    "keep": (2.0, 8.0),
    "abreast": (1.0, 6.0),
    "beside": (1.0, 6.0),
    "beside_m": (0.75, 1.15),
    "delay": (0.4, 2.0),
    "miss": (2.0, 10.0),
    "plan": (2.5, 6.0),
}
"""From about where to where each of these parameters is tried."""
LOCAL = ("speed_mps", "side_mps", "bow", "wall")
"""Those that are fitted in each place."""
START = ANYWHERE._replace(
    speed_mps=0.16, side_mps=0.16, bow=0.08, avoid=40.0, avoid_m=0.42, avoid_s=3.2, room=10.0,
    keep=4.0, abreast=2.0, beside=3.0, beside_m=0.9, delay=0.9, miss=5.0, wall=16.0, plan=4.0,
)  # fmt: skip
"""The first candidate, and where fits in places begin."""
MODEL = Model(
    GuidedWalker,
    Parameters,
    tuple(getattr(START, name) for name in SHARED),
    tuple(SHARED.values()),
)


@dataclass(frozen=True)
class Walked(Tried):
    """A candidate that has walked in several places."""

    found: tuple[Validation, ...]
    """Its results in each place."""


class Place:
    """A place in which candidates walk, with what is fitted there."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._validator = Validator(name, horizon_s=HORIZON_S.get(name))
        self.local = fitted(self._validator, START)

    def walk(self, shared: Sequence[float]) -> Validation:
        """Walk a candidate."""
        parameters = self.local._replace(**dict(zip(SHARED, shared, strict=True)))
        return self._validator.validate(
            GuidedWalker(parameters), rollouts=ROLLOUTS.get(self.name, 1)
        )


def value(found: Validation) -> float:
    """What is maximised in a place."""
    walked = found.families["interaction"] + max(0.0, found.families["motion"]) / 2
    ratios = [
        found.ratios[name] for name in (*COMPANIONS, OverlapRate.name) if name in found.ratios
    ]
    apart = float(np.mean(np.abs(np.log(np.maximum(ratios, 0.05))))) if ratios else 0.0
    return walked - apart / 2 - (not found.passes)


def walked(places: Sequence[Place], shared: tuple[float, ...]) -> Walked:
    """Walk and judge a candidate."""
    found = [place.walk(shared) for place in places]
    return Walked(shared, float(np.mean([value(of) for of in found])), tuple(found))


def searched(
    places: Sequence[Place], *, candidates: int, seed: int, tell: Callable[[str], None]
) -> Parameters:
    """The parameters for a place that is not among these."""
    score = partial(walked, places)
    tried = []
    for one in search(MODEL, score, candidates=candidates, seed=seed):
        tried.append(one)
        tell(row(one))
    best = sorted(tried, key=lambda one: -one.score)[: 2 * ELITE]
    shared = _mean([one.parameters for one in best])
    tell("mean of the best: " + row(score(shared)))
    local = _median([[getattr(place.local, name) for name in LOCAL] for place in places])
    return START._replace(**dict(zip((*SHARED, *LOCAL), shared + local, strict=True)))


def _mean(of: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Geometric means, with three digits, so that what is written is what was tried."""
    return tuple(float(f"{v:.3g}") for v in np.exp(np.log(of).mean(axis=0)))


def _median(of: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Medians: the noise of one place's tracker must not decide how people walk elsewhere."""
    return tuple(float(f"{v:.3g}") for v in np.median(of, axis=0))


def row(tried: Walked) -> str:
    """A line of the table."""
    walked = "  ".join(
        f"{of.walk:5.2f} ({of.families['motion']:5.2f} {of.families['interaction']:5.2f})"
        for of in tried.found
    )
    return f"{tried.score:7.3f}  {walked}  {' '.join(f'{v:6.3g}' for v in tried.parameters)}"


def main(arguments: list[str] | None = None) -> int:
    """Search, print a table of the candidates, and write a file for each scene; the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m crowdbench.baselines.guided",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--scenes",
        nargs="*",
        choices=PLACES,
        default=PLACES,
        help="default: all; with none, parameters for any other place are searched and printed",
    )
    parser.add_argument(
        "--candidates", type=int, default=80, metavar="N", help="default: %(default)s"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="default: %(default)s")
    asked = parser.parse_args(arguments)
    if asked.candidates < 2 * ELITE:
        parser.error(f"--candidates: expected {2 * ELITE} or more")
    try:
        find(asked.scenes, candidates=asked.candidates, seed=asked.seed)
    except CrowdbenchError as error:
        print(f"crowdbench.baselines.guided: {error}", file=sys.stderr)
        return 2
    return 0


def find(scenes: Sequence[str], *, candidates: int, seed: int) -> None:
    """Find the parameters for these scenes, or for any other place if there are none."""
    began = time.process_time()

    def tell(text: str) -> None:
        print(text, flush=True)

    places = [Place(name) for name in PLACES]
    for place in places:
        tell(f"fitted on {place.name}: {place.local._asdict()}")
    left_out: Sequence[str | None] = scenes or [None]
    for without in left_out:
        others = [place for place in places if place.name != without]
        tell(f"places: {', '.join(place.name for place in others)}")
        tell(f"score  walk (motion, interaction) in each place  {' '.join(SHARED)}")
        found = searched(others, candidates=candidates, seed=seed, tell=tell)
        tell(f"found: {found}")
        if without is not None:
            scene = load_scene(without)
            command = f"python -m crowdbench.baselines.guided --scenes {without}"
            fit_walker(scene, elsewhere=found, command=command, workers=1)
            tell(f"{scene.folder / FILE}, {(time.process_time() - began) / 60:.1f} CPU minutes")


if __name__ == "__main__":
    sys.exit(main())
