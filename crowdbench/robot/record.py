"""`RobotEpisode`: what a robot and the people around it did in an episode, and files of it."""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int

from crowdbench.errors import ActionError
from crowdbench.files import replacing, write_json
from crowdbench.robot.robots import Robot
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene

COLUMNS = ("step", "time_s", "agent", "x", "y", "heading", "vx", "vy")
"""Columns of the CSV file."""
CELL_M = 0.1
"""Size of a cell of the occupancy grid in SocNav3 files, metres."""
_DECIMALS = 4


@dataclass(frozen=True, eq=False)
class RobotEpisode:
    """A recorded episode of T states, one at the start and one after each control period.

    The R rows of people are those of everyone present in each state, by state and id.
    """

    scene: Scene
    robot: Robot
    period_s: float
    """Time between states, seconds."""
    goal_radius_m: float
    """A goal is reached at this distance from it, metres."""
    person_radius_m: float
    position: Float[np.ndarray, "T 2"]
    """Positions of the robot, metres."""
    heading: Float[np.ndarray, " T"]
    """Its headings, radians."""
    velocity: Float[np.ndarray, "T 2"]
    """Its velocities in the frame of the scene, m/s."""
    goal: Float[np.ndarray, "T 2"]
    """The goal that it drove to, metres."""
    step: Int[np.ndarray, " R"]
    """State of each row of people, from 0 to T − 1."""
    person: Int[np.ndarray, " R"]
    """Id of each person; the same person has the same id in all states."""
    person_position: Float[np.ndarray, "R 2"]
    """Metres."""
    person_heading: Float[np.ndarray, " R"]
    """Direction in which each person last walked, radians."""
    person_velocity: Float[np.ndarray, "R 2"]
    """m/s."""

    def __len__(self) -> int:
        """Number of states T."""
        return len(self.position)

    def people(self, step: int) -> slice:
        """The rows of the people in a state."""
        first, stop = np.searchsorted(self.step, (step, step + 1)).tolist()
        return slice(first, stop)

    def write_csv(self, path: str | Path) -> None:
        """Write a table of the robot and all people in each state.

        The columns are `COLUMNS`: number and time of the state, `robot` or the id of a person, and
        its position (m), heading (rad) and velocity (m/s) in the frame of the scene.

        Raises:
            OutputError: the file cannot be written.
        """
        robot = np.column_stack([self.position, self.heading, self.velocity])
        people = np.column_stack([self.person_position, self.person_heading, self.person_velocity])
        with replacing(Path(path)) as temporary, temporary.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(COLUMNS)
            for step in range(len(self)):
                here = self.people(step)
                rows = zip(
                    ["robot", *self.person[here].tolist()],
                    np.vstack([robot[step], people[here]]).tolist(),
                    strict=True,
                )
                time_s = f"{step * self.period_s:.6g}"
                table.writerows(
                    (step, time_s, who, *(f"{value:.{_DECIMALS}f}" for value in values))
                    for who, values in rows
                )

    def write_socnav3(self, path: str | Path, *, context: str | None = None) -> None:
        """Write a trajectory in the JSON format of the SocNav3 data set, for the ALT metric.

        The format and the metric are those of "Towards data-driven metrics for social robot
        navigation benchmarking" (code in github.com/SocNavData/SocNav3; JSON schema in
        github.com/pilarbachiller/SocNav3-simdata-generator). In metres, seconds and radians:

        - `walls`: segments [x1, y1, x2, y2];
        - `grid`: occupancy (0 free, 1 wall) of `height` × `width` cells of size `cell_size`; the
          first row is the one with the largest y, and `x_orig`, `y_orig` is the lower left corner;
        - `sequence`: for each state its `timestamp`; `robot` with `shape` (type, width, length),
          `x`, `y`, `angle`, `speed_x`, `speed_y`, `speed_a`; `goal` with `type`, `human`, `x`, `y`,
          `angle`, `pos_threshold`, `angle_threshold`; `people` with `id`, `x`, `y`, `angle`; and
          `objects`, of which there are none.

        The format does not say in which frame `speed_x` and `speed_y` are, and the metric computes
        speeds from positions. Here they are in the robot's own frame, ahead and to the left, as in
        the simulator SocNavGym. The goal may be reached with any heading, so `angle_threshold` is π
        and `angle` is the direction from the start of the way to that goal.

        Args:
            path: the file.
            context: the situation in a sentence (`context_description`). The metric needs one that
                its authors have rated, such as "A drug delivery robot is working in a hospital.".

        Raises:
            OutputError: the file cannot be written.
        """
        found: dict[str, Any] = {
            "metadata": f"crowdbench, {self.scene.id}, robot {self.robot.name}",
            "grid": _grid(self.scene),
            "walls": _rounded(self.scene.wall_segments),
            "sequence": self._sequence(),
        }
        if context is not None:
            found["context_description"] = context
        write_json(Path(path), found, compact=True)

    def _sequence(self) -> list[dict[str, Any]]:
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        vx, vy = self.velocity.T
        ahead, left = vx * cos + vy * sin, vy * cos - vx * sin
        turned = np.diff(self.heading, prepend=self.heading[:1])
        turn = (np.mod(turned + np.pi, 2 * np.pi) - np.pi) / self.period_s
        robot = _rounded(np.column_stack([self.position, self.heading, ahead, left, turn]))
        people = _rounded(np.column_stack([self.person_position, self.person_heading]))
        goal = _rounded(np.column_stack([self.goal, self._goal_angle()]))
        size = 2 * self.robot.radius_m
        shape = {"type": "circle", "width": size, "length": size}
        sequence = []
        for step in range(len(self)):
            here = self.people(step)
            moved = ("x", "y", "angle", "speed_x", "speed_y", "speed_a")
            sequence.append(
                {
                    "timestamp": round(step * self.period_s, 6),
                    "robot": {"shape": shape, **dict(zip(moved, robot[step], strict=True))},
                    "goal": {
                        "type": "go-to",
                        "human": None,
                        **dict(zip(("x", "y", "angle"), goal[step], strict=True)),
                        "pos_threshold": self.goal_radius_m,
                        "angle_threshold": round(np.pi, _DECIMALS),
                    },
                    "people": [
                        {"id": who, "x": x, "y": y, "angle": angle}
                        for who, (x, y, angle) in zip(
                            self.person[here].tolist(), people[here], strict=True
                        )
                    ],
                    "objects": [],
                }
            )
        return sequence

    def _goal_angle(self) -> Float[np.ndarray, " T"]:
        """Direction to each goal from where the robot was when it turned to it."""
        new = np.append(True, (np.diff(self.goal, axis=0) != 0).any(axis=1))
        begun = np.maximum.accumulate(np.where(new, np.arange(len(self)), 0))
        way = self.goal - self.position[begun]
        return np.asarray(np.arctan2(way[:, 1], way[:, 0]))


class EpisodeRecorder:
    """Records the episodes of one of the worlds that others step."""

    def __init__(self, worlds: RobotWorlds, world: int = 0) -> None:
        """A recorder of a world that has recorded nothing yet."""
        self._worlds, self._world = worlds, world
        self._robot: list[np.ndarray] = []
        self._people: list[np.ndarray] = []
        self._who: list[np.ndarray] = []

    def begin(self) -> None:
        """Forget what was recorded, and record the first state of an episode."""
        for rows in (self._robot, self._people, self._who):
            rows.clear()
        self.write()

    def write(self) -> None:
        """Record the present state; called after each control period."""
        w, view, present = self._world, self._worlds.view, self._worlds.present
        slots = self._worlds.crowds.simulation.slots
        there = np.flatnonzero(present.there[w])
        there = there[np.argsort(slots.person[w, there])]
        x, y = slots.heading[w, there].T
        self._who.append(slots.person[w, there])
        self._people.append(
            np.column_stack(
                [present.position[w, there], np.arctan2(y, x), present.velocity[w, there]]
            )
        )
        self._robot.append(
            np.concatenate(
                [view.position[w], view.heading[w : w + 1], view.velocity[w], view.goal[w]]
            )
        )

    def episode(self) -> RobotEpisode:
        """The states recorded since the last `begin`.

        Raises:
            ActionError: nothing has been recorded.
        """
        if not self._robot:
            raise ActionError("episode", got="no episode", expected="a call of reset first")
        worlds, robot, people = self._worlds, np.array(self._robot), np.concatenate(self._people)
        return RobotEpisode(
            scene=worlds.scene,
            robot=worlds.robot,
            period_s=worlds.period_s,
            goal_radius_m=worlds.config.goal_radius_m,
            person_radius_m=worlds.crowds.person_radius_m,
            position=robot[:, :2],
            heading=robot[:, 2],
            velocity=robot[:, 3:5],
            goal=robot[:, 5:],
            step=np.repeat(np.arange(len(robot)), [len(who) for who in self._who]),
            person=np.concatenate(self._who).astype(np.int64),
            person_position=people[:, :2],
            person_heading=people[:, 2],
            person_velocity=people[:, 3:],
        )


def _grid(scene: Scene) -> dict[str, Any]:
    """The walls of a scene as an occupancy grid, see `RobotEpisode.write_socnav3`."""
    b = scene.bounds
    width, height = (
        max(1, int(np.ceil(extent / CELL_M - 1e-6)))
        for extent in (b.x_max_m - b.x_min_m, b.y_max_m - b.y_min_m)
    )
    x = b.x_min_m + CELL_M * (np.arange(width) + 0.5)
    y = b.y_min_m + CELL_M * (np.arange(height)[::-1] + 0.5)
    inside = shapely.contains_xy(scene.obstacles, *np.meshgrid(x, y))
    return {
        "width": width,
        "height": height,
        "cell_size": CELL_M,
        "x_orig": b.x_min_m,
        "y_orig": b.y_min_m,
        "angle_orig": 0.0,
        "data": inside.astype(np.int64).tolist(),
    }


def _rounded(values: Float[np.ndarray, "..."]) -> list[Any]:
    return list(np.round(values.astype(np.float64), _DECIMALS).tolist())
