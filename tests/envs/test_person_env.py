"""One person of a crowd as gymnasium's environment: its checks pass, and an episode is a trip."""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from conftest import need
from given import Given
from gymnasium.utils.env_checker import check_env
from worlds import Person, square

import crowdbench
from crowdbench.colours import goal_colour
from crowdbench.envs.config import EnvConfig, EnvCrowd
from crowdbench.envs.parallel_env import parallel_env
from crowdbench.envs.person_env import PersonEnv
from crowdbench.errors import ActionError, SettingError
from crowdbench.policies import StateView, Straight
from crowdbench.simulation.observations import GOAL_DIRECTION, PREFERRED_SPEED
from crowdbench.spawn.model import Start
from crowdbench.viewer.place import rgb

EAST, STAND = np.array([1.0, 0.0], np.float32), np.zeros(2, np.float32)


def on_its_way(seen: np.ndarray) -> np.ndarray:
    """What `straight` does."""
    return seen[PREFERRED_SPEED] * seen[GOAL_DIRECTION]


@pytest.mark.parametrize("scene", crowdbench.list_scenes())
def test_gymnasiums_checks_pass(scene: str) -> None:
    settings: dict[str, Any] = {"horizon_s": 120.0, "render_mode": "rgb_array"}
    if scene == "gc-v0":  # its warm-up takes a second, and is repeated again and again
        settings["start"] = "empty"
    env = gymnasium.make(f"crowdbench/{scene}", **settings)
    check_env(env.unwrapped)  # its warnings are errors here


def test_so_they_do_with_the_nearest_people_and_a_reward_of_ones_own() -> None:
    settings: dict[str, Any] = {
        "observation": "social-1",
        "reward": lambda crowd: -crowd.remaining[..., None],
    }
    env = gymnasium.make("crowdbench/plaza-v0", horizon_s=60.0, **settings)
    check_env(env.unwrapped, skip_render_check=True)
    assert env.observation_space.shape == (102,)


def test_it_is_the_crowd_of_the_pettingzoo_view() -> None:
    env, crowd = (make("plaza-v0", horizon_s=60.0) for make in (PersonEnv, parallel_env))
    seen, info = env.reset(seed=7)
    observations, _ = crowd.reset(seed=7)
    straight = Straight()
    straight.reset(crowd.scene, np.random.default_rng(0))

    def step() -> tuple[dict[str, Any], ...]:
        """All walk as `others` do by default; the second is what they did."""
        acts = straight.act(StateView.of(crowd._simulation))
        actions = dict(zip(crowd.agents, acts, strict=True))
        return *crowd.step(actions), actions

    frame, trips = 0, []
    while frame < 149:  # in the next one the episode ends, and another crowd begins
        while frame < info["frame"]:
            observations, *_ = step()
            frame += 1
        name = f"person_{info['person_id']}"
        assert (seen == observations[name]).all()
        over = False
        while not over and frame < 149:
            observations, rewards, terminated, truncated, infos, actions = step()
            seen, reward, *ends, info = env.step(actions[name])
            frame, over = frame + 1, any(ends)
            assert (seen == observations[name]).all()
            assert reward == pytest.approx(rewards[name], abs=1e-6)
            assert ends == [terminated[name], truncated[name]]
            assert {"person_id": info.pop("person_id"), **infos[name]} == {
                "person_id": int(name.split("_")[1]), "frames_skipped": 0, **info,
            }  # fmt: skip
        trips.append(name)
        seen, info = env.reset()
    assert len(set(trips)) == len(trips) > 2


def person_of(*people: Person, **settings: Any) -> PersonEnv:
    settings = {"horizon_s": 8.0, "rays": 4, "max_alive": 4, **settings}
    return PersonEnv(square(), spawn=Given(*people), **settings)


def test_a_trip_is_an_episode_and_the_next_begins_with_who_enters_next() -> None:
    env = person_of(
        Person(start=(0.0, 0.0), goal=(2.0, 0.0)),
        Person(time_s=0.4, start=(0.0, 5.0), goal=(9.0, 5.0)),
        Person(time_s=2.0, start=(0.0, -5.0), goal=(9.0, -5.0)),
    )
    _, info = env.reset(seed=0)
    assert info == {"person_id": 0, "frame": 0}
    seen, reward, terminated, truncated, info = env.step(EAST)
    assert (terminated, truncated, info["outcome"]) == (True, False, "goal")
    assert reward == pytest.approx(sum(info["reward_parts"]))
    assert seen[2] < 0.02
    with pytest.raises(ActionError, match="a call of reset first"):
        env.step(EAST)
    _, info = env.reset()
    assert info == {"person_id": 1, "frame": 1}  # entered in the step that ended the trip
    _, info = env.reset()  # in the middle of a trip, which `others` walk on
    assert info == {"person_id": 2, "frame": 5}
    *_, terminated, truncated, info = [env.step(STAND) for _ in range(15)][-1]
    assert (terminated, truncated, info["outcome"]) == (False, True, "horizon")
    _, info = env.reset()
    assert info == {"person_id": 0, "frame": 0}  # of the next crowd


class Opened(Given):
    """Some are there before anybody enters."""

    start: ClassVar[Start] = "recorded"


def test_an_episode_is_a_whole_trip() -> None:
    there = Person(start=(0.0, 5.0), entered=False)
    env = PersonEnv(square(), spawn=Opened(there, Person(time_s=2.0)), horizon_s=8.0)
    _, info = env.reset(seed=0)
    assert info == {"person_id": 1, "frame": 5}


def course(env: gymnasium.Env, seed: int, trips: int) -> Iterator[tuple]:
    rng = np.random.default_rng(0)
    for k in range(trips):
        seen, info = env.reset(seed=None if k else seed)
        yield seen.tobytes(), str(info)
        over = False
        while not over:
            seen, reward, terminated, truncated, info = env.step(
                rng.uniform(-1, 1, 2).astype(np.float32)
            )
            yield seen.tobytes(), reward, str(info)
            over = terminated or truncated


def test_the_seed_decides_on_all_trips_that_follow() -> None:
    first, other = (
        list(course(PersonEnv("plaza-v0", horizon_s=30.0), seed=seed, trips=5)) for seed in (3, 4)
    )
    env = PersonEnv("plaza-v0", horizon_s=30.0)
    env.reset()
    again = list(course(env, seed=3, trips=5))
    assert first == again
    assert first != other


def test_what_does_not_fit_is_said() -> None:
    with pytest.raises(
        SettingError, match=r"nobody who enters in 10 episodes of 20 frames.*horizon_s"
    ):
        person_of().reset(seed=0)
    with pytest.raises(SettingError, match="render_mode: got 'human'"):
        EnvCrowd("plaza-v0", EnvConfig(), render_mode="human")  # type: ignore[arg-type]
    with pytest.raises(SettingError, match="Did you mean `horizon_s`"):
        person_of(Person(), horizon=8.0)
    env = person_of(Person())
    with pytest.raises(ActionError, match="a call of reset first"):
        env.step(EAST)
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"\(1, 2\)"):
        env.step(np.zeros(3))
    with pytest.raises(ActionError, match="not finite"):
        env.step(np.array([np.nan, 0.0]))


def test_gymnasium_makes_vectors_of_it() -> None:
    envs = gymnasium.make_vec(
        "crowdbench/plaza-v0", num_envs=2, vectorization_mode="sync", horizon_s=60.0
    )
    seen, _ = envs.reset(seed=[1, 2])
    assert (seen[0] != seen[1]).any()
    assert (seen[0] == PersonEnv("plaza-v0", horizon_s=60.0).reset(seed=1)[0]).all()
    for _ in range(5):
        seen, rewards, *_ = envs.step(np.zeros((2, 2), np.float32))
    assert rewards.shape == (2,)
    envs.close()


def test_a_picture_has_a_ring_around_the_person() -> None:
    env = person_of(
        Person(start=(-5.0, 5.0), goal=(9.0, 5.0), goal_area=2),
        Person(start=(-5.0, -5.0), goal=(9.0, -5.0), goal_area=3),
        render_mode="rgb_array",
    )
    with pytest.raises(ActionError, match="render: got no episode"):
        env.render()
    env.reset(seed=0)
    env.step(EAST)
    picture = env.render()
    assert picture is not None
    per_m = (640 - 24) / 20.0
    for y, colour, ringed in ((5.0, 2, True), (-5.0, 3, False)):
        # The first has gone 2 m, the second 0.4 m, in the step.
        column = round(12 + per_m * (10.0 + (-3.0 if ringed else -4.6)))
        row = round(12 + per_m * (10.0 - y))
        assert np.abs(picture[row, column].astype(int) - rgb(goal_colour(colour))).sum() < 10
        dark = (picture[row - 20 : row, column].sum(axis=1) < 300).any()
        assert dark == ringed


def test_without_a_render_mode_nothing_is_drawn() -> None:
    env = person_of(Person())
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


def test_gymnasium_films_it(tmp_path: Path) -> None:
    need(find_spec("moviepy"), "moviepy, of the extra video,")
    from gymnasium.wrappers import RecordVideo
    from imageio_ffmpeg import count_frames_and_secs

    env = gymnasium.make("crowdbench/plaza-v0", horizon_s=60.0, render_mode="rgb_array")
    film = RecordVideo(env, str(tmp_path / "films"), disable_logger=True)
    seen, _ = film.reset(seed=0)
    steps, over = 0, False
    while not over:
        seen, _, terminated, truncated, _ = film.step(on_its_way(seen))
        steps, over = steps + 1, terminated or truncated
    film.close()
    (path,) = (tmp_path / "films").glob("*.mp4")
    frames, seconds = count_frames_and_secs(str(path))
    assert frames == steps + 1
    assert seconds == pytest.approx(frames / 10, abs=0.2)
