"""What drives a robot: the protocol of controllers, and the built-in ones by name.

| name | drives |
|---|---|
| `straight` | along the shortest path around walls at full speed, as if nobody was there |
| `social-force` | by social forces |
| `orca` | by optimal reciprocal collision avoidance; needs the extra `orca` |
| `dwa` | by the dynamic window approach |
| `ppo` | by a network that ships with the scene; needs the extra `onnx` |
| `FILE.onnx` | by a network of one's own |
| `pkg.module:Class` | by a class of one's own, which is made without arguments |
"""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from crowdbench import plugins
from crowdbench.robot.following import follow
from crowdbench.robot.robots import Robot
from crowdbench.robot.seeing import RobotView
from crowdbench.scene import Scene


@runtime_checkable  # tests check annotations at run time
class Controller(Protocol):
    """A controller maps what the robots of `W` worlds see to their actions."""

    @property
    def name(self) -> str:
        """Name of the controller in tables."""
        ...

    def reset(self, scene: Scene, robot: Robot, worlds: int, period_s: float) -> None:
        """Prepare for a scene and a robot that acts every `period_s` seconds."""
        ...

    def act(self, view: RobotView) -> Float32[np.ndarray, "W 2"]:
        """Actions (W, 2) in [−1, 1], see `crowdbench.robot.driving`."""
        ...


class Straight:
    """Robots that drive along the shortest path at full speed and see nobody."""

    name = "straight"

    def reset(self, scene: Scene, robot: Robot, worlds: int, period_s: float) -> None:
        """Nothing needs to be prepared."""

    def act(self, view: RobotView) -> Float32[np.ndarray, "W 2"]:
        """Actions (W, 2)."""
        way = (view.towards - view.position).astype(np.float64)
        length = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)[:, None]
        return follow(view.robot, view, way * (view.robot.max_speed_mps / length))


def _social_force() -> Controller:
    from crowdbench.robot.forces import ForceDriven

    return ForceDriven()


def _orca() -> Controller:
    from crowdbench.robot.reciprocal import Orca

    return Orca()


def _dwa() -> Controller:
    from crowdbench.robot.dynamic_window import DynamicWindow

    return DynamicWindow()


BUILT_IN: dict[str, Callable[[], Controller]] = {
    "straight": Straight,
    "social-force": _social_force,
    "orca": _orca,
    "dwa": _dwa,
}
"""The built-in controllers; each is made by calling it."""


def controller(named: str | Controller, scene: Scene) -> Controller:
    """The controller with a name, or in a file; see the table of this module.

    Raises:
        SettingError: there is no such controller, or its packages are not installed.
        WeightsError: the file is missing or invalid.
        OwnCodeError: a class of one's own cannot be made.
    """
    if not isinstance(named, str):
        return named
    plugins.names("controllers", BUILT_IN)  # raises an error if a built-in name was registered
    if named in BUILT_IN:
        return BUILT_IN[named]()
    shipped = scene.folder / "robots" / f"{named}.onnx"
    if named.endswith(".onnx") or shipped.is_file():
        from crowdbench.robot.network import RobotNetwork

        return RobotNetwork(Path(named) if named.endswith(".onnx") else shipped)
    kind = plugins.find("controllers", named, list_controllers(scene))
    made: Controller = plugins.create(kind, named, needed=("name", "reset", "act"))
    return made


def list_controllers(scene: Scene) -> list[str]:
    """Names of the controllers of a scene: built in, and networks that ship with it."""
    return [*BUILT_IN, *sorted(file.stem for file in (scene.folder / "robots").glob("*.onnx"))]
