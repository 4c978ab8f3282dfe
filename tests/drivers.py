"""A robot that is driven by actions."""

import numpy as np
from worlds import square

from crowdbench.robot.driving import drive, longest_substep_m
from crowdbench.robot.robots import Robot
from crowdbench.scene import Scene
from crowdbench.simulation.walls import wall_table

PERIOD_S = 0.4
FREE = square(1000.0)


class Driver:
    """One robot, driven by actions."""

    def __init__(self, robot: Robot, scene: Scene = FREE, x: float = 0.0, y: float = 0.0) -> None:
        b = scene.bounds
        self.robot, self.bounds = robot, (b.x_min_m, b.x_max_m, b.y_min_m, b.y_max_m)
        self.walls = wall_table(
            scene.wall_segments.tobytes(),
            lower=(b.x_min_m, b.y_min_m),
            upper=(b.x_max_m, b.y_max_m),
            rays=0,
            ray_range_m=1.0,
            step_m=robot.radius_m + longest_substep_m(robot.limits),
        )
        self.position, self.velocity = np.array([[x, y]]), np.zeros((1, 2))
        self.heading, self.speed, self.turn = np.zeros(1), np.zeros(1), np.zeros(1)
        self.hit = np.zeros(1, bool)

    def go(self, a: float, b: float, period_s: float = PERIOD_S) -> None:
        drive(
            np.array([[a, b]]), period_s, self.robot.limits, self.bounds, self.walls,
            self.position, self.heading, self.velocity, self.speed, self.turn, self.hit,
        )  # fmt: skip
