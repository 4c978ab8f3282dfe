"""Pictures of a robot among people, in the style of those of crowds."""

import math

import numpy as np
from jaxtyping import Bool, UInt8

from crowdbench.colours import COLOURS
from crowdbench.robot.record import EpisodeRecorder, RobotEpisode
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene
from crowdbench.viewer.canvas import FINER, INK, Canvas
from crowdbench.viewer.place import GREY

ROBOT, GOAL = COLOURS[0], COLOURS[2]
"""Colours of the robot and of its goal."""
AHEAD_S = 1.0
"""Lines show where people and the robot will be after this time."""


class RobotPictures:
    """Draws a robot among people from above on white, with x to the right and y up.

    People are grey discs. The robot is a blue disc with a white line from its centre to its front.
    Its way so far is a blue line that begins at a ring. It reaches its goal inside a green circle.
    Black lines lead to where people and the robot will be in a second.
    """

    def __init__(self, scene: Scene) -> None:
        self._canvas = Canvas(scene, with_areas=False)

    def draw(self, episode: RobotEpisode, step: int = -1) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a state of an episode: height × width × (red, green, blue), 0 to 255.

        By default, it is the last state.

        Raises:
            IndexError: there is no such state.
        """
        step = range(len(episode))[step]
        here = episode.people(step)
        people, robot = episode.person_position[here], episode.position[step]
        heading = float(episode.heading[step])
        radius_m = episode.robot.radius_m
        front = robot + radius_m * np.array([math.cos(heading), math.sin(heading)])
        pen = self._canvas.pen()
        pen.disc(episode.position[0], 4.0 * FINER, None, outline=ROBOT, width=2 * FINER)
        pen.line(episode.position[: step + 1], ROBOT, 2 * FINER)
        goal_radius = max(episode.goal_radius_m * self._canvas.per_m, 3.0 * FINER)
        pen.disc(episode.goal[step], goal_radius, None, outline=GOAL, width=2 * FINER)
        pen.disc(episode.goal[step], 2.0 * FINER, GOAL)
        for xy in people:
            pen.disc(xy, self._radius(episode.person_radius_m), GREY)
        pen.disc(robot, self._radius(radius_m), ROBOT)
        pen.line(np.stack([robot, front]), "white", 2 * FINER)
        for xy, velocity in zip(people, episode.person_velocity[here], strict=True):
            pen.line(np.stack([xy, xy + AHEAD_S * velocity]), INK, FINER)
        way = AHEAD_S * episode.velocity[step]
        length = float(np.linalg.norm(way))
        if length > radius_m:
            pen.line(np.stack([robot + radius_m / length * way, robot + way]), INK, FINER)
        pen.label(step * episode.period_s, len(people))
        return pen.picture()

    def _radius(self, radius_m: float) -> float:
        """A radius in pixels, large enough to be seen."""
        return max(radius_m * self._canvas.per_m, 2.0 * FINER)


class WorldPictures:
    """Pictures of the first `count` of the worlds that others step."""

    def __init__(self, worlds: RobotWorlds, count: int) -> None:
        """Pictures of worlds in which no episode has begun."""
        self._recorders = [EpisodeRecorder(worlds, k) for k in range(count)]
        self._pictures = RobotPictures(worlds.scene)

    def begin(self, worlds: Bool[np.ndarray, " W"] | None = None) -> None:
        """Note that episodes have begun in some worlds, by default all."""
        for k, recorder in enumerate(self._recorders):
            if worlds is None or worlds[k]:
                recorder.begin()

    def follow(self, begun: Bool[np.ndarray, " W"]) -> None:
        """Note the state after a control period, after which episodes have `begun` in some."""
        for k, recorder in enumerate(self._recorders):
            if begun[k]:
                recorder.begin()
            else:
                recorder.write()

    def draw(self) -> list[UInt8[np.ndarray, "h w 3"]]:
        """The pictures of the present states.

        Raises:
            ActionError: no episode has begun.
        """
        return [self._pictures.draw(recorder.episode()) for recorder in self._recorders]
