"""Robot worlds made in code, for tests: an empty square with exactly the people that are given."""

from typing import Any

import numpy as np
from given import Given
from worlds import Person, square

from crowdbench.robot.robots import Robot
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene

DISC = Robot(
    name="disc", kinematics="holonomic", radius_m=0.3, max_speed_mps=1.0, max_acceleration_mps2=100
)
"""A robot that changes its velocity at once."""
AHEAD, STAND = [1.0, 0.0], [0.0, 0.0]


def lonely(*people: Person, scene: Scene | None = None, **settings: Any) -> RobotWorlds:
    """One world, begun, in which a robot drives from (−5, 0) to (5, 0) and these people enter."""
    usual = {
        "robot": DISC, "walkers": "straight", "start": (-5.0, 0.0), "goal": (5.0, 0.0),
        "time_limit_s": 20.0, "horizon_s": 40.0, "max_alive": 8,
    }  # fmt: skip
    worlds = RobotWorlds(scene or square(), 1, spawn=Given(*people), **(usual | settings))
    worlds.begin(np.array([0]))
    return worlds


def drive(worlds: RobotWorlds, *actions: list[float]) -> list[Any]:
    """What the given actions bring in one world, a step for each."""
    return [worlds.step(np.array([action])) for action in actions]


def result(worlds: RobotWorlds) -> dict[str, float]:
    """The measures of the episode of one world so far."""
    return {name: float(of[0]) for name, of in worlds.results(np.array([0])).items()}
