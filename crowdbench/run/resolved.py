"""Resolves the names of a spawn model and a policy, and hashes everything a rollout depends on."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from crowdbench import plugins
from crowdbench.code import code_hash
from crowdbench.data.blocks import HELD_OUT
from crowdbench.files import sha256
from crowdbench.registry.policies import PolicySource, policy_source
from crowdbench.registry.recordings import recording_hash
from crowdbench.registry.spawn_models import SpawnSource, spawn_source
from crowdbench.scene import Scene

MAKES_ROLLOUTS = (
    "crowdbench.run.rollout",
    "crowdbench.registry.spawn_models",
    "crowdbench.registry.policies",
)
"""Modules that every rollout runs. Those of its own spawn model and policy are added."""
MODELS = (
    *(f"crowdbench.spawn.{name}" for name in ("block_replay", "ntpp", "paper", "plans", "plaza")),
    *(
        f"crowdbench.spawn.{name}"
        for name in ("perturbed_replay", "replay", "steering.steered", "times")
    ),
    *(
        f"crowdbench.policies.{name}"
        for name in ("guided", "network", "social_force", "speed_model")
    ),
    "crowdbench.policies.walkers",
)
"""Spawn models and policies. A rollout depends only on those that are in it."""
PREPARE_RECORDINGS = ("crowdbench.data.recordings", "crowdbench.registry.recordings")
"""What rollouts without the recording do not depend on; see `recording_hash` for the others."""
TRAINING = tuple(
    f"crowdbench.spawn.*.{name}" for name in ("fit", "fit_frames", "log_likelihood", "write")
)
"""Functions of spawn models that no rollout calls."""
_LARGE = 2**26  # bytes above which the time of a user's file is hashed instead of its content


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
        sources = (("policy", self.policy), ("spawn model", self.spawn))
        return [f"{what} {source.name}" for what, source in sources if source.own]

    @property
    def foreign(self) -> bool:
        """Whether it runs code of others, which may use more files than those beside it."""
        others = [
            s for s in (self.policy, self.spawn) if s.own and not s.name.startswith("crowdbench.")
        ]
        return bool(others or plugins.names("observations"))

    def fingerprint(self, split: str) -> str:
        """Hash of everything that a rollout depends on, but its fit and seed.

        This includes the scene's rules, the files of the spawn model and of the policy, the
        recording if one of them plays it, the code of crowdbench that is run, and the code of
        user-defined classes. Names do not count: the same models give the same hash.
        """
        spawn, policy = self.spawn.dependencies(), self.policy.dependencies(split)
        parts: list[str | bytes] = [self.scene.id, self.scene.rules, split]
        parts += [code_of_rollouts((*spawn.modules, *policy.modules), foreign=self.foreign)]
        if split == HELD_OUT:
            parts += [str(self.scene.protocol.block_s)]
        if spawn.recording or policy.recording:
            parts += [recording_hash(self.scene)]
        for needs, own in ((spawn, self.spawn.own), (policy, self.policy.own)):
            parts += [needs.what, needs.code, *(_hash_of(file, own) for file in needs.files)]
        hashes = [sha256(p.encode() if isinstance(p, str) else p) for p in parts]
        return sha256(" ".join(hashes).encode())[:16]


def code_of_rollouts(models: Iterable[str] = (), *, foreign: bool = False) -> str:
    """Hash of the code that makes rollouts with spawn models and policies in the modules `models`.

    Code of others (`foreign`) may use all that crowdbench has.
    """
    if foreign:
        return code_hash(*MAKES_ROLLOUTS, *models, unused=TRAINING)
    shared = code_hash(*MAKES_ROLLOUTS, cut=(*MODELS, *PREPARE_RECORDINGS), unused=TRAINING)
    return shared + code_hash(*models, cut=PREPARE_RECORDINGS, unused=TRAINING)


def _hash_of(file: Path, own: bool) -> str:
    stat = file.stat()
    if own and stat.st_size > _LARGE:
        return f"{file.name} {stat.st_size} {stat.st_mtime_ns}"
    return sha256(file.read_bytes())
