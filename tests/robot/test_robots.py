"""Robots: what is possible, and what is said where something is not."""

import pytest

from crowdbench.errors import SettingError
from crowdbench.robot.robots import ROBOTS, Robot, robot_of


@pytest.mark.parametrize("name", ROBOTS)
def test_presets_are_robots_with_their_names(name: str) -> None:
    assert robot_of(name) is ROBOTS[name]
    assert robot_of(name).name == name


def test_an_unknown_preset_is_answered_by_the_nearest_name() -> None:
    with pytest.raises(SettingError, match="Did you mean `wheelchair`"):
        robot_of("wheelchairs")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("kinematics", "legs"),
        ("radius_m", 0.0),
        ("max_speed_mps", float("nan")),
        ("max_acceleration_mps2", -1.0),
        ("max_steer_rad", 1.6),
        ("min_speed_mps", 0.1),
        ("min_speed_mps", -2.0),
    ],
)
def test_impossible_values_are_refused_by_name(field: str, value: float | str) -> None:
    with pytest.raises(SettingError, match=field):
        Robot(**{field: value})
