"""Flags: what a reader should know before believing an entry. They change no score."""

from collections.abc import Mapping

import numpy as np

from crowdbench.leaderboard.verification.entry import Copy, Flag
from crowdbench.scoring.energy import FitEnergies
from crowdbench.scoring.score import Score

SPREAD = 0.5
"""Rollouts that differ by less than this share of what the true process's would."""
MARGIN = 0.05
"""By which copied arrivals exceed what cannot copy: a good model, which knows of groups and of busy
times, comes up to 0.02 nearer to the recording than models without a memory do."""
COPIED_LIVES = 0.05


def flags_of(scene: str, score: Score | None, even: float | None, copy: Copy) -> list[Flag]:
    """The flags of an entry on one scene; `even` is what `evenness` found."""
    checks = (
        _too_good(scene, score),
        _too_even(scene, even),
        _copied_arrivals(scene, copy),
        _copied_lives(scene, copy),
    )
    return [flag for flag in checks if flag is not None]


def _too_good(scene: str, score: Score | None) -> Flag | None:
    if score is None:
        return None
    limit = 1 + 2 * float(score.resampled.std())
    if score.value <= limit:
        return None
    text = (
        f"On {scene} it scores {score.value:.2f}, more than two standard errors above 1 "
        f"({limit:.2f}), which the process that made the recording would get on average."
    )
    return Flag(what="too good", scene=scene, value=score.value, limit=limit, text=text)


def _too_even(scene: str, even: float | None) -> Flag | None:
    if even is None or even >= SPREAD:
        return None
    text = (
        f"On {scene} its rollouts differ from each other {even:.2f} times as much as those of the "
        f"true process would, in when people enter and how many are there; less than {SPREAD:g} is "
        f"too even."
    )
    return Flag(what="too even", scene=scene, value=even, limit=SPREAD, text=text)


def _copied_arrivals(scene: str, copy: Copy) -> Flag | None:
    if copy.arrivals is None or copy.arrivals_limit is None:
        return None
    limit = copy.arrivals_limit + MARGIN
    if copy.arrivals <= limit:
        return None
    text = (
        f"On {scene} stretches of its arrivals correlate at {copy.arrivals:.2f} (median) with some "
        f"stretch of the recording; of crowds that cannot copy 99 % stay below "
        f"{copy.arrivals_limit:.2f}."
    )
    return Flag(what="copied arrivals", scene=scene, value=copy.arrivals, limit=limit, text=text)


def _copied_lives(scene: str, copy: Copy) -> Flag | None:
    if copy.lives is None or copy.lives <= COPIED_LIVES:
        return None
    text = (
        f"On {scene} {100 * copy.lives:.0f} % of its lives stay within 0.1 m of a recorded one "
        f"from beginning to end; more than {100 * COPIED_LIVES:g} % are too many."
    )
    return Flag(what="copied lives", scene=scene, value=copy.lives, limit=COPIED_LIVES, text=text)


def evenness(
    energies: Mapping[str, Mapping[str, FitEnergies]], floors: Mapping[str, float]
) -> float | None:
    """How much rollouts of a fit differ, relative to what the true process's would.

    ½ mean d(X_k, X_l) of two rollouts over F of the same metric (see `crowdbench.scoring.energy`),
    the mean over parts, fits and then metrics. `energies` are by metric and part.
    """
    ratios = [
        float(np.mean([e.spread.mean() for e in parts.values()])) / floors[name]
        for name, parts in energies.items()
        if floors.get(name, 0.0) > 0 and parts
    ]
    return float(np.mean(ratios)) if ratios else None
