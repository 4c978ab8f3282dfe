"""Resolves the names of a spawn model and a policy, and hashes everything a rollout depends on."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from crowdbench import __version__
from crowdbench.files import sha256
from crowdbench.registry import PolicySource, SpawnSource, policy_source, spawn_source
from crowdbench.scene import Scene

MAKES_ROLLOUTS = (
    "compilation.py",
    "scene.py",
    *(f"{room}/**/*.py" for room in ("data", "spawn", "simulation", "policies", "registry")),
    *(f"run/{name}.py" for name in ("acting", "episode", "plaza_recording", "rollout", "shown")),
    "run/rollout_jobs.py",
)
"""Code that rollouts depend on. Changes to other code do not invalidate them."""
MAKES_NO_ROLLOUTS = ("scene.toml", "anchors.json", "reference.json")
"""Files of a scene that rollouts do not depend on; of `scene.toml` only `Scene.rules` matters."""
_LARGE = 2**26  # bytes above which the file's modification time is hashed instead of its content


@dataclass(frozen=True)
class Resolved:
    """A spawn model and a policy on a scene."""

    scene: Scene
    spawn: SpawnSource
    policy: PolicySource

    @classmethod
    def of(cls, scene: Scene, spawn: str, policy: str) -> "Resolved":
        """Resolve the names.

        Raises:
            SettingError: a folder does not contain the fits of exactly one spawn model.
            WeightsError: the scene has no fits of the spawn model.
        """
        return cls(scene, spawn_source(spawn, scene), policy_source(policy, scene))

    @property
    def own(self) -> list[str]:
        """The policy and spawn model that are classes of a user or another package."""
        policy = [f"policy {self.policy.name}"] if self.policy.own else []
        spawn = [f"spawn model {self.spawn.name}"] if self.spawn.own else []
        return [*policy, *spawn]

    def fingerprint(self, split: str) -> str:
        """Hash of everything that a rollout depends on.

        This includes crowdbench's code, the scene's rules and models, the recording, the scenario,
        the files of the spawn model and of the policy, and the code of user-defined classes.
        """
        spawn_files, spawn_code = self.spawn.dependencies()
        policy_files, policy_code = self.policy.dependencies(split)
        what = f"{self.spawn.name} {self.policy.name}"
        if code := spawn_code + policy_code:
            what = f"{what} {sha256(code)}"
        return fingerprint(self.scene, what, [*spawn_files, *policy_files])


def fingerprint(scene: Scene, what: str, more: Sequence[Path] = ()) -> str:
    """Hash of everything that the rollout `what` depends on.

    This includes the code that makes rollouts, the scene's rules and models, and the files `more`.
    """
    package = Path(__file__).parents[1]
    files = [file for name in MAKES_ROLLOUTS for file in sorted(package.glob(name))]
    beside = sorted(path for path in scene.folder.iterdir() if path.is_file())
    files += [*(file for file in beside if file.name not in MAKES_NO_ROLLOUTS), *more]
    first = [f"{__version__} {scene.id} {what}".encode(), scene.rules]
    return sha256(b"".join([*first, *(_hash_of(f) for f in files)]))[:16]


def _hash_of(file: Path) -> bytes:
    stat = file.stat()
    if stat.st_size > _LARGE:
        return f"{file.name} {stat.st_size} {stat.st_mtime_ns}".encode()
    return sha256(file.read_bytes()).encode()
