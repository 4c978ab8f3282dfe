"""What an environment answers to actions and options that do not fit."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from given import Given, OneByOne, env_of, run, stand
from worlds import Person

from crowdbench.envs.parallel_env import CrowdParallelEnv, parallel_env
from crowdbench.errors import ActionError, SceneError, SettingError
from crowdbench.policies import SocialForce
from crowdbench.registry import policy, spawn_model
from crowdbench.scene import list_scenes

PAIR = (Person(), Person(start=(0.0, 5.0), goal=(8.0, 5.0)))
PAIR_NAMES = ("person_0", "person_1")

BAD: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "unknown agent": (lambda a: a | {"person_7": np.zeros(2)}, r"unknown agents \['person_7'\]"),
    "missing agent": (lambda a: {"person_0": a["person_0"]}, r"missing actions for \['person_1'\]"),
    "one for another": (lambda a: {"person_0": 0, "person_7": 0}, r"\['person_1'\].*person_7"),
    "no agents": (lambda a: {}, "missing actions for"),
    "one too short": (lambda a: a | {"person_1": np.zeros(1)}, "pairs of numbers"),
    "all too long": (lambda a: dict.fromkeys(a, np.zeros(3)), r"shape \(3,\)"),
    "scalars": (lambda a: dict.fromkeys(a, 0.5), r"shape \(\).*shape \(2,\)"),
    "nested": (lambda a: dict.fromkeys(a, np.zeros((1, 2))), r"shape \(1, 2\)"),
    "text": (lambda a: a | {"person_1": "left"}, "pairs of numbers"),
    "text in pairs": (lambda a: a | {"person_1": ["fast", "left"]}, "pairs of numbers"),
    "nothing": (lambda a: a | {"person_1": None}, "pairs of numbers"),
    "NaN": (lambda a: a | {"person_1": np.array([np.nan, 0.0])}, "nan.*from person_1.*finite"),
    "infinity": (lambda a: a | {"person_1": np.array([0.0, np.inf])}, "inf.*from person_1.*finite"),
    "no dictionary": (lambda a: None, "type NoneType"),
    "a list": (lambda a: list(a.values()), "type list"),
}


@pytest.mark.parametrize("bad", BAD)
def test_actions_that_do_not_fit_are_refused(bad: str) -> None:
    spoil, message = BAD[bad]
    env = env_of(*PAIR)
    env.reset()
    with pytest.raises(ActionError, match=message):
        env.step(spoil(stand(env)))


@pytest.mark.parametrize("bad", BAD)
def test_refused_actions_change_nothing(bad: str) -> None:
    spoil, _ = BAD[bad]
    spoiled, spared = (env_of(*PAIR) for _ in range(2))
    for env in (spoiled, spared):
        env.reset()
    with pytest.raises(ActionError):
        spoiled.step(spoil(stand(spoiled)))
    after = [env.step(run(env))[0] for env in (spoiled, spared)]
    assert all(np.array_equal(after[0][name], after[1][name]) for name in PAIR_NAMES)


@pytest.mark.parametrize("size", [1.5, 1e30, 1e300])
def test_actions_out_of_range_are_clipped(size: float) -> None:
    moved = []
    for reach in (1.0, size):
        env = env_of(*PAIR)
        env.reset()
        observations = env.step({"person_0": [reach, 0.0], "person_1": [0.0, -reach]})[0]
        moved.append(np.stack(list(observations.values())))
    assert np.array_equal(*moved)


def test_actions_may_be_lists_and_any_mapping() -> None:
    class Same(Mapping[str, list[float]]):
        def __getitem__(self, name: str) -> list[float]:
            return [1.0, 0.0]

        def __iter__(self) -> Any:
            return iter(["person_0", "person_1"])

        def __len__(self) -> int:
            return 2

    env = env_of(*PAIR)
    env.reset()
    infos = env.step(Same())[4]
    assert infos["person_0"]["reward_parts"][0] == pytest.approx(0.4)  # at 1 m/s, which it prefers


def test_nobody_acts_before_reset() -> None:
    with pytest.raises(ActionError, match="reset first"):
        env_of(*PAIR).step({})


def test_nobody_acts_after_the_end() -> None:
    env = env_of(*PAIR, horizon_s=0.4)
    env.reset()
    env.step(stand(env))
    with pytest.raises(ActionError, match="The episode is over"):
        env.step({})


def test_there_is_no_table_before_reset() -> None:
    with pytest.raises(ActionError, match="reset first"):
        env_of(*PAIR).trajectories()


def test_the_crowd_is_by_default_as_ntpp_gmm_spawns() -> None:
    assert parallel_env("plaza-v0", horizon_s=20.0).spawn.name == "ntpp-gmm"


def test_the_horizon_is_by_default_the_recordings() -> None:
    assert parallel_env("eth-v0").frames == 1934


def test_rays_set_the_size_of_an_observation() -> None:
    env = env_of(*PAIR, rays=8)
    assert env.reset()[0]["person_0"].shape == env.observation_space("person_0").shape == (14,)


def test_what_is_out_of_the_rays_range_is_not_seen() -> None:
    env = env_of(*PAIR, ray_range_m=4.0)
    assert (env.reset()[0]["person_0"][6:] == 1.0).all()


def test_a_stationary_crowd_is_there_at_frame_zero_and_an_empty_start_has_none() -> None:
    frames = {}
    for start in ("stationary", "empty"):
        _, infos = parallel_env("eth-v0", start=start).reset(seed=0)
        frames[start] = {info["frame"] for info in infos.values()}
    assert frames["stationary"] == {0}
    assert min(frames["empty"]) > 0


def test_as_many_agents_are_possible_as_asked_for() -> None:
    assert parallel_env("eth-v0", max_persons=3).possible_agents == [
        "person_0", "person_1", "person_2",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("horizon_s", 0.0),
        ("horizon_s", -100.0),
        ("horizon_s", float("nan")),
        ("horizon_s", float("inf")),
        ("rays", 0),
        ("ray_range_m", 0.0),
        ("ray_range_m", 1e-320),
        ("ray_range_m", float("nan")),
        ("max_alive", 0),
        ("max_persons", 0),
        ("on_full", "wait"),
        ("start", "full"),
        ("spawn", "poisson"),
        ("spawn", "no_such_package:Model"),
        ("spawn", "given:NoSuchClass"),
        ("spawn", ".given:OneByOne"),
        ("spawn", ":OneByOne"),
        ("spawn", "given:Incomplete"),
    ],
)
def test_options_out_of_range_are_refused(name: str, value: object) -> None:
    with pytest.raises(SettingError, match=r"got .*expected"):
        parallel_env("eth-v0", **{name: value})


def test_a_start_that_does_not_fit_the_model_is_refused() -> None:
    env = parallel_env("eth-v0", start="recorded")
    with pytest.raises(SettingError, match="start of ntpp-gmm"):
        env.reset(seed=0)


def test_an_unknown_scene_is_refused_with_the_known_ones() -> None:
    with pytest.raises(SceneError, match=", ".join(list_scenes())):
        parallel_env("moon-v0")


def test_a_scene_can_be_a_folder() -> None:
    folder = parallel_env("eth-v0").scene.folder
    assert parallel_env(Path(folder)).scene.id == "eth-v0"


def test_a_spawn_model_of_ones_own_is_made_from_the_scene() -> None:
    env = parallel_env("plaza-v0", spawn="given:OneByOne", horizon_s=60.0)
    assert isinstance(env.spawn, OneByOne)
    frames = []
    env.reset()
    while env.agents:
        infos = env.step(stand(env))[4]
        frames += [i["frame"] for i in infos.values() if i["frames_skipped"]]
    assert frames == [25, 50, 75, 100, 125]


def test_a_spawn_model_can_be_an_object() -> None:
    model = Given(*PAIR)
    env: CrowdParallelEnv = parallel_env("plaza-v0", spawn=model)
    assert env.spawn is model


def test_a_policy_of_ones_own_is_made_without_arguments() -> None:
    assert policy("given:Announcing", "plaza-v0").name == "announcing"


def test_a_policy_can_be_an_object() -> None:
    walker = SocialForce()
    assert policy(walker, "plaza-v0") is walker


@pytest.mark.parametrize("named", ["crawl", "no_such_package:Walker", "given:Nobody"])
def test_an_unknown_policy_is_refused(named: str) -> None:
    with pytest.raises(SettingError, match=f"policy: got '{named}'"):
        policy(named, "plaza-v0")


def test_what_lacks_the_parts_of_a_policy_is_refused() -> None:
    with pytest.raises(SettingError, match="without sees, reset, act"):
        policy("given:Incomplete", "plaza-v0")


def test_what_lacks_the_parts_of_a_spawn_model_is_refused() -> None:
    with pytest.raises(SettingError, match="without start, sample"):
        spawn_model("given:Incomplete", "plaza-v0")
