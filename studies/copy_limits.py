"""Measures by how much models that cannot copy are like the recording: the limits of flags."""

from pathlib import Path

from crowdbench.files import write_json
from crowdbench.leaderboard.verification.flags import PATH, MeasuredLimits, read_limits
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


def write(shares: dict[str, dict[str, float]], arrivals: dict[str, list[float | None]]) -> Path:
    """Write the limits of these scenes; those of other scenes are kept. Returns the path."""
    known = read_limits() if PATH.is_file() else None
    limits = MeasuredLimits(
        command="python -m studies copy-limits",
        shares=dict(sorted(((known.shares if known else {}) | shares).items())),
        arrivals=dict(sorted(((known.arrivals if known else {}) | arrivals).items())),
    )
    write_json(PATH, limits)
    read_limits.cache_clear()
    return PATH
