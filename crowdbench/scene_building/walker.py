"""Fits the local parameters of the policy `guided-walker`: noise of velocities, turns and walls.

People avoid each other and keep together in much the same way everywhere. Places differ in how
unsteadily people walk, how far from the straight way, and how near to walls. So people walk under
the recorded arrivals, and are compared with the recording in the training blocks of a split.
"""

from crowdbench.data.blocks import SPLITS
from crowdbench.files import write_json
from crowdbench.metrics.interaction import WallClearance
from crowdbench.metrics.motion import Acceleration, Deviation, Turning
from crowdbench.policies.guided import ANYWHERE, FILE, Fits, GuidedWalker, Parameters
from crowdbench.progress import tell
from crowdbench.run.executor import call_each
from crowdbench.run.validation import Validator
from crowdbench.scene import Scene

ROUNDS = 6
"""Rollouts in which the noise and the turns of ways are adjusted, because one changes the other."""
SPEED_MPS, BOW = (0.02, 0.6), (0.01, 0.1)
"""Smallest and largest value."""
STEP = 2.0
"""Largest factor by which a round changes a value."""
WALLS = (4.0, 8.0, 16.0, 32.0, 64.0)


def fit_walker(scene: Scene, *, elsewhere: Parameters, command: str, workers: int) -> None:
    """Fit the parameters for each split of a scene's recording; write `guided-walker.json`.

    Args:
        scene: a scene with areas, reference statistics and scored metrics.
        elsewhere: parameters for a place where nobody has been.
        command: the command that does this, for the file.
        workers: number of processes.
    """
    splits: dict[str, dict[str, float]] = {}
    tell("walker", 0, len(SPLITS))
    for at, found in call_each(_fitted, [(scene, split, elsewhere) for split in SPLITS], workers):
        splits[SPLITS[at]] = found._asdict()
        tell("walker", len(splits), len(SPLITS))
    fits = Fits(command=command, elsewhere=elsewhere._asdict(), splits=splits)
    write_json(scene.folder / FILE, fits)


def _fitted(scene: Scene, split: str, start: Parameters) -> Parameters:
    return fitted(Validator(scene, split), start)


def fitted(validator: Validator, start: Parameters = ANYWHERE) -> Parameters:
    """Parameters with which people accelerate and deviate as much as recorded ones, on average.

    Accelerations along the way follow from `speed_mps`, those across it from `side_mps`, and
    deviations from the straight way mostly from `bow`. Of `WALLS`, the cost is chosen that gives
    the best score of wall clearance, if the place has walls or bounds near people.
    """
    found = _steadied(validator, start)
    if not validator.judges(WallClearance.name):
        return found

    def score(wall: float) -> float:
        one = validator.validate(GuidedWalker(found._replace(wall=wall)))
        return one.scores[WallClearance.name]

    return _steadied(validator, found._replace(wall=max(WALLS, key=score)))


def _steadied(validator: Validator, start: Parameters) -> Parameters:
    found = start
    for _ in range(ROUNDS):
        ratios = validator.validate(GuidedWalker(found)).ratios
        along, across, away = (
            _factor(ratios.get(metric.name, 1.0)) for metric in (Acceleration, Turning, Deviation)
        )
        found = found._replace(
            speed_mps=_within(SPEED_MPS, along * found.speed_mps),
            side_mps=_within(SPEED_MPS, across * found.side_mps),
            bow=_within(BOW, away * found.bow),
        )
    return found


def _factor(ratio: float) -> float:
    """By how much to multiply a value whose effect is too large by `ratio`."""
    return min(STEP, max(1 / STEP, 1 / max(ratio, 1 / STEP)))


def _within(limits: tuple[float, float], value: float) -> float:
    return float(f"{min(limits[1], max(limits[0], value)):.3g}")
