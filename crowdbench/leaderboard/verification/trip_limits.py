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
from crowdbench.files import read_struct, write_json
from crowdbench.leaderboard.verification.copying import TripCopies
from crowdbench.registry import policy, recording_of, spawn_model
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene

PATH = Path(__file__).with_name("copied_trips.json")
HONEST = ("straight", "social-force")
"""Walkers who cannot copy. The entry `orca` has the shares of `straight` on its scenes."""
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
    return max(_read().shares.get(scene, {}).values(), default=0.0)


def trip_limit(scene: str) -> float:
    """The largest unflagged share of copied trips on a scene, rounded to 0.1 %.

    Raises:
        WeightsError: see `honest_share`.
    """
    return round(honest_share(scene) + MARGIN, 3)


def measure(scene: Scene) -> dict[str, float]:
    """Roll out the walkers who cannot copy; return the share of copied trips of each.

    Raises:
        RecordingError: the recording is not imported.
    """
    copies = TripCopies(recording_of(scene), scene)
    arrivals = spawn_model("replay", scene)
    found = {}
    for walker in HONEST:
        share = copies.share(rollout(scene, arrivals, policy(walker, scene), seed=0))
        found[walker] = 0.0 if share is None else round(share, 4)
    return found


def write(measured: dict[str, dict[str, float]]) -> Path:
    """Write the shares of these scenes; those of other scenes are kept. Returns the path."""
    shares = (_read().shares if PATH.is_file() else {}) | measured
    write_json(
        PATH,
        MeasuredShares(
            command="python -m studies trip-limits", shares=dict(sorted(shares.items()))
        ),
    )
    _read.cache_clear()
    return PATH


@cache
def _read() -> MeasuredShares:
    return read_struct(PATH, MeasuredShares, WeightsError, _HINT)
