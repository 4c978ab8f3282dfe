"""Policies by name."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from crowdbench import plugins
from crowdbench.data.blocks import HELD_OUT, SPLITS
from crowdbench.errors import SettingError, checked
from crowdbench.policies import (
    GuidedWalker,
    OnnxPolicy,
    Policy,
    Random,
    RecordedPaths,
    ReplayPolicy,
    SocialForce,
    SpeedModel,
    Straight,
)
from crowdbench.registry.dependencies import Dependencies, files_of
from crowdbench.registry.recordings import has_recording, recording_of
from crowdbench.scene import Scene, load_scene, scenes_folder
from crowdbench.spawn.fits import check_split

_PLAIN: dict[str, Callable[..., Policy]] = {
    k.name: k for k in (Straight, SocialForce, SpeedModel, GuidedWalker, Random)
}
_FITTED = {GuidedWalker.name: GuidedWalker.fitted_to}
"""Those of them that a scene may have parameters for."""
_RECORDED: dict[str, Callable[..., Policy]] = {k.name: k for k in (ReplayPolicy, RecordedPaths)}
POLICIES = (*_PLAIN, *_RECORDED)
ANY_PLACE = "anticipate-any"
"""The network that walks on any scene."""


@dataclass(frozen=True)
class PolicySource:
    """What the name of a policy refers to on a scene, found once by `policy_source`."""

    name: str
    scene: Scene
    networks: Path | None
    """An ONNX file, or a folder with one per split."""
    own: bool
    """Whether it is a class of a user or another package, which `policy` imports."""

    @property
    def per_split(self) -> bool:
        """Whether each split has a network, parameters, or a class that is called with it."""
        if self.own:
            return plugins.takes(self._own_class(), "split")
        if self.networks is None:
            return self.parameters is not None
        return self.networks.suffix != ".onnx"

    @property
    def parameters(self) -> Path | None:
        """File with the parameters that are fitted to the scene, for each split; None if none."""
        file = self.scene.folder / f"{self.name}.json"
        return file if self.name in _FITTED and file.is_file() else None

    def network(self, split: str) -> Path | None:
        """ONNX file for a split; None if the policy is not a network.

        Raises:
            SettingError: there is no such split.
        """
        check_split(split, 0)
        if self.networks is None:
            return None
        return self.networks / f"{split}.onnx" if self.per_split else self.networks

    def files(self, split: str) -> tuple[Path, ...]:
        """ONNX files of a split, or of all folds for `HELD_OUT`; none if it is not a network."""
        splits = SPLITS[1:] if split == HELD_OUT else (split,)
        return tuple(dict.fromkeys(f for s in splits if (f := self.network(s)) is not None))

    def card_file(self) -> Path | None:
        """An ONNX file that exists, whose card names the policy; None if it is not a network."""
        files = [file for split in SPLITS if (file := self.network(split)) is not None]
        return next((file for file in files if file.is_file()), files[0] if files else None)

    def policy(self, split: str = "full") -> Policy:
        """The policy for a split; see `crowdbench.policy`."""
        file = self.network(split)
        if file is not None:
            return OnnxPolicy(file)
        if not self.own:
            if self.parameters is not None:
                return _FITTED[self.name](self.scene, split)
            if self.name in _RECORDED:
                return _RECORDED[self.name](recording_of(self.scene))
            return _PLAIN[self.name]()
        needed = ("name", "sees", "reset", "act")
        policy: Policy = plugins.create(
            self._own_class(), self.name, needed=needed, scene=self.scene, split=split
        )
        if policy.sees not in ("observation", "state"):
            raise SettingError(
                self.name, got=f"sees = {policy.sees!r}", expected="'observation' or 'state'"
            )
        return policy

    def _own_class(self) -> Callable[..., Policy]:
        if self.name.endswith((".zip", ".pt", ".pth")):
            network = self.name if self.name.endswith(".zip") else "pkg.module:NAME"
            file = Path(self.name).with_suffix(".onnx")
            raise SettingError(
                "policy",
                got=f"{self.name!r}, which is not exported",
                expected="an ONNX file",
                hint=f"Export it first: `crowdbench policy export {network} {file} --name NAME "
                f"--scene {self.scene.asked}`, with the observation that it was trained with.",
            )
        known = (*POLICIES, *trained_policies(self.scene), ANY_PLACE)
        files = ("an ONNX file", "a folder of ONNX files")
        kind: Callable[..., Policy] = plugins.find("policies", self.name, (*known, *files))
        return kind

    def dependencies(self, split: str) -> Dependencies:
        """What its rollouts depend on."""
        if self.own:
            ours = self.name.startswith("crowdbench.")  # those read nothing
            read = [] if ours else files_of(self.scene.folder)
            return Dependencies.of_own("policies", self.name, *read)
        if files := self.files(split):
            return Dependencies("network", (OnnxPolicy.__module__,), files)
        kind = {**_PLAIN, **_RECORDED}[self.name]
        files = () if self.parameters is None else (self.parameters,)
        recorded = self.name in _RECORDED
        return Dependencies(self.name, (kind.__module__,), files, recording=recorded)


def policy_source(name: str, scene: Scene) -> PolicySource:
    """Find what the name of a policy refers to on a scene.

    A class is imported only when the policy is made, so a scorecard that names one can be shown
    where the class is not installed.
    """
    plugins.names("policies", POLICIES)  # raises an error if a built-in name was registered
    networks = None if name in POLICIES else _networks(name, scene)
    return PolicySource(name, scene, networks, own=networks is None and name not in POLICIES)


def _networks(name: str, scene: Scene) -> Path | None:
    """ONNX file, or folder of ONNX files, that a name refers to; None if it refers to neither."""
    if name.endswith(".onnx"):
        return Path(name)
    if ":" in name:
        return None
    own = Path(name)
    folder = own if len(own.parts) > 1 else scene.folder / "policies" / name
    if name == ANY_PLACE and not folder.is_dir():
        return scenes_folder() / f"{ANY_PLACE}.onnx"
    return folder if folder.is_dir() else None


@checked()
def policy(named: str | Policy, scene: str | Path | Scene, split: str = "full") -> Policy:
    """Policy with the given name, or from an ONNX file.

    Args:
        named: a name; an ONNX file; a folder with one ONNX file per split (`full.onnx`,
            `fold0.onnx`, …); `pkg.module:Class`, which is called with `scene` and `split` if it has
            parameters of these names; or a policy.
            Policies that ship with a scene are in its folder `policies`.
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        split: one of `blocks.SPLITS`; selects the file in a folder.

    Raises:
        SettingError: there is no such policy, or the packages for ONNX files are not installed.
        WeightsError: the file is missing or invalid.
        RecordingError: it needs a recording that is not imported.
    """
    if not isinstance(named, str):
        return named
    return policy_source(named, load_scene(scene)).policy(split)


@checked()
def list_policies(scene: str | Path | Scene) -> list[str]:
    """Names of the policies of a scene: built-in, shipped with it, and registered by packages.

    Raises:
        SceneError: the scene does not exist.
    """
    place = load_scene(scene)
    plain = [name for name in POLICIES if name in _PLAIN or has_recording(place)]
    shipped = dict.fromkeys([*trained_policies(place), ANY_PLACE])
    return [*plain, *shipped, *plugins.names("policies", POLICIES)]


def trained_policies(scene: Scene) -> list[str]:
    """Names of the policies that ship with a scene."""
    folder = scene.folder / "policies"
    return sorted(f.name for f in folder.iterdir() if f.is_dir()) if folder.is_dir() else []
