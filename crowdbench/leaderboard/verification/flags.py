"""Flags: warnings that readers of an entry should know. They change no score.

Some trips of walkers who copy nothing follow a recorded path by chance, or because people had
little choice. So the limit of copied trips is that of walkers who cannot copy: they know a person's
start, goal and speed, but no recorded path. A scene's limit is the largest share among these
walkers under the recorded arrivals, plus a margin. `python -m studies copy-limits` measures the
shares and writes `copy_limits.json`. Run it again when a scene, a recording or one of these
walkers changes.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from crowdbench.errors import WeightsError
from crowdbench.files import read_struct
from crowdbench.leaderboard.verification.entry import Copy, Flag, What
from crowdbench.scoring.energy import FitEnergies
from crowdbench.scoring.score import Score

SPREAD = 0.5
"""Smallest unflagged spread of rollouts, as a share of the true process's spread."""
MARGIN = 0.05
"""Tolerated excess of the copy index of arrivals over models that cannot copy. Good models, which
know groups and busy times, come up to 0.02 closer to the recording without copying."""
TRIP_MARGIN = 0.05
"""Tolerated excess of copied trips. It is more than two standard errors of the measured shares,
which are at most 0.02 (on Hotel, with about 200 trips). Who memorises copies nearly all trips, and
who disguises this by other means than small warps in time at least 0.3 of them."""
PATH = Path(__file__).with_name("copy_limits.json")


class MeasuredLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The content of `copy_limits.json`."""

    command: str
    """The command that writes the file."""
    shares: dict[str, dict[str, float]]
    """Share of copied trips by scene and walker."""
    arrivals: dict[str, list[float | None]]
    """By scene, `copying.independent_limits`."""


@cache
def read_limits() -> MeasuredLimits:
    """The measured shares and limits.

    Raises:
        WeightsError: their file is missing or broken.
    """
    return read_struct(PATH, MeasuredLimits, WeightsError, "Run `python -m studies copy-limits`.")


def honest_share(scene: str) -> float:
    """The largest share of copied trips among walkers who cannot copy; 0 if it is not measured.

    Raises:
        WeightsError: the file of limits is missing or broken.
    """
    return max(read_limits().shares.get(scene, {}).values(), default=0.0)


def trip_limit(scene: str) -> float:
    """The largest unflagged share of copied trips on a scene, rounded to 0.1 %.

    Raises:
        WeightsError: see `honest_share`.
    """
    return round(honest_share(scene) + TRIP_MARGIN, 3)


def flags_of(scene: str, score: Score | None, even: float | None, copy: Copy) -> list[Flag]:
    """The flags of an entry on one scene; `even` is the result of `evenness`.

    Raises:
        WeightsError: see `trip_limit`.
    """
    found: list[tuple[What, float, float, str]] = []
    limit = 1.0 if score is None else 1 + 2 * float(score.resampled.std())
    if score is not None and score.value > limit:
        text = (
            f"the score is {score.value:.2f}. This exceeds {limit:.2f}, which is two standard "
            "errors above 1, the expected score of a perfect model."
        )
        found.append(("too good", score.value, limit, text))
    if even is not None and even < SPREAD:
        text = (
            f"the rollouts vary {even:.2f} times as much as expected of a perfect model (arrivals "
            f"and the number of people present). Values below {SPREAD:g} are flagged."
        )
        found.append(("too even", even, SPREAD, text))
    limit = (copy.arrivals_limit or 0.0) + MARGIN
    if copy.arrivals_limit is not None and copy.arrivals is not None and copy.arrivals > limit:
        text = (
            f"time windows of the arrivals correlate at {copy.arrivals:.2f} (median) with the most "
            "similar window of the recording. For models that cannot copy, 99 % of crowds are "
            f"below {copy.arrivals_limit:.2f}."
        )
        found.append(("copied arrivals", copy.arrivals, limit, text))
    else:
        found += _moved(copy)
    limit = trip_limit(scene)
    # Compared as they are shown: no value is flagged that looks equal to the limit.
    if copy.trips is not None and round(copy.trips, 3) > limit:
        text = (
            f"{100 * copy.trips:.1f} % of the trips follow the path that the same person walked in "
            "the recording, apart from bows, mirroring and delays. Walkers who cannot copy have up "
            f"to {100 * honest_share(scene):.1f} %; values above {100 * limit:.1f} % are flagged."
        )
        found.append(("copied trips", copy.trips, limit, text))
    return [
        Flag(what=what, scene=scene, value=value, limit=limit, text=f"On {scene}, {text}")
        for what, value, limit, text in found
    ]


def moved_limit(independent: float) -> float:
    """The largest unflagged copy index in bins of seconds, by that of models that cannot copy.

    It is a third of the way from there to 1.
    Good models, which know busy times, come nearer to the recording than those that cannot copy.
    """
    return round((1 + 2 * independent) / 3, 3)


def _moved(copy: Copy) -> list[tuple[What, float, float, str]]:
    """The clearest sign of recorded arrivals that were moved by some seconds, if there is one."""
    found: list[tuple[What, float, float, str]] = []
    for each in copy.coarse:
        if each.index is None or each.limit is None or each.index <= moved_limit(each.limit):
            continue
        limit = moved_limit(each.limit)
        text = (
            f"the arrivals, counted in bins of {each.bin_s:g} s, correlate at {each.index:.2f} "
            "(median over time windows) with the most similar window of the recording, as if "
            "recorded arrivals had been moved by some seconds. For models that cannot copy, 99 % "
            f"of crowds are below {each.limit:.2f}; values above {limit:.2f} are flagged."
        )
        found.append(("copied arrivals", each.index, limit, text))
    return sorted(found, key=lambda flag: flag[2] - flag[1])[:1]


def evenness(
    energies: Mapping[str, Mapping[str, FitEnergies]], floors: Mapping[str, float]
) -> float | None:
    """Spread of the rollouts of a fit, relative to the spread expected of the true process.

    This is ½ mean d(X_k, X_l) over pairs of rollouts, divided by the metric's noise floor (see
    `crowdbench.scoring.energy`), and averaged over splits, fits and then metrics. `energies` are by
    metric and split, `floors` by metric. None if no metric has a positive noise floor.
    """
    ratios = [
        float(np.mean([e.spread.mean() for e in splits.values()])) / floors[name]
        for name, splits in energies.items()
        if floors.get(name, 0.0) > 0 and splits
    ]
    return float(np.mean(ratios)) if ratios else None
