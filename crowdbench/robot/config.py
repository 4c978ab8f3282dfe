"""The settings of robot environments."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from crowdbench.errors import SettingError, checked, did_you_mean
from crowdbench.policies import Policy
from crowdbench.registry import DEFAULT_SPAWN
from crowdbench.robot.robots import Robot, robot_of
from crowdbench.run.episode import check_horizon
from crowdbench.simulation.simulation import check_count
from crowdbench.spawn import SpawnModel

if TYPE_CHECKING:
    from crowdbench.robot.worlds import RobotWorlds

Observed = Literal["social", "lidar", "state"]
Task = Literal["cross", "patrol", "follow", "stand-aside"]
PERSON_TASKS = ("follow", "stand-aside")
"""Tasks that are about a person, who decides where the robot starts and where it should be."""
Collision = Literal["terminate", "count"]
LONGEST_CROWD_S = 600.0
REPLAY = "replay"


@checked()
@dataclass(frozen=True, kw_only=True)
class RobotReward:
    """Weights of the parts of the usual reward of a control period.

    The reward is their sum: `progress` times the decrease of the path length to the goal in metres,
    plus `success` in the period in which the last goal is reached, minus `collision` times the
    number of contacts that begin, with people or walls, minus `discomfort` times the time-integral
    of 1 − d / `discomfort_m` while the surface of the nearest person is nearer than `discomfort_m`,
    minus `time` times the period in seconds.

    Success, collision and discomfort are the parts of the reward of CrowdNav (Chen et al. 2019);
    progress makes it dense. Returns are near 1, which the default settings of algorithms expect.
    """

    progress: float = 0.1
    success: float = 1.0
    collision: float = 1.0
    discomfort: float = 0.2
    discomfort_m: float = 0.45
    time: float = 0.01

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not (isinstance(value, int | float) and np.isfinite(value)):
                raise SettingError(f"reward.{f.name}", got=repr(value), expected="a finite number")
        if self.discomfort_m <= 0:
            raise SettingError(
                "reward.discomfort_m", got=repr(self.discomfort_m), expected="a positive number"
            )


RewardFunction = Callable[["RobotWorlds"], np.ndarray]
"""A reward of one's own: from the worlds after a control period to one number per world, (W,)."""


@checked("crowdbench.robot.worlds:RobotWorlds")
@dataclass(frozen=True, kw_only=True)
class RobotConfig:
    """Settings of `RobotEnv`, `RobotVectorEnv` and `RobotVecEnv`, which take them as keywords, too.

    Raises:
        SettingError: a value is out of range.
    """

    robot: str | Robot = "delivery"
    """A preset's name, see `crowdbench.robot.robots.ROBOTS`, or a `Robot`."""
    walkers: str | Policy = "social-force"
    """How people walk: a policy's name or a policy. With `replay` they walk as they were recorded,
    and cannot react to the robot; this needs the recording."""
    spawn: str | SpawnModel = DEFAULT_SPAWN
    """Who enters, when and where: a spawn model's name or a spawn model. With the walkers `replay`
    it is `replay`, too."""
    observation: Observed = "social"
    """`social`: the nearest people, the path and the distances to walls, in the robot's frame;
    `lidar`: a range scan; `state`: a dictionary of everything in the frame of the scene."""
    period_s: float | None = None
    """Control period: the scene's frame (default) divided by a whole number."""
    visible: bool = True
    """Whether people see the robot as a person. Otherwise they walk through it."""
    task: Task = "cross"
    """`cross`: drive to a goal; `patrol`: visit `points` goals one after another; `follow`: stay
    within 2 m of a person; `stand-aside`: leave the entrance of somebody, and wait beside it."""
    points: int = 4
    """Number of goals of a patrol."""
    start: tuple[float, float] | None = None
    """Where the robot starts, metres; by default drawn in the areas of the scene."""
    goal: tuple[float, float] | None = None
    """Its goal, or the last one of a patrol; by default drawn likewise."""
    min_distance_m: float | None = None
    """Least straight distance from the start to the goal, and between goals; default: half of the
    largest one in the scene."""
    goal_radius_m: float = 0.5
    """A goal is reached when the centre of the robot comes this close to it."""
    time_limit_s: float = 60.0
    """Seconds after which an episode is truncated."""
    horizon_s: float | None = None
    """Length for which a crowd goes on, over several episodes, until a new one takes its place;
    default: the recording's length, at most 600 s. At least `time_limit_s`."""
    collision: Collision = "terminate"
    """Whether a contact with a person or wall ends the episode, or is only counted."""
    reward: RobotReward | RewardFunction = field(default_factory=RobotReward)
    """Weights of the usual reward, or a reward of one's own."""
    nearest: int = 8
    """Number K of people in `social` and `state`, and in the view of controllers."""
    range_m: float = 10.0
    """Distance up to which people, and walls in a scan, are seen."""
    rays: int = 180
    """Number of rays of a scan, all around from the back to the left."""
    range_noise_m: float = 0.0
    """Standard deviation of the ranges of a scan."""
    drop_out: float = 0.0
    """Probability that a ray returns nothing and shows the full range."""
    max_alive: int | None = None
    """Maximum number of people at the same time; default: twice as many as there usually are at
    most. People beyond that do not enter."""
    costs: bool = False
    """Whether the robot's costs to people are measured, in a twin of each world without it."""

    def __post_init__(self) -> None:
        robot_of(self.robot)
        for name in ("points", "nearest", "rays"):
            check_count(name, getattr(self, name))
        if self.max_alive is not None:
            check_count("max_alive", self.max_alive)
        for name in ("goal_radius_m", "range_m", "time_limit_s"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise SettingError(name, got=repr(value), expected="a positive number")
        if not 0 <= self.range_noise_m < np.inf:
            raise SettingError(
                "range_noise_m", got=repr(self.range_noise_m), expected="0 or more metres"
            )
        if not 0 <= self.drop_out <= 1:
            raise SettingError(
                "drop_out", got=repr(self.drop_out), expected="a probability from 0 to 1"
            )
        given = ("goal",) if self.task == "follow" else ("start", "goal")
        for name in given if self.task in PERSON_TASKS else ():
            if getattr(self, name) is not None:
                raise SettingError(
                    name,
                    got=repr(getattr(self, name)),
                    expected=f"None, because the task {self.task} chooses it",
                )
        if self.horizon_s is not None:
            check_horizon(self.horizon_s)
            if self.horizon_s < self.time_limit_s:
                raise SettingError(
                    "horizon_s",
                    got=f"{self.horizon_s:g}",
                    expected=f"at least time_limit_s = {self.time_limit_s:g}",
                )
        if self.walkers == REPLAY and self.spawn not in (DEFAULT_SPAWN, REPLAY):
            raise SettingError(
                "spawn",
                got=repr(self.spawn),
                expected="replay, because people walk as they were recorded",
            )

    @classmethod
    def of(cls, config: "RobotConfig | None", **settings: Any) -> "RobotConfig":
        """A config whose values `settings` replace.

        Raises:
            SettingError: there is no such setting, or a value is out of range.
        """
        known = [f.name for f in fields(cls)]
        for name in settings:
            if name not in known:
                raise SettingError(
                    "robot environment",
                    got=f"the setting {name!r}",
                    expected=f"one of {', '.join(known)}",
                    hint=did_you_mean(name, known),
                )
        return replace(config or cls(), **settings)

    @property
    def goals(self) -> int:
        """Number of goals of an episode."""
        return self.points if self.task == "patrol" else 1
