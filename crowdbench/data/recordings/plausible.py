"""Whether a recording is one of walking people, from where they enter to where they leave."""

from pathlib import Path

import numpy as np

from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError

_SPEEDS_MPS = (0.2, 3.0)
"""Plausible range of the median of people's mean speeds; outside it the units are wrong."""
_FAST_MPS = 2.0
"""People who walk are rarely faster in the median; a note says so."""
_FASTEST_MPS = 5.0
"""The 95th percentile of the speeds from row to row is slower."""
_LONGEST_M = 300.0
_FRAGMENT_S = 15.0
"""Fragments for the prediction of trajectories are not longer; those of TrajNet have 8 s."""
_FEWEST_LIVES = 10
"""Number of persons from which equal lengths are no chance."""


def check_lives(crowd: Trajectories, path: Path) -> None:
    """Raise if all persons have as many rows, and few: then they are fragments of persons."""
    rows = np.diff(crowd.offsets)
    short = rows[0] * crowd.dt_s <= _FRAGMENT_S
    if short and len(rows) >= _FEWEST_LIVES and rows.min() == rows.max():
        raise RecordingError(
            path,
            got=f"{len(rows)} persons with {rows[0]} rows each",
            expected="persons from where they enter to where they leave",
            hint="These are fragments for the prediction of trajectories; use the whole ones.",
        )


def check_motion(crowd: Trajectories, path: Path, *, may_jam: bool) -> str:
    """Raise if speeds or distances are implausible; returns a warning, or nothing.

    A slow crowd is accepted if it `may_jam`.
    """
    speeds = crowd.mean_speeds()
    size = float(np.ptp(crowd.xy.astype(np.float64), axis=0).max())
    hint = "Positions must be in metres, not in pixels or centimetres (--scale), and --dt-s must "
    hint += "be the time between consecutive rows of a person."
    if np.isnan(speeds).all():
        got = "no person with more than one row"
        raise RecordingError(path, got=got, expected="people with two rows or more", hint=hint)
    median = float(np.nanmedian(speeds))
    slow = median < _SPEEDS_MPS[0]
    if median > _SPEEDS_MPS[1] or (slow and not may_jam):
        got = f"a median walking speed of {median:.3g} m/s"
        expected = f"{_SPEEDS_MPS[0]:g} to {_SPEEDS_MPS[1]:g} m/s"
        if slow:
            hint += " A jam is accepted from a file that states its rate and unit, such as "
            hint += "JuPedSim's."
        raise RecordingError(path, got=got, expected=expected, hint=hint)
    steps = np.linalg.norm(np.diff(crowd.xy.astype(np.float64), axis=0), axis=1)
    steps = steps[np.diff(crowd.row_person()) == 0] / crowd.dt_s
    if len(steps) and (fast := float(np.percentile(steps, 95))) > _FASTEST_MPS:
        raise RecordingError(
            path,
            got=f"5 % of the speeds from row to row above {fast:.3g} m/s",
            expected=f"less than {_FASTEST_MPS:g} m/s",
            hint=f"{hint} Numbers of persons may be given to others, or columns be swapped.",
        )
    if size > _LONGEST_M:
        raise RecordingError(
            path,
            got=f"positions {size:.0f} m apart",
            expected=f"a place of at most {_LONGEST_M:g} m",
            hint=f"{hint} Remove outliers, or restrict the recording to a part of the place.",
        )
    if slow:
        return f"a median of {median:.2f} m/s is slow: a jam, or wrong units"
    if median > _FAST_MPS:
        return f"a median of {median:.2f} m/s is fast for people: check units and --dt-s"
    return ""
