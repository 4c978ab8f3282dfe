"""The noise of positions, and the time scales that a scene gets from it."""

from pathlib import Path

import numpy as np
import pytest
from strategies import crowd_of

from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.data.recordings.noise import noise_of
from crowdbench.data.table import Trajectories
from crowdbench.scene import load_scene
from crowdbench.scene_building.rules import walking_of


def swerving(sigma_m: tuple[float, float], dt_s: float = 0.4, people: int = 150) -> Trajectories:
    """People who walk along x with slow accelerations, and noise along and across their path."""
    rng = np.random.default_rng(2)
    frames = round(40 / dt_s)
    push = rng.normal(0, 0.25, (people, frames, 2))
    smooth = np.cumsum(np.cumsum(push, axis=1) * dt_s * 0.1, axis=1) * dt_s
    t = np.arange(frames) * dt_s
    xy = smooth + np.stack([1.4 * t, 0 * t], axis=1)
    xy += rng.normal(0, 1, xy.shape) * sigma_m
    return crowd_of([(0, frames - 1)] * people, dt_s=dt_s, xy=xy.reshape(-1, 2))


@pytest.mark.parametrize("sigma_m", [(0.05, 0.03), (0.12, 0.06)])
def test_the_noise_is_found_again(sigma_m: tuple[float, float]) -> None:
    along, across = noise_of(swerving(sigma_m), 1)
    assert along.sigma_m == pytest.approx(sigma_m[0], rel=0.1)
    assert across.sigma_m == pytest.approx(sigma_m[1], rel=0.15)
    assert along.lag_ticks >= across.lag_ticks


def test_more_noise_needs_longer_lags() -> None:
    few, many = (walking_of(swerving((s, s))).lags_ticks for s in (0.01, 0.2))
    assert few[0] < many[0]


@pytest.mark.parametrize(
    ("dt_s", "tick", "window"), [(0.1, 4, 9), (0.2, 2, 9), (0.4, 1, 9), (1.0, 1, 7)]
)
def test_ticks_are_0_4_s_and_windows_3_2_s_or_longer(dt_s: float, tick: int, window: int) -> None:
    walking = walking_of(swerving((0.03, 0.03), dt_s=dt_s, people=30))
    assert (walking.tick_frames, walking.window_ticks) == (tick, window)


@pytest.mark.parametrize("name", ["eth", "hotel"])
def test_shipped_scenes_have_the_time_scales_of_their_recordings(opentraj: Path, name: str) -> None:
    crowd = read_published(SOURCES[name], opentraj)
    assert walking_of(crowd) == load_scene(f"{name}-v0").walking


def test_people_who_stand_have_no_noise_to_speak_of() -> None:
    still = crowd_of([(0, 20)] * 3, dt_s=0.4)
    assert [axis.sigma_m for axis in noise_of(still, 1)] == [0.0, 0.0]
