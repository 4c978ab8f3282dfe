"""Finds the parameters of `guided-walker` for the recorded scenes.

Parameters of two kinds: how unsteadily people walk, how bowed their ways are, and how near to walls
they walk is fitted in each place (`crowdbench.scene_building.walker`). What remains, `HABITS`, is
searched in several places at once; it is about how people avoid each other, keep together and come
to their goals. A scene's habits are searched in the other places only, so that its own recording
has no part in them.

A candidate walks in each place under the recorded arrivals, with what was fitted there at the
start. Its value there is its score of interaction, with half of its score of motion, which depends
more on what is fitted, if that is positive (see `crowdbench.run.validation`). Half of the mean of
|log(simulated / recorded)| is subtracted of three quantities that are not scored: how far
companions are apart, how far across their direction, and how often people overlap. Who does not
pass the gate of a place loses 1 there. The search is that of `crowdbench.baselines.social_force`.
Scores of single rollouts are noisy, so the result is the geometric mean of the best candidates.

For each scene, `SCENE/guided-walker.json` is written, with parameters for each split of the
recording, and those of a walker who has never been there: habits and the means of what was fitted
in the other places.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from crowdbench.metrics.interaction import OverlapRate
from crowdbench.policies.guided import ANYWHERE, GuidedWalker, Parameters, fits_file
from crowdbench.run.validation import COMPANIONS, Validation, Validator
from crowdbench.scene import load_scene
from crowdbench.scene_building.walker import fit_walker, fitted

from .social_force import ELITE, Model, Tried, search

PLACES = ("eth-v0", "hotel-v0", "zara1-v0", "gc-v0", "forum-v0")
HORIZON_S = {"gc-v0": 600.0, "forum-v0": 7200.0}
"""Only this time is simulated of long recordings in the search."""
ROLLOUTS = {"eth-v0": 2, "hotel-v0": 2, "zara1-v0": 2}
"""Rollouts of a candidate, where one has few people."""
HABITS = {
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
    tuple(getattr(START, name) for name in HABITS),
    tuple(HABITS.values()),
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

    def walk(self, habits: Sequence[float]) -> Validation:
        """Walk a candidate."""
        parameters = self.local._replace(**dict(zip(HABITS, habits, strict=True)))
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


def walked(places: Sequence[Place], habits: tuple[float, ...]) -> Walked:
    """Walk and judge a candidate."""
    found = [place.walk(habits) for place in places]
    return Walked(habits, float(np.mean([value(of) for of in found])), tuple(found))


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
    habits = _mean([one.parameters for one in best])
    tell("mean of the best: " + row(score(habits)))
    local = _mean([[getattr(place.local, name) for name in LOCAL] for place in places])
    return START._replace(**dict(zip((*HABITS, *LOCAL), habits + local, strict=True)))


def _mean(of: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Geometric means, with three digits, so that what is written is what was tried."""
    return tuple(float(f"{v:.3g}") for v in np.exp(np.log(of).mean(axis=0)))


def row(tried: Walked) -> str:
    """A line of the table."""
    walked = "  ".join(
        f"{of.walk:5.2f} ({of.families['motion']:5.2f} {of.families['interaction']:5.2f})"
        for of in tried.found
    )
    return f"{tried.score:7.3f}  {walked}  {' '.join(f'{v:6.3g}' for v in tried.parameters)}"


def main(arguments: list[str] | None = None) -> None:
    """Search, print a table of the candidates, and write a file for each scene."""
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
    began = time.process_time()

    def tell(text: str) -> None:
        print(text, flush=True)

    places = [Place(name) for name in PLACES]
    for place in places:
        tell(f"fitted on {place.name}: {place.local._asdict()}")
    for without in asked.scenes or [None]:
        others = [place for place in places if place.name != without]
        tell(f"places: {', '.join(place.name for place in others)}")
        tell(f"score  walk (motion, interaction) in each place  {' '.join(HABITS)}")
        found = searched(others, candidates=asked.candidates, seed=asked.seed, tell=tell)
        tell(f"found: {found}")
        if without is not None:
            scene = load_scene(without)
            command = f"python -m crowdbench.baselines.guided --scenes {without}"
            fit_walker(scene, elsewhere=found, command=command, workers=1)
            tell(f"{fits_file(scene)}, {(time.process_time() - began) / 60:.1f} CPU minutes")


if __name__ == "__main__":
    main()
