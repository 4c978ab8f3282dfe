"""`Robot`: how a robot can move, and presets of robots that are in use."""

import math
from dataclasses import dataclass, fields
from typing import Literal, NamedTuple, get_args

from crowdbench.errors import SettingError, checked, did_you_mean

Kinematics = Literal["holonomic", "unicycle", "bicycle"]
HOLONOMIC, UNICYCLE, BICYCLE = range(3)
"""Indices of the kinematics in compiled code."""


class Limits(NamedTuple):
    """The numbers of a `Robot`, as compiled kernels take them."""

    kind: int
    """HOLONOMIC, UNICYCLE or BICYCLE."""
    radius: float
    max_speed: float
    min_speed: float
    max_acceleration: float
    max_turn: float
    max_turn_acceleration: float
    wheelbase: float
    max_steer: float


@checked()
@dataclass(frozen=True, kw_only=True)
class Robot:
    """A robot: a disc that drives, with limits of speed and acceleration.

    - `holonomic` drives in any direction. It faces the direction in which it last moved.
    - `unicycle` (differential drive) drives forwards and turns, also on the spot.
    - `bicycle` (car-like) drives forwards and steers. The centre of the disc is that of the rear
      axle. It turns at the rate v·tan δ / `wheelbase_m` with the speed v and the steering angle δ.

    Raises:
        SettingError: a value is out of range.
    """

    name: str = "robot"
    kinematics: Kinematics = "unicycle"
    radius_m: float = 0.3
    """Radius of the disc, metres."""
    max_speed_mps: float = 1.0
    min_speed_mps: float = 0.0
    """Smallest forward speed; negative if it may reverse. Not used by holonomic robots."""
    max_acceleration_mps2: float = 1.0
    """Largest acceleration and deceleration; of holonomic robots, in any direction."""
    max_turn_rps: float = 1.5
    """Largest turn rate of a unicycle, or of the steering angle of a bicycle, rad/s."""
    max_turn_acceleration_rps2: float = 3.0
    """Largest change of a unicycle's turn rate, rad/s²."""
    wheelbase_m: float = 0.5
    """Distance of a bicycle's axles, metres."""
    max_steer_rad: float = 0.6
    """Largest steering angle of a bicycle to either side, radians."""

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name in ("name", "kinematics", "min_speed_mps"):
                continue
            value = getattr(self, field.name)
            most = 1.5 if field.name == "max_steer_rad" else 100.0
            if not 0.0 < value <= most:
                raise SettingError(
                    f"{field.name} of {self.name}",
                    got=repr(value),
                    expected=f"a number above 0, at most {most:g}",
                )
        if not -self.max_speed_mps <= self.min_speed_mps <= 0.0:
            raise SettingError(
                f"min_speed_mps of {self.name}",
                got=repr(self.min_speed_mps),
                expected=f"0, or down to {-self.max_speed_mps:g} if it may reverse",
            )

    @property
    def limits(self) -> Limits:
        """The limits for compiled kernels."""
        return Limits(
            kind=get_args(Kinematics).index(self.kinematics),
            radius=float(self.radius_m),
            max_speed=float(self.max_speed_mps),
            min_speed=float(self.min_speed_mps),
            max_acceleration=float(self.max_acceleration_mps2),
            max_turn=float(self.max_turn_rps),
            max_turn_acceleration=float(self.max_turn_acceleration_rps2),
            wheelbase=float(self.wheelbase_m),
            max_steer=float(self.max_steer_rad),
        )

    @property
    def turn_limit(self) -> float:
        """The largest value of `RobotView.turn`: a turn rate in rad/s, or a steering angle."""
        return self.max_steer_rad if self.kinematics == "bicycle" else self.max_turn_rps


DELIVERY = Robot(
    name="delivery",
    radius_m=0.45,
    max_speed_mps=1.6,
    max_acceleration_mps2=1.0,
    max_turn_rps=1.5,
)
"""A pavement delivery robot of the size and speed that Starship Technologies publishes for its own:
0.68 m × 0.57 m, of which 0.45 m is the circumscribed radius, and 6 km/h. Accelerations and turn
rates are chosen here."""
WHEELCHAIR = Robot(
    name="wheelchair",
    radius_m=0.6,
    max_speed_mps=1.2,
    min_speed_mps=-0.4,
    max_acceleration_mps2=0.7,
    max_turn_rps=1.0,
    max_turn_acceleration_rps2=1.5,
)
"""A powered wheelchair 1.2 m long, as the occupied wheelchair of ISO 7193, at walking speed. Its
accelerations are moderate, as a passenger prefers them; they are chosen here."""
TELEPRESENCE = Robot(
    name="telepresence",
    radius_m=0.18,
    max_speed_mps=0.7,
    max_acceleration_mps2=0.8,
    max_turn_rps=math.pi,
    max_turn_acceleration_rps2=math.pi,
)
"""A telepresence base: the Kobuki base of the TurtleBot 2, 0.35 m wide, with at most 0.7 m/s and
180°/s (Yujin Robot's specification). Accelerations are chosen here."""
HOLONOMIC_ROBOT = Robot(
    name="holonomic",
    kinematics="holonomic",
    radius_m=0.3,
    max_speed_mps=1.0,
    max_acceleration_mps2=4.0,
)
"""The robot of CrowdNav (Chen et al. 2019, ICRA, "Crowd-Robot Interaction"), 0.3 m and 1 m/s. There
it changes its velocity at once; here by 4 m/s² at most."""
ROBOTS = {r.name: r for r in (DELIVERY, WHEELCHAIR, TELEPRESENCE, HOLONOMIC_ROBOT)}
"""The presets by name."""


def robot_of(robot: "str | Robot") -> Robot:
    """A preset by its name, or the robot itself.

    Raises:
        SettingError: there is no such preset.
    """
    if isinstance(robot, Robot):
        return robot
    if robot not in ROBOTS:
        raise SettingError(
            "robot",
            got=repr(robot),
            expected=f"one of {', '.join(ROBOTS)}, or a crowdbench.Robot",
            hint=did_you_mean(robot, ROBOTS),
        )
    return ROBOTS[robot]
