"""Robots that a network drives: policy files for robots, written and read.

A file is an ONNX network as those of people's policies (`crowdbench.policies.network`): inputs
`observation`, float32 (W, numbers), outputs `action`, float32 (W, 2), and perhaps `noise`. Its card
says for which robot and observation it was trained.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float32

from crowdbench.errors import SettingError, WeightsError
from crowdbench.policies.card import PolicyCard
from crowdbench.policies.network import OnnxPolicy
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.encounters import Present
from crowdbench.robot.observing import Observer
from crowdbench.robot.robots import Robot
from crowdbench.robot.seeing import RobotView
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene

if TYPE_CHECKING:
    import torch

ACTION = "robot-1"
"""Version of the action: that of `crowdbench.robot.driving`, in [−1, 1]²."""
OBSERVATIONS = ("social", "lidar")


class RobotCard(PolicyCard, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Metadata of a policy file for robots."""

    action: str = ACTION
    split: str = "full"
    numbers: int
    """Number of values in an observation."""
    nearest: int
    """Number K of people in the observation `social`."""
    kinematics: str
    robot: str
    """Name of the robot that it was trained with."""
    period_s: float
    """Control period in seconds."""
    walkers: str
    """How people walked in its training."""

    @property
    def inputs(self) -> int:
        """Number of values in an observation."""
        return self.numbers

    @property
    def with_rays(self) -> str:
        """Words on the rays for messages."""
        return f" with {self.rays} rays" if self.observation == "lidar" else ""

    def checked(self, where: object) -> "RobotCard":
        """This card, after validation; `where` is named in error messages.

        Raises:
            WeightsError: the card has another version, or a value is out of range.
        """
        for name, fits, expected in (
            ("action", self.action == ACTION, ACTION),
            ("observation", self.observation in OBSERVATIONS, " or ".join(OBSERVATIONS)),
            ("numbers", self.numbers >= 1, "1 or more"),
            ("nearest", self.nearest >= 1, "1 or more"),
            ("memory", self.memory == self.style == 0, "0: robots remember nothing"),
        ):
            if not fits:
                got = f"the {name} {getattr(self, name)!r}"
                raise WeightsError(where, got=got, expected=expected)
        return self


class RobotNetwork(OnnxPolicy):
    """The controller in an ONNX file; needs the extra `onnx`."""

    kind: ClassVar[type[PolicyCard]] = RobotCard
    card: RobotCard

    def reset(self, scene: Scene, robot: Robot, worlds: int, period_s: float) -> None:  # type: ignore[override]
        """Prepare for a scene and a robot.

        Raises:
            SettingError: the network was trained for other kinematics or another control period.
        """
        card = self.card
        for name, asked in (("kinematics", robot.kinematics), ("period_s", period_s)):
            trained: Any = getattr(card, name)
            if trained != asked and not (
                name == "period_s" and abs(trained - asked) <= 0.25 * trained
            ):
                raise SettingError(
                    f"controller {self.name}",
                    got=f"a robot with {name} = {asked}",
                    expected=f"{name} = {trained}, for which it was trained",
                    hint=f"It drives the robot {card.robot}.",
                )
        self._segments = np.ascontiguousarray(scene.wall_segments)
        self._rng = np.random.default_rng(0)
        self._worlds = np.arange(worlds)
        self._observer: Observer | None = None

    def act(self, view: RobotView) -> Float32[np.ndarray, "W 2"]:  # type: ignore[override]
        """Actions (W, 2).

        Raises:
            SettingError: the view has another number of people than its observations.
        """
        if self._observer is None:
            self._observer = self._observer_of(view)
        people = Present(view.there, view.near, view.near_velocity, view.there)
        nothing = np.zeros(len(self._worlds), np.int64)
        seen = self._observer.observe(self._worlds, people, nothing.astype(np.uint64), nothing)
        return super().act(seen)

    def _observer_of(self, view: RobotView) -> Observer:
        card = self.card
        if card.observation == "social" and view.there.shape[1] != card.nearest:
            raise SettingError(
                f"controller {self.name}",
                got=f"nearest = {view.there.shape[1]}",
                expected=f"nearest = {card.nearest}, with which it was trained",
            )
        config = RobotConfig(
            robot=view.robot,
            observation=card.observation,  # type: ignore[arg-type]  # the card was checked
            nearest=view.there.shape[1],
            rays=card.rays,
            range_m=card.ray_range_m,
        )
        return Observer(config, view, self._segments)


def export_robot(
    model: Any, path: str | Path, worlds: RobotWorlds, *, name: str = "ppo", command: str = ""
) -> Path:
    """Write a network that drives robots as a policy file.

    Args:
        model: a model of Stable-Baselines3 (`PPO` or another one with an actor), or a torch network
            that takes observations (W, numbers) and returns actions (W, 2).
        path: the file to write; an existing file is replaced.
        worlds: the worlds that it was trained in: attribute `worlds` of `RobotVectorEnv` and
            `RobotVecEnv`.
        name: name of the controller in tables.
        command: the command that trained it.

    Returns:
        `path`.

    Raises:
        SettingError: a package is missing, or the observation is `state`.
        WeightsError: the network does not fit the observation, or cannot be exported.
        OutputError: `path` cannot be written.
    """
    from crowdbench.files import revision
    from crowdbench.policies.export import export_policy

    config, scene = worlds.config, worlds.scene
    if config.observation not in OBSERVATIONS:
        raise SettingError(
            "observation", got=config.observation, expected=" or ".join(OBSERVATIONS)
        )
    shape = worlds.observation_space.shape
    assert shape is not None  # both are vectors
    card = RobotCard(
        name=name,
        observation=config.observation,
        numbers=shape[0],
        nearest=config.nearest,
        rays=config.rays,
        ray_range_m=config.range_m,
        kinematics=worlds.robot.kinematics,
        robot=worlds.robot.name,
        period_s=worlds.period_s,
        walkers=config.walkers if isinstance(config.walkers, str) else config.walkers.name,
        scene=scene.id,
        command=command,
        revision=revision(Path(__file__).parent),
    )
    return export_policy(_network_of(model), Path(path), card, reader=RobotNetwork)


def _network_of(model: Any) -> "torch.nn.Module":
    """The network of mean actions, clipped to [−1, 1], of a model of Stable-Baselines3."""
    if not hasattr(model, "policy"):
        network: torch.nn.Module = model
        return network
    from crowdbench.policies.sb3_network import Sb3Network

    return Sb3Network(model.policy, 0)
