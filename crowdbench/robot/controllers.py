"""What drives a robot: the protocol of controllers, and the built-in ones by name.

| name | drives |
|---|---|
| `straight` | along the shortest path around walls at full speed, as if nobody was there |
| `social-force` | by social forces |
| `orca` | by optimal reciprocal collision avoidance; needs the extra `orca` |
| `dwa` | by the dynamic window approach |
| a file `NAME.onnx` | by a network that sees observations; needs the extra `onnx` |

`PACKAGE.MODULE:CLASS` names a class of one's own, which is made without arguments.
"""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

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
