"""Robots as environments of gymnasium and Stable-Baselines3."""

import gymnasium
import numpy as np
import pytest
from conftest import need_sb3
from gymnasium.utils.env_checker import check_env
from lonely_robots import DISC

import crowdbench
from crowdbench.errors import SettingError
from crowdbench.robot.env import RobotEnv
from crowdbench.robot.measures import MEASURES
from crowdbench.robot.robots import Robot
from crowdbench.robot.vector_env import FINAL, MODES, RobotVectorEnv

QUICK = {"spawn": "poisson-gmm", "time_limit_s": 8.0, "horizon_s": 40.0}
KINEMATICS = ("holonomic", "unicycle", "bicycle")
OBSERVATIONS = ("social", "lidar", "state")
needs_modes = pytest.mark.skipif(MODES is None, reason="gymnasium before 1.1 has one way only")


def checked(scene: str, kinematics: str, observation: str) -> None:
    env = RobotEnv(scene, robot=Robot(kinematics=kinematics), observation=observation, **QUICK)
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize(
    ("scene", "kinematics", "observation"),
    list(zip(("eth-v0", "plaza-v0", "zara1-v0"), KINEMATICS, OBSERVATIONS, strict=True)),
)
def test_gymnasium_accepts_it(scene: str, kinematics: str, observation: str) -> None:
    checked(scene, kinematics, observation)


@pytest.mark.nightly
@pytest.mark.parametrize("scene", crowdbench.list_scenes())
@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_gymnasium_accepts_all(scene: str, kinematics: str, observation: str) -> None:
    checked(scene, kinematics, observation)


@pytest.mark.parametrize("scene", crowdbench.list_scenes())
def test_gymnasium_makes_it_by_name(scene: str) -> None:
    assert (
        gymnasium.spec(f"crowdbench/Robot-{scene}").entry_point == "crowdbench.robot.env:RobotEnv"
    )


def test_make_and_make_vec_give_the_same_episodes() -> None:
    env = gymnasium.make("crowdbench/Robot-eth-v0", **QUICK)
    if MODES is None:  # its make_vec passes no scene
        many = RobotVectorEnv("eth-v0", 3, **QUICK)
    else:
        mode = "vector_entry_point"
        name = "crowdbench/Robot-eth-v0"
        many = gymnasium.make_vec(name, num_envs=3, vectorization_mode=mode, **QUICK)
    first, info = env.reset(seed=5)
    assert info == {"people_react": True}
    all_first, _ = many.reset(seed=4)
    np.testing.assert_array_equal(all_first[1], first)
    many.action_space.seed(0)
    ended = False
    while not ended:
        actions = many.action_space.sample()
        observation, reward, terminated, truncated, info = env.step(actions[1])
        seen, rewards, terminations, truncations, infos = many.step(actions)
        assert (reward, terminated, truncated) == (rewards[1], terminations[1], truncations[1])
        ended = terminated or truncated
    assert set(info) == set(MEASURES)
    last, final = (infos[name] for name in FINAL)
    np.testing.assert_array_equal(last[1], observation)
    measured = final[1] if MODES is None else {name: final[name][1] for name in MEASURES}
    assert measured == pytest.approx(info, nan_ok=True)
    again, _ = env.reset()
    np.testing.assert_array_equal(seen[1], again)


@needs_modes
def test_the_next_step_begins_the_next_episode() -> None:
    env = RobotVectorEnv("eth-v0", 2, autoreset="next_step", **QUICK)
    same = RobotVectorEnv("eth-v0", 2, **QUICK)
    assert env.metadata["autoreset_mode"] == MODES.NEXT_STEP
    env.reset(seed=0), same.reset(seed=0)
    stay = np.zeros((2, 2), np.float32)
    for _ in range(30):
        seen, _, terminated, truncated, infos = env.step(stay)
        other, _, _, ended, finals = same.step(stay)
        if (terminated | truncated).any():
            break
    np.testing.assert_array_equal(truncated, ended)
    over = terminated | truncated
    np.testing.assert_array_equal(seen[over], finals["final_obs"][over])
    np.testing.assert_array_equal(infos["time_s"][over], finals["final_info"]["time_s"][over])
    assert not np.array_equal(seen[over], other[over])
    _, reward, terminated, truncated, _ = env.step(stay)
    assert (reward[over] == 0).all()
    assert not (terminated | truncated)[over].any()


@needs_modes
def test_chosen_worlds_begin_anew() -> None:
    env = RobotVectorEnv("eth-v0", 3, autoreset="disabled", **QUICK)
    with pytest.raises(SettingError, match="reset_mask"):
        env.reset(seed=0, options={"reset_mask": np.array([True, False, False])})
    env.reset(seed=0)
    before = env.step(np.zeros((3, 2), np.float32))[0]
    mask = np.array([False, True, False])
    after, _ = env.reset(options={"reset_mask": mask})
    assert [np.array_equal(before[k], after[k]) for k in range(3)] == [True, False, True]
    with pytest.raises(SettingError, match="seed"):
        env.reset(seed=[1, 2])


def test_an_unknown_way_to_begin_anew_is_refused() -> None:
    with pytest.raises(SettingError, match="autoreset"):
        RobotVectorEnv("eth-v0", 2, autoreset="never", **QUICK)


def test_people_who_do_not_react_are_named() -> None:
    _, info = RobotEnv("plaza-v0", visible=False, **QUICK).reset(seed=0)
    assert info == {"people_react": False}


def test_a_dictionary_of_states_is_batched() -> None:
    env = RobotVectorEnv("plaza-v0", 4, observation="state", robot=DISC, **QUICK)
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    for _ in range(21):  # past the end of an episode
        seen, *_ = env.step(env.action_space.sample())
    assert env.observation_space.contains(seen)


def test_stable_baselines_trains_on_it() -> None:
    need_sb3()
    from stable_baselines3 import PPO

    from crowdbench.robot.sb3 import RobotVecEnv

    env = RobotVecEnv("plaza-v0", 4, seed=0, **QUICK)
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=32, n_epochs=1, seed=0)
    model.learn(256)
    assert len(model.ep_info_buffer) > 0
    env.seed(3)
    first = env.reset()
    infos = []
    for _ in range(30):
        _, _, dones, told = env.step(np.zeros((4, 2)))
        infos += [info for info, done in zip(told, dones, strict=True) if done]
    assert set(MEASURES) < set(infos[0])
    assert infos[0]["terminal_observation"].shape == first[0].shape
    env.seed(3)
    np.testing.assert_array_equal(env.reset(), first)


def test_many_worlds_are_shown_side_by_side() -> None:
    env = RobotVectorEnv("plaza-v0", 3, render_mode="rgb_array", **QUICK)
    env.reset(seed=1)
    alone = RobotEnv("plaza-v0", render_mode="rgb_array", **QUICK)
    alone.reset(seed=2)
    stay, over = np.zeros((3, 2), np.float32), False
    while not over:
        pictures = env.render()
        assert pictures is not None
        assert len(pictures) == 3
        np.testing.assert_array_equal(pictures[1], alone.render())
        env.step(stay)
        *_, terminated, truncated, _ = alone.step(stay[1])
        over = terminated or truncated
    alone.reset()
    np.testing.assert_array_equal(env.render()[1], alone.render())
    assert RobotVectorEnv("plaza-v0", 1, **QUICK).render() is None
    with pytest.raises(SettingError, match="render_mode"):
        RobotVectorEnv("plaza-v0", 1, render_mode="human", **QUICK)


def test_stable_baselines_shows_up_to_four_worlds() -> None:
    need_sb3()
    from crowdbench.robot.sb3 import RobotVecEnv

    env = RobotVecEnv("plaza-v0", 6, seed=1, render_mode="rgb_array", **QUICK)
    env.reset()
    env.step(np.zeros((6, 2), np.float32))
    height, width, _ = env.get_images()[0].shape
    assert env.render().shape == (2 * height, 2 * width, 3)
    assert env.get_attr("render_mode") == ["rgb_array"] * 6
    with pytest.raises(SettingError, match="render_mode"):
        RobotVecEnv("plaza-v0", 1, render_mode="human", **QUICK)
