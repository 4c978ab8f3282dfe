"""Flags: warnings that readers of an entry should know. They change no score."""

from collections.abc import Mapping

import msgspec
import numpy as np

from crowdbench.leaderboard.verification.entry import Copy, Entry, Flag
from crowdbench.leaderboard.verification.trip_limits import honest_share, trip_limit
from crowdbench.scoring.energy import FitEnergies
from crowdbench.scoring.score import Score

SPREAD = 0.5
"""Smallest unflagged spread of rollouts, as a share of the true process's spread."""
MARGIN = 0.05
"""Tolerated excess of the copy index over models that cannot copy. Good models, which know groups
and busy times, come up to 0.02 closer to the recording without copying."""


def flags_of(scene: str, score: Score | None, even: float | None, copy: Copy) -> list[Flag]:
    """The flags of an entry on one scene; `even` is the result of `evenness`."""
    checks = (
        _too_good(scene, score),
        _too_even(scene, even),
        _copied_arrivals(scene, copy),
        _copied_trips(scene, copy),
    )
    return [flag for flag in checks if flag is not None]


def _too_good(scene: str, score: Score | None) -> Flag | None:
    if score is None:
        return None
    limit = 1 + 2 * float(score.resampled.std())
    if score.value <= limit:
        return None
    text = (
        f"On {scene}, the score is {score.value:.2f}. This exceeds {limit:.2f}, which is two "
        f"standard errors above 1, the expected score of a perfect model."
    )
    return Flag(what="too good", scene=scene, value=score.value, limit=limit, text=text)


def _too_even(scene: str, even: float | None) -> Flag | None:
    if even is None or even >= SPREAD:
        return None
    text = (
        f"On {scene}, the rollouts vary {even:.2f} times as much as expected of a perfect model "
        f"(arrivals and the number of people present). Values below {SPREAD:g} are flagged."
    )
    return Flag(what="too even", scene=scene, value=even, limit=SPREAD, text=text)


def _copied_arrivals(scene: str, copy: Copy) -> Flag | None:
    if copy.arrivals is None or copy.arrivals_limit is None:
        return None
    limit = copy.arrivals_limit + MARGIN
    if copy.arrivals <= limit:
        return None
    text = (
        f"On {scene}, time windows of the arrivals correlate at {copy.arrivals:.2f} (median) with "
        f"the most similar window of the recording. For models that cannot copy, 99 % of crowds "
        f"are below {copy.arrivals_limit:.2f}."
    )
    return Flag(what="copied arrivals", scene=scene, value=copy.arrivals, limit=limit, text=text)


def with_current_limits(entry: Entry) -> Entry:
    """The entry with its flags of copied trips by the present limits, which may be measured anew.

    Other flags are kept. Raises WeightsError: see `trip_limit`.
    """
    flags = [flag for flag in entry.flags if flag.what != "copied trips"]
    found = (_copied_trips(name, scene.copy) for name, scene in entry.scenes.items())
    flags += [flag for flag in found if flag is not None]
    order = entry.declared.scenes
    flags.sort(key=lambda flag: order.index(flag.scene))  # as verification does
    return msgspec.structs.replace(entry, flags=flags)


def _copied_trips(scene: str, copy: Copy) -> Flag | None:
    limit = trip_limit(scene)
    # Compared as they are shown: no value is flagged that looks equal to the limit.
    if copy.trips is None or round(copy.trips, 3) <= limit:
        return None
    text = (
        f"On {scene}, {100 * copy.trips:.1f} % of the trips stay within 0.1 m of a recorded trip "
        f"from beginning to end. Walkers who cannot copy have up to "
        f"{100 * honest_share(scene):.1f} %; values above {100 * limit:.1f} % are flagged."
    )
    return Flag(what="copied trips", scene=scene, value=copy.trips, limit=limit, text=text)


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
