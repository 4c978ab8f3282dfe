"""How many trips may be like recorded ones: limits of the share of copied trips, by scene.

Where ways are short and straight, walkers who copy nothing share trips with the recording by
chance. So the limit is that of walkers who cannot copy: they know a person's start, goal and speed,
but no recorded path. A scene's limit is the largest share among these walkers under the recorded
arrivals, plus a margin.

The shares are measured by `python -m studies trip-limits`, which writes `copied_trips.json`. Run it
again when a scene, a recording or one of these walkers changes.
"""

from functools import cache
from pathlib import Path

import msgspec

from crowdbench.errors import WeightsError
from crowdbench.files import read_struct

PATH = Path(__file__).with_name("copied_trips.json")
MARGIN = 0.05
"""Tolerated excess over these walkers. It is more than two standard errors of the shares, which are
at most 0.02 (on Hotel, with about 200 trips). Who memorises copies far more: nearly all trips."""
_HINT = "Run `python -m studies trip-limits`."


class MeasuredShares(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The content of `copied_trips.json`."""

    command: str
    """The command that writes the file."""
    shares: dict[str, dict[str, float]]
    """Share of copied trips by scene and walker."""


def honest_share(scene: str) -> float:
    """The largest share of copied trips among walkers who cannot copy; 0 if it is not measured.

    Raises:
        WeightsError: the file of shares is missing or broken.
    """
    return max(read_shares().shares.get(scene, {}).values(), default=0.0)


def trip_limit(scene: str) -> float:
    """The largest unflagged share of copied trips on a scene, rounded to 0.1 %.

    Raises:
        WeightsError: see `honest_share`.
    """
    return round(honest_share(scene) + MARGIN, 3)


@cache
def read_shares() -> MeasuredShares:
    """The measured shares.

    Raises:
        WeightsError: their file is missing or broken.
    """
    return read_struct(PATH, MeasuredShares, WeightsError, _HINT)
