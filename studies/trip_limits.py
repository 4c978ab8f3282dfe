"""Measures shares of copied trips of walkers who cannot copy, the limits of `copied trips`."""

from pathlib import Path

from crowdbench.files import write_json
from crowdbench.leaderboard.verification.flags import PATH, MeasuredShares, read_shares
from crowdbench.leaderboard.verification.path_copies import PathCopies
from crowdbench.registry import policy, recording_of, spawn_model
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene

HONEST = ("straight", "social-force")
"""Walkers who cannot copy."""


def measure(scene: Scene) -> dict[str, float]:
    """Roll out the walkers who cannot copy; return the share of copied trips of each.

    Raises:
        RecordingError: the recording is not imported.
    """
    copies = PathCopies(recording_of(scene), scene)
    arrivals = spawn_model("replay", scene)
    found = {}
    for walker in HONEST:
        share = copies.share(rollout(scene, arrivals, policy(walker, scene), seed=0))
        found[walker] = 0.0 if share is None else round(share, 4)
    return found


def write(measured: dict[str, dict[str, float]]) -> Path:
    """Write the shares of these scenes; those of other scenes are kept. Returns the path."""
    shares = (read_shares().shares if PATH.is_file() else {}) | measured
    write_json(
        PATH,
        MeasuredShares(
            command="python -m studies trip-limits", shares=dict(sorted(shares.items()))
        ),
    )
    read_shares.cache_clear()
    return PATH
