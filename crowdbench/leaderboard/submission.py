"""Opening a submission that is a plain folder."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from crowdbench.errors import SettingError
from crowdbench.files import read_struct, sha256
from crowdbench.leaderboard.declared import FILE, Declared
from crowdbench.leaderboard.entry import Status

_REFERENCE_SPAWN = ("poisson-gmm", "replay", "block-replay")
_REFERENCE_POLICY = ("straight", "replay", "random")


@dataclass(frozen=True)
class Submission:
    """A submission that has been read."""

    folder: Path
    declared: Declared
    id: str
    status: Status
    artefacts: dict[str, str]
    """SHA-256 by path in the submission."""

    def policy_of(self, scene: str) -> str:
        """What `registry.policy` takes for it."""
        named = self.declared.shipped_policy
        whole = self.folder / "policy.onnx"
        return named or str(whole if whole.exists() else self.folder / scene / "policy")

    def spawn_of(self, scene: str) -> str:
        """What `registry.spawn_model` takes for it."""
        return self.declared.shipped_spawn or str(self.folder / scene / "spawn")

    def trajectories_of(self, scene: str) -> list[Path]:
        """Its rollouts as tables; none where it brings models."""
        folder = self.folder / scene / "trajectories"
        return sorted(folder.iterdir()) if folder.is_dir() else []


@contextmanager
def open_submission(path: Path) -> Iterator[Submission]:
    """Open a submission's folder.

    Raises:
        SettingError: `submission.toml` is missing or not what it should be.
    """
    declared = read_struct(
        path / FILE, Declared, SettingError, "Run `crowdbench submit check` on it."
    )
    files = sorted(p for p in path.rglob("*") if p.is_file())
    yield Submission(
        folder=path.resolve(),
        declared=declared,
        id=re.sub(r"[^a-z0-9]+", "-", declared.name.lower()).strip("-")[:60],
        status=_status(path, declared),
        artefacts={str(p.relative_to(path)): sha256(p.read_bytes()) for p in files},
    )


def _status(folder: Path, declared: Declared) -> Status:
    if declared.training.protocol == "full" or list(folder.glob("*/trajectories")):
        return "listed"
    spawn = declared.shipped_spawn in _REFERENCE_SPAWN
    policy = declared.shipped_policy in _REFERENCE_POLICY
    of_track = {"walk": policy, "spawn": spawn, "crowd": spawn and policy}
    return "reference" if of_track[declared.track] else "ranked"
