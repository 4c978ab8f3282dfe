"""The view of Stable-Baselines3: the other views' crowd bit for bit, an episode for each life."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from conftest import need, need_sb3

need_sb3()

from given import Given  # noqa: E402
from sb3_contrib import RecurrentPPO  # noqa: E402
from stable_baselines3 import PPO  # noqa: E402
from stable_baselines3.common.callbacks import BaseCallback  # noqa: E402
from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.vec_env import VecVideoRecorder  # noqa: E402
from worlds import Person, square  # noqa: E402

import crowdbench  # noqa: E402
from crowdbench.envs.vec_env import CrowdVecEnv  # noqa: E402
from crowdbench.errors import ActionError, CapacityError, SettingError  # noqa: E402
from crowdbench.policies import Random, Straight  # noqa: E402
from crowdbench.scene import Scene  # noqa: E402
from crowdbench.simulation.observations import GOAL_DIRECTION, GOAL_RANGE_M  # noqa: E402
from crowdbench.simulation.social import ROUTE_DIRECTION  # noqa: E402

EAST = [1.0, 0.0]


@pytest.mark.parametrize("observation", ["lidar-2", "social-1", "lidar-2-contact"])
def test_it_is_the_crowd_of_the_pettingzoo_view(observation: str) -> None:
    asked = {"horizon_s": 40.0, "rays": 8, "observation": observation}
    trips = CrowdVecEnv("plaza-v0", 80, worlds=1, seed=7, **asked)
    env = crowdbench.parallel_env("plaza-v0", **asked)
    seen, (observations, _) = trips.reset(), env.reset(seed=7)
    rng = np.random.default_rng(0)
    for _ in range(99):  # in the hundredth the episode ends, and the next begins
        who = trips.person_id
        there = np.flatnonzero(who >= 0)
        assert {f"person_{p}" for p in who[there]} == set(env.agents)
        for k in there:
            assert (seen[k] == observations[f"person_{who[k]}"]).all()
        actions = rng.uniform(-1, 1, (80, 2)).astype(np.float32)
        seen, rewards, dones, infos = trips.step(actions)
        observations, of_agents, terminated, truncated, _ = env.step(
            {f"person_{who[k]}": actions[k] for k in there}
        )
        for k in there:
            name = f"person_{who[k]}"
            assert infos[k]["person_id"] == who[k]
            assert rewards[k] == pytest.approx(of_agents[name], abs=1e-6)
            assert dones[k] == (terminated[name] or truncated[name])
            if dones[k]:
                assert infos[k]["TimeLimit.truncated"] == truncated[name]
                assert (infos[k]["terminal_observation"] == observations[name]).all()
    assert trips.waited > 0


def test_others_walk_alike_whatever_the_frame_of_the_observation() -> None:
    rays, own = (
        CrowdVecEnv("plaza-v0", 3, worlds=2, seed=1, horizon_s=40.0, observation=name)
        for name in ("lidar-2", "social-1")
    )
    assert isinstance(rays.others, Straight)
    for env in (rays, own):
        env.reset()  # after a warm-up with straight walkers
    for _ in range(50):
        places, again = (env._simulation.slots.position for env in (rays, own))
        assert places.tobytes() == again.tobytes()
        for env in (rays, own):
            env.step(np.zeros((3, 2)))  # the same in either frame


class Guided:
    """Walks on its way, in the frame of what it sees, and decides in every second frame."""

    name, sees, interval = "guided", "observation", 2

    def __init__(self, observation: str) -> None:
        self.observation = observation

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        pass

    def act(self, seen: np.ndarray) -> np.ndarray:
        rays = self.observation == "lidar-2"
        return 0.5 * seen[:, GOAL_DIRECTION if rays else ROUTE_DIRECTION]


@pytest.mark.parametrize("theirs", ["lidar-2", "social-1"])
def test_others_see_what_they_need_whichever_observation_the_environment_has(theirs: str) -> None:
    crowds = []
    for observation in ("lidar-2", "social-1"):
        env = CrowdVecEnv(
            "plaza-v0", 3, worlds=2, seed=1, horizon_s=40.0,
            observation=observation, others=Guided(theirs),
        )  # fmt: skip
        seen = env.reset()
        places = []
        for _ in range(150):  # the horizon is among them
            seen, *_ = env.step(np.zeros((3, 2)))
            places.append(env._simulation.slots.position.copy())
        assert seen.shape[1] == env.observation_space.shape[0]
        crowds.append(np.stack(places))
    assert np.ptp(crowds[0], axis=0).max() > 5.0  # they walk
    assert crowds[0].tobytes() == crowds[1].tobytes()


def lives_of(*people: Person, num_envs: int = 1, **changes: object) -> CrowdVecEnv:
    asked = {"worlds": 1, "rays": 4, "horizon_s": 8.0, "max_alive": 4, "seed": 0, **changes}
    return CrowdVecEnv(square(), num_envs, spawn=Given(*people), **asked)


def test_after_a_life_comes_another_person() -> None:
    env = lives_of(
        Person(start=(0.0, 0.0), goal=(2.0, 0.0)),
        Person(time_s=0.4, start=(0.0, 5.0), goal=(9.0, 5.0)),
    )
    first = env.reset()
    assert env.person_id.tolist() == [0]
    assert first[0, 2] == pytest.approx(2.0 / GOAL_RANGE_M)
    seen, rewards, dones, infos = env.step(np.array([EAST]))
    assert dones.tolist() == [True]
    assert rewards[0] > 0.4
    assert infos[0]["outcome"] == "goal"
    assert not infos[0]["TimeLimit.truncated"]
    assert infos[0]["terminal_observation"][2] < 0.02
    assert env.person_id.tolist() == [1]
    assert seen[0, :2].tolist() == [0.0, 0.0]
    assert seen[0, 2] == pytest.approx(9.0 / GOAL_RANGE_M)


def test_of_those_whom_nobody_has_the_one_who_entered_last_is_chosen() -> None:
    env = lives_of(
        Person(start=(0.0, 0.0), goal=(2.0, 0.0)),
        Person(start=(0.0, 5.0), goal=(9.0, 5.0)),
        Person(time_s=0.4, start=(0.0, -5.0), goal=(9.0, -5.0)),
    )
    env.reset()
    env.step(np.array([EAST]))
    assert env.person_id.tolist() == [2]


def test_the_others_walk() -> None:
    people = (Person(start=(0.0, -5.0), goal=(9.0, -5.0)), Person(goal=(8.0, 0.0), speed=1.0))
    env = lives_of(*people)
    env.reset()
    for _ in range(5):
        env.step(np.zeros((1, 2)))
    slots = env._simulation.slots
    assert slots.position[0, :2].tolist() == [[0.0, -5.0], pytest.approx([2.0, 0.0])]
    env.others = Random()
    env.reset()
    env.step(np.zeros((1, 2)))
    assert slots.position[0, 1, 1] != env._simulation.slots.position[0, 1, 1]


def test_who_finds_nobody_waits_and_learns_nothing_of_it() -> None:
    env = lives_of(Person(), Person(time_s=0.8, start=(0.0, 5.0)), num_envs=2)
    seen = env.reset()
    assert env.person_id.tolist() == [0, -1]
    assert not seen[1].any()
    seen, rewards, dones, infos = env.step(np.zeros((2, 2)))
    assert dones.tolist() == [False, True]
    assert rewards[1] == 0.0
    assert infos[1]["waiting"]
    assert not infos[1]["terminal_observation"].any()
    seen, _, dones, _ = env.step(np.zeros((2, 2)))  # someone came
    assert dones.tolist() == [False, True]
    assert env.person_id.tolist() == [0, 1]
    assert seen[1].any()
    assert env.waited == 2


def test_infos_sum_up_trips_and_no_waiting_steps() -> None:
    env = CrowdVecEnv("plaza-v0", 40, worlds=1, horizon_s=40.0, seed=0)
    env.reset()
    rewards, steps = np.zeros(40), np.zeros(40, np.int64)
    trips, waited = [], 0
    rng = np.random.default_rng(0)
    for _ in range(250):  # two and a half episodes of the world
        _, gained, dones, infos = env.step(rng.uniform(-1, 1, (40, 2)))
        rewards, steps = rewards + gained, steps + 1
        for k in np.flatnonzero(dones):
            if "waiting" in infos[k]:
                assert "episode" not in infos[k]
                waited += 1
            else:
                trips.append(infos[k]["episode"])
                assert trips[-1]["r"] == pytest.approx(rewards[k], abs=1e-4)
                assert trips[-1]["l"] == steps[k]
            rewards[k] = steps[k] = 0
        assert not any("episode" in infos[k] for k in np.flatnonzero(~dones))
    assert len(trips) > 20
    assert waited == env.waited > 0
    seconds = [trip["t"] for trip in trips]
    assert 0 < seconds[0] <= seconds[-1]


def test_evaluations_count_trips_and_no_waiting_steps() -> None:
    class Still:
        def predict(self, seen: np.ndarray, **_: object) -> tuple[np.ndarray, None]:
            return np.zeros((len(seen), 2)), None

    env = lives_of(Person(), Person(time_s=4.0, start=(0.0, 5.0)), num_envs=2)
    # It would warn of episodes that are not those of a Monitor.
    _, steps = evaluate_policy(Still(), env, n_eval_episodes=4, return_episode_rewards=True)  # type: ignore[arg-type]
    assert sorted(steps) == [10, 10, 20, 20]


class Buffered(BaseCallback):
    """Keeps what a rollout buffer contains when advantages are known, and who waited."""

    def _on_training_start(self) -> None:
        self.waits: list[list[bool]] = []

    def _on_step(self) -> bool:
        self.waits.append(["waiting" in info for info in self.locals["infos"]])
        return True

    def _on_rollout_end(self) -> None:
        buffer = self.locals["rollout_buffer"]
        names = ("observations", "rewards", "values", "advantages", "episode_starts")
        self.kept = {name: getattr(buffer, name).copy() for name in names}


@pytest.mark.parametrize("recurrent", [False, True])
def test_no_advantage_passes_between_a_waiting_step_and_a_trip(recurrent: bool) -> None:
    env = lives_of(
        Person(start=(0.0, 0.0), goal=(0.1, 0.0)),  # arrives at once
        Person(time_s=3.2, start=(0.0, 5.0), goal=(9.0, 5.0)),
        Person(time_s=4.0, start=(0.0, -5.0), goal=(0.1, -5.0)),
        num_envs=2,
    )
    asked = {"n_steps": 40, "batch_size": 80, "n_epochs": 1, "seed": 0, "device": "cpu"}
    asked["policy_kwargs"] = {"log_std_init": -4.0}
    if recurrent:
        model = RecurrentPPO("MlpLstmPolicy", env, **asked)
    else:
        model = PPO("MlpPolicy", env, **asked)
    seen = Buffered()
    model.learn(80, callback=seen)  # twice until the horizon
    kept, waits = seen.kept, np.array(seen.waits)
    assert env.waited == waits.sum() > 20
    np.testing.assert_allclose(kept["advantages"][waits], -kept["values"][waits], atol=1e-6)
    assert np.ptp(kept["advantages"][waits]) < 1e-6  # all see the same, and the action is the same
    assert not kept["observations"][waits].any()
    assert not kept["rewards"][waits].any()
    trips = 0
    for k in range(2):
        starts = np.flatnonzero(kept["episode_starts"][:, k])
        for first, end in zip(starts, [*starts[1:], 40], strict=True):
            if waits[first, k]:
                assert end == first + 1
                continue
            trips += 1
            alone = 0.0
            following = 0.0  # value of the next step of this trip
            for t in range(end - 1, first - 1, -1):
                value = kept["values"][t, k]
                gap = kept["rewards"][t, k] + model.gamma * following - value
                alone = gap + model.gamma * model.gae_lambda * alone
                assert kept["advantages"][t, k] == pytest.approx(alone, abs=1e-5)
                following = value
    assert trips == 6


def test_the_horizon_truncates_all_and_begins_anew() -> None:
    env = lives_of(Person(), horizon_s=0.8)
    env.reset()
    _, _, dones, _ = env.step(np.zeros((1, 2)))
    assert not dones.any()
    seen, _, dones, infos = env.step(np.zeros((1, 2)))
    assert dones.all()
    assert infos[0]["outcome"] == "horizon"
    assert infos[0]["TimeLimit.truncated"]
    assert (seen == env.reset()).all()  # these people always come in the same way


def test_the_seed_decides() -> None:
    first = CrowdVecEnv("plaza-v0", 4, worlds=2, horizon_s=20.0, seed=3).reset()
    env = CrowdVecEnv("plaza-v0", 4, worlds=2, horizon_s=20.0)
    env.seed(3)
    assert (env.reset() == first).all()
    assert (env.reset() != first).any()


def test_persons_are_enough_where_nothing_is_said_of_worlds() -> None:
    env = CrowdVecEnv("plaza-v0", 32, horizon_s=80.0, seed=0)
    env.reset()
    for _ in range(150):
        env.step(np.zeros((32, 2)))
    assert env.waited < 0.01 * 150 * 32


def test_what_does_not_fit_is_said() -> None:
    for asked in ({"num_envs": 0}, {"worlds": 0}, {"horizon_s": -1.0}):
        with pytest.raises(SettingError, match=next(iter(asked))):
            CrowdVecEnv("plaza-v0", **asked)
    env = lives_of(Person())
    env.reset()
    with pytest.raises(ActionError, match=r"\(1, 2\)"):
        env.step(np.zeros((2, 2)))
    with pytest.raises(ActionError, match="not finite"):
        env.step(np.full((1, 2), np.nan))
    with pytest.raises(CapacityError, match="max_alive"):
        lives_of(Person(), Person(), max_alive=1).reset()
    with pytest.raises(SettingError, match="not separate objects"):
        env.env_method("step")


def test_a_picture_has_a_ring_around_each_who_is_controlled() -> None:
    people = (Person(start=(0.0, 5.0)), Person(start=(0.0, -5.0)), Person(start=(0.0, 0.0)))
    black = []
    for number in (1, 3):
        env = lives_of(*people, num_envs=number, worlds=2, render_mode="rgb_array")
        env.reset()
        env.step(np.zeros((number, 2)))
        with_rings, without = env.render(), env._crowd.render()
        assert with_rings is not None
        assert without is not None
        black.append(sum(sign * int((picture.sum(axis=2) < 300).sum())
                         for sign, picture in ((1, with_rings), (-1, without))))  # fmt: skip
    assert black[1] == pytest.approx(3 * black[0], rel=0.1)
    assert black[0] > 50


def test_pictures_change_nothing() -> None:
    plain, pictured = (
        CrowdVecEnv("plaza-v0", 4, worlds=2, horizon_s=20.0, seed=3, render_mode=mode)
        for mode in (None, "rgb_array")
    )
    assert (plain.reset() == pictured.reset()).all()
    for _ in range(60):
        pictured.render()
        one, other = (env.step(np.zeros((4, 2))) for env in (plain, pictured))
        assert all((a == b).all() for a, b in zip(one[:3], other[:3], strict=True))
    with pytest.warns(UserWarning, match="no `render_mode`"):
        assert plain.render() is None


# Of moviepy, and of gymnasium's recorder, which SB3 2.2 uses.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_stable_baselines_films_it(tmp_path: Path) -> None:
    need(find_spec("moviepy"), "moviepy, of the extra video,")
    from imageio_ffmpeg import count_frames_and_secs

    env = CrowdVecEnv("plaza-v0", 4, horizon_s=40.0, seed=0, render_mode="rgb_array")
    film = VecVideoRecorder(env, str(tmp_path), lambda step: step == 0, video_length=12)
    film.reset()
    for _ in range(20):
        film.step(np.zeros((4, 2)))
    film.close()
    (path,) = tmp_path.glob("*.mp4")
    frames, seconds = count_frames_and_secs(str(path))
    assert frames in (12, 13)  # by versions of SB3
    assert seconds == pytest.approx(frames / 10, abs=0.2)


def test_stable_baselines_trains_in_it() -> None:
    env = CrowdVecEnv("plaza-v0", 16, horizon_s=120.0, rays=8, seed=0)
    model = PPO("MlpPolicy", env, n_steps=128, batch_size=512, n_epochs=4, learning_rate=1e-3,
                gamma=0.95, seed=0, device="cpu")  # fmt: skip
    model.learn(2048)
    early = np.mean([e["r"] for e in model.ep_info_buffer])
    model.learn(40_960, reset_num_timesteps=False)
    late = np.mean([e["r"] for e in model.ep_info_buffer])
    assert late > early + 2.0  # metres nearer to the goal


def test_the_crowd_is_by_default_as_ntpp_gmm_spawns() -> None:
    assert CrowdVecEnv("plaza-v0", 4, horizon_s=20.0).spawn.name == "ntpp-gmm"
