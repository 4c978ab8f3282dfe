"""An environment's `render_mode`: pictures, or a viewer that follows, and nothing else changes."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import need
from given import DT, env_of, run, stand
from pettingzoo.test import render_test
from pettingzoo.test.example_envs import generated_agents_parallel_v0
from pettingzoo.utils import BaseParallelWrapper, parallel_to_aec
from rrds import entities, forget_types, rows
from worlds import Person, box, square

from crowdbench.colours import goal_colour
from crowdbench.data.table import Trajectories
from crowdbench.envs.parallel_env import CrowdParallelEnv, parallel_env
from crowdbench.errors import ActionError, SettingError
from crowdbench.scene import load_scene
from crowdbench.viewer import access
from crowdbench.viewer.place import rgb

PEOPLE = "/world/simulation/people"


@pytest.fixture
def streamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Path]]:
    """What a user's program logs to rerun goes to a file: a call closes and names it."""
    need(find_spec("rerun"), "rerun, of the extra viewer,")
    import rerun as rr

    path = tmp_path / "mine.rrd"
    forget_types(monkeypatch)

    def closed() -> Path:
        stream.disconnect()
        return path

    with rr.RecordingStream("mine") as stream:
        stream.save(path)
        yield closed


def to_the_end(env: CrowdParallelEnv, seed: int = 0) -> Trajectories:
    """An episode in which everyone walks to the goal; each frame is rendered."""
    observations, _ = env.reset(seed=seed)
    while env.agents:
        env.render()
        observations, *_ = env.step({n: 0.3 * observations[n][3:5] for n in env.agents})
    env.render()
    env.close()
    return env.trajectories()


def test_rendering_changes_nothing(streamed: Callable[[], Path]) -> None:
    make = partial(parallel_env, "plaza-v0", horizon_s=60.0)
    with pytest.warns(UserWarning, match="render_mode"):
        plain = to_the_end(make())
    for mode in ("human", "rgb_array"):
        rendered = to_the_end(make(render_mode=mode))
        assert np.array_equal(plain.xy, rendered.xy)
        assert np.array_equal(plain.outcome, rendered.outcome)


def test_it_renders_as_pettingzoo_wants_it(streamed: Callable[[], Path]) -> None:
    render_test(lambda render_mode: parallel_to_aec(
        parallel_env("plaza-v0", horizon_s=60.0, render_mode=render_mode)
    ))  # fmt: skip


def test_the_modes_are_declared_as_other_environments_declare_them() -> None:
    env = env_of(render_mode="rgb_array")
    assert set(env.metadata["render_modes"]) == {"human", "rgb_array"}
    assert int(env.metadata["render_fps"]) > 0  # what wrappers that film ask for
    assert BaseParallelWrapper(env).render_mode == "rgb_array"
    theirs = generated_agents_parallel_v0.parallel_env()
    assert env_of().render_mode is theirs.render_mode is None


def pixels(env: CrowdParallelEnv) -> np.ndarray:
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    return picture


def coloured(picture: np.ndarray, goal_area: int) -> np.ndarray:
    """Row and column of each pixel in the colour of those who walk to an area."""
    near = np.abs(picture.astype(int) - rgb(goal_colour(goal_area))).sum(axis=2) < 10
    return np.argwhere(near)


def test_pictures_have_a_size_that_videos_can_have() -> None:
    for name in ("eth-v0", "gc-v0", "forum-v0"):
        scene = load_scene(name)
        env = parallel_env(scene, horizon_s=4.0, render_mode="rgb_array")
        env.reset(seed=0)
        height, width, colours = pixels(env).shape
        assert (height % 2, width % 2, colours) == (0, 0, 3)
        assert max(height, width) == 640
        b = scene.bounds
        shape = (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m)
        assert (height - 24) / (width - 24) == pytest.approx(shape, abs=0.01)


def test_people_stand_where_they_are_x_to_the_right_and_y_up() -> None:
    scene = square(10.0)
    person = Person(start=(6.0, 8.0), goal=(-5.0, -5.0), goal_area=2)
    env = env_of(person, scene=scene, render_mode="rgb_array")
    env.reset(seed=0)
    picture = pixels(env)
    found = coloured(picture, 2)
    top_right = found[found[:, 0] < 320]
    per_m = (640 - 24) / 20.0
    expected = 12 + per_m * np.array([10.0 - 8.0, 6.0 + 10.0])
    assert top_right.mean(axis=0) == pytest.approx(expected, abs=1.0)
    radius_m = np.sqrt(len(top_right) / np.pi) / per_m
    assert radius_m == pytest.approx(scene.motion.person_radius_m, rel=0.15)
    goal = found[found[:, 0] >= 320]
    assert goal.mean(axis=0) == pytest.approx(12 + per_m * np.array([15.0, 5.0]), abs=1.0)


def test_a_trail_is_what_was_walked_in_two_seconds() -> None:
    env = env_of(Person(start=(-8.0, 3.0), goal=(9.0, 3.0), goal_area=2), render_mode="rgb_array")
    env.reset(seed=0)
    lengths = []
    for _ in range(8):
        env.step(run(env, (0.5, 0.0)))  # 1 m in a frame
        picture = coloured(pixels(env), 2)
        columns = picture[picture[:, 1] < 550][:, 1]
        lengths.append((columns.max() - columns.min()) / ((640 - 24) / 20.0))
    # Of a fixed length after two seconds; at both ends there is a disc or the line's own width.
    assert np.diff(lengths[:5]) == pytest.approx(1.0, abs=0.1)
    assert lengths[5:] == pytest.approx([5.3] * 3, abs=0.2)


def test_walls_are_drawn() -> None:
    env = env_of(Person(), scene=square(10.0, box(-9, -9, 9, -5)), render_mode="rgb_array")
    env.reset(seed=0)
    picture = pixels(env)
    assert (picture[560, 320] < 200).all()
    assert (picture[200, 320] > 250).all()


def test_a_picture_is_the_users_own() -> None:
    env = env_of(Person(), render_mode="rgb_array")
    env.reset(seed=0)
    first = pixels(env)
    before = first.copy()
    first[:] = 0
    assert np.array_equal(pixels(env), before)


APART = (Person(goal=(2.0, 0.0)), Person(time_s=20.0, goal=(2.0, 0.0)))
"""A person who arrives at once, and another after a long time without anyone."""


def test_frames_without_anyone_can_be_skipped() -> None:
    env = env_of(*APART, render_mode="rgb_array")
    env.reset(seed=0)
    pictures = [pixels(env)]
    while env.agents:
        _, _, _, _, infos = env.step(run(env))
        pictures.append(pixels(env))
    assert max(info["frames_skipped"] for info in infos.values()) == 0
    assert len({picture.tobytes() for picture in pictures}) == len(pictures)  # the clock goes on


def test_nobody_ever_is_a_picture_too() -> None:
    env = env_of(render_mode="rgb_array")
    env.reset(seed=0)
    assert env.agents == []
    assert len(np.unique(pixels(env).reshape(-1, 3), axis=0)) > 3


def test_a_users_recording_stream_gets_each_frame(streamed: Callable[[], Path]) -> None:
    env = env_of(*APART, render_mode="human")
    env.reset(seed=0)
    while env.agents:
        assert env.render() is None
        env.step(run(env))
    env.close()
    crowd, path = env.trajectories(), streamed()
    here = rows(path, PEOPLE, "Points2D:positions")
    agents = rows(path, "/agents/simulation", "Scalars:scalars")
    present = {f: int(n) for f, n in enumerate(crowd.present().tolist()) if n}
    assert present.items() <= {f: len(xy) for f, xy in here.items()}.items()
    for row, frame in enumerate(crowd.row_frame().tolist()):
        assert np.array_equal(here[frame], crowd.xy[row : row + 1])
    gone = int(crowd.last[0]) + 1
    assert agents[gone].tolist() == [0.0]  # at the first of the frames that were skipped
    cleared = rows(path, PEOPLE, "Clear:is_recursive")
    assert list(cleared) == [gone, int(crowd.last[1]) + 1]
    ids = rows(path, PEOPLE, "person_id")
    assert ids[int(crowd.first[1])].tolist() == [1]
    times = rows(path, PEOPLE, "Points2D:positions", clock="time")
    assert np.array(list(times)) / 1e9 == pytest.approx([frame * DT for frame in here])


def test_the_viewer_is_told_outcomes_and_spawns(streamed: Callable[[], Path]) -> None:
    env = env_of(*APART, render_mode="human")
    env.reset(seed=0)
    while env.agents:
        env.step(run(env))
    env.close()
    path = streamed()
    said = rows(path, "/outcomes", "TextLog:text")
    assert {f: v.tolist() for f, v in said.items()} == {
        1: ["0.4 s: person 0 reached the goal after 0.4 s"],
        51: ["20.4 s: person 1 reached the goal after 0.4 s"],
    }
    spawns = rows(path, "/spawns/simulation", "Scalars:scalars")
    # Who is there from the start has not come; windows of ten frames, the last one that is over.
    counts = {f: v.tolist() for f, v in spawns.items()}
    assert counts == {0: [0.0], 10: [0.0], 20: [0.0], 30: [0.0], 40: [0.0], 50: [1.0], 60: [0.0],
                      70: [0.0], 80: [0.0], 90: [0.0]}  # fmt: skip


def test_episodes_follow_each_other_on_one_clock(streamed: Callable[[], Path]) -> None:
    env = env_of(Person(time_s=2.0), horizon_s=4.0, render_mode="human")
    for _ in range(2):
        env.reset(seed=0)
        while env.agents:
            env.step(stand(env))
    env.close()
    path = streamed()
    assert {"/world/place/walls", "/world/simulation/trails"} <= entities(path)
    there = [f for f, xy in rows(path, PEOPLE, "Points2D:positions").items() if len(xy)]
    assert there == [*range(5, 11), *range(16, 22)]


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no mode": ({"render_mode": "ansi"}, "got 'ansi' .* expected 'human' or"),
    "no rerun": ({"render_mode": "human"}, r'-e "\.\[viewer\]"'),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_rendered_is_said_when_it_is_made(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)  # what is not installed cannot be found
    options, message = BAD[what]
    with pytest.raises(SettingError, match=message):
        env_of(**options)


def test_without_a_screen_the_viewer_does_not_open(monkeypatch: pytest.MonkeyPatch) -> None:
    need(find_spec("rerun"), "rerun, of the extra viewer,")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(access, "PORT", 1)
    env = env_of(Person(), render_mode="human")
    with pytest.raises(SettingError, match="no screen"):
        env.reset(seed=0)


def test_before_reset_there_is_nothing_to_draw() -> None:
    with pytest.raises(ActionError, match="render: got no episode; expected a call of reset first"):
        env_of(render_mode="rgb_array").render()


def test_a_place_that_nobody_has_fitted_can_be_drawn(tmp_path: Path) -> None:
    scene = replace(square(10.0), folder=tmp_path)
    env = env_of(Person(goal_area=-1), scene=scene, render_mode="rgb_array")
    env.reset(seed=0)
    assert len(np.unique(pixels(env).reshape(-1, 3), axis=0)) > 3
