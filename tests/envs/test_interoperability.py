"""Other libraries, the real ones: what docs/interoperability.md says works does; the rest fails."""

import json
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pages
import pytest
from conftest import need
from given import env_of
from given import run as walk
from worlds import Person

import crowdbench
from crowdbench import Demonstrations, demonstrations, parallel_env
from crowdbench.envs.parallel_env import CrowdParallelEnv
from crowdbench.errors import ActionError, OutputError, SettingError
from crowdbench.registry import import_recording

pytestmark = pytest.mark.long

PAGE = (Path(__file__).parents[2] / "docs" / "interoperability.md").read_text()
GAPS = ("zara1-v0", 200.0)
"""A scene, and a horizon in seconds in which everyone leaves now and then."""


def names_of(library: str) -> dict[str, Any]:
    """What the page's code with a library defines, after it has run."""
    (code,) = [b for b in pages.blocks(PAGE, "python") if f"import {library}\n" in b]
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(code, "docs/interoperability.md", "exec"), names)
    return names


def towards_goals(observations: dict[str, np.ndarray], rng: np.random.Generator) -> dict:
    """Actions that go to the goals with some noise."""
    return {
        name: (0.6 * seen[3:5] + rng.normal(0, 0.1, 2)).clip(-1, 1).astype(np.float32)
        for name, seen in observations.items()
    }


# SuperSuit


@pytest.fixture
def supersuit() -> Any:
    need(find_spec("supersuit"), "supersuit")
    import supersuit

    return supersuit


def unchanged(value: Any, space: Any = None) -> Any:
    return value


SAME: dict[str, tuple] = {
    "action_lambda_v1": (unchanged, unchanged),
    "clip_actions_v0": (),
    "clip_reward_v0": (-1e9, 1e9),
    "delay_observations_v0": (0,),
    "dtype_v0": (np.float32,),
    "flatten_v0": (),
    "frame_stack_v1": (1,),
    "frame_stack_v2": (1,),
    "max_observation_v0": (1,),
    "nan_random_v0": (),
    "nan_zeros_v0": (),
    "normalize_obs_v0": (-1.0, 1.0),
    "observation_lambda_v0": (unchanged,),
    "pad_action_space_v0": (),
    "pad_observations_v0": (),
    "reshape_v0": ((38,),),
    "reward_lambda_v0": (unchanged,),
    "scale_actions_v0": (1.0,),
    "sticky_actions_v0": (0.0,),
}
"""Wrappers with settings in which they change nothing."""


def assert_same(one: tuple, other: tuple) -> None:
    assert len(one) == len(other)
    for ours, theirs in zip(one, other, strict=True):
        assert set(ours) == set(theirs)
        for name, value in ours.items():
            if isinstance(value, np.ndarray):  # what is normalised is rounded
                np.testing.assert_allclose(theirs[name], value, rtol=0, atol=1e-6)
            else:
                assert theirs[name] == value


@pytest.mark.parametrize("wrapper", SAME)
def test_supersuit_hands_everyone_through_from_birth_to_end(supersuit: Any, wrapper: str) -> None:
    scene, horizon_s = GAPS
    bare = parallel_env(scene, horizon_s=horizon_s)
    env = getattr(supersuit, wrapper)(parallel_env(scene, horizon_s=horizon_s), *SAME[wrapper])
    rng = np.random.default_rng(0)
    entries: tuple = bare.reset(seed=5)
    assert_same(entries, env.reset(seed=5))
    trips, gaps = len(entries[0]), 0
    while bare.agents:
        assert set(env.agents) == set(bare.agents)
        actions = towards_goals({name: entries[0][name] for name in bare.agents}, rng)
        entries = bare.step(actions)
        assert_same(entries, env.step(actions))
        trips += len(set(entries[0]) - set(actions))
        gaps += any(info["frames_skipped"] for info in entries[-1].values())
    assert not env.agents
    assert trips > 20
    assert gaps > 2


def test_the_page_lists_the_wrappers_of_supersuit_that_work() -> None:
    listed = PAGE.split("These wrappers work")[1].split("These wrappers do not work")[0]
    assert {name.strip("`,.:;\n") for name in listed.split() if "_v" in name} == set(SAME)


def test_the_pages_example_of_supersuit_stacks_what_each_saw(supersuit: Any) -> None:
    env = names_of("supersuit")["env"]
    assert not env.agents
    stacks, _ = env.reset(seed=1)
    seen = {name: [stack[-38:].copy()] * 4 for name, stack in stacks.items()}
    rng = np.random.default_rng(0)
    born = 0
    for _ in range(100):
        stacks, *_ = env.step(towards_goals({name: seen[name][-1] for name in env.agents}, rng))
        for name, stack in stacks.items():
            born += name not in seen
            newest = stack[-38:].copy()
            seen[name] = [*seen[name][1:], newest] if name in seen else [newest] * 4
            assert stack.tolist() == np.concatenate(seen[name]).tolist()
    assert born > 5


def play(env: Any, seed: int) -> None:
    """Walk to the goals until the episode is over."""
    observations, _ = env.reset(seed=seed)
    rng = np.random.default_rng(0)
    while env.agents:
        now = {name: observations[name] for name in env.agents}
        observations, *_ = env.step(towards_goals(now, rng))


def test_black_death_fails_at_the_first_birth(supersuit: Any) -> None:
    bare = parallel_env("plaza-v0", horizon_s=60.0)
    there = set(bare.reset(seed=3)[0])
    with pytest.raises(KeyError, match="person_") as failed:
        play(supersuit.black_death_v3(bare), seed=3)
    assert failed.value.args[0] not in there


@pytest.mark.parametrize("first", ["black_death_v3", "pad_observations_v0"])
def test_supersuits_vector_environment_fails_at_reset(supersuit: Any, first: str) -> None:
    env = getattr(supersuit, first)(parallel_env("plaza-v0", horizon_s=60.0))
    vector = supersuit.pettingzoo_env_to_vec_env_v1(env)
    assert vector.num_envs > 100  # all who ever come
    with pytest.raises(AssertionError, match="agent death"):
        vector.reset(seed=3)


def test_frame_skip_acts_for_those_who_have_left(supersuit: Any) -> None:
    bare = parallel_env("plaza-v0", horizon_s=60.0)
    env = supersuit.frame_skip_v0(bare, 4, np.zeros(2, np.float32))
    with pytest.raises(AttributeError, match="np_random"):
        play(env, seed=1)
    bare.np_random = np.random.default_rng(0)
    with pytest.raises(ActionError, match="unknown agents"):
        play(env, seed=1)


# TorchRL's wrapper

UNTESTED = pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version")


@UNTESTED
def test_torchrls_wrapper_fails_for_the_first_who_has_not_entered() -> None:
    need(find_spec("torchrl"), "torchrl, of the extra of that name,")
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper

    bare = parallel_env("plaza-v0", horizon_s=20.0)
    there = set(bare.reset(seed=0)[0])
    with pytest.raises(KeyError, match="person_") as failed:
        PettingZooWrapper(bare, use_mask=True, seed=0)
    assert failed.value.args[0] == f"person_{len(there)}"


@UNTESTED
def test_with_the_pages_adapter_the_wrapper_shows_every_life_as_it_was() -> None:
    need(find_spec("torchrl"), "torchrl, of the extra of that name,")
    names: dict[str, Any] = {}
    exec(
        compile(pages.block_with(PAGE, "PettingZooWrapper("), "interoperability.md", "exec"), names
    )
    steps, crowd = names["steps"], names["crowd"].trajectories()
    frames = 50
    assert steps["next", "done"].flatten().tolist() == [False] * (frames - 1) + [True]
    there = steps["person", "mask"].numpy()
    for person in range(there.shape[1]):
        known = crowd.person_id == person
        acted = np.flatnonzero(there[:, person])
        if not len(acted):
            assert not known.any()
            continue
        assert (np.diff(acted) == 1).all()
        assert acted[0] == crowd.first[known][0]
        # The arrival is a row of the table, in which nobody acts any more; not at the horizon.
        assert acted[-1] + (acted[-1] < frames - 1) == crowd.last[known][0]
    rewards = steps["next", "person", "reward"].numpy()[..., 0]
    assert not rewards[~there].any()
    assert there.any(axis=0).sum() > 3


# Minari


@pytest.fixture
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where Minari keeps its datasets."""
    need(find_spec("minari"), "minari, of the extra of that name,")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path / "minari"


@pytest.fixture(scope="module")
def shown() -> Demonstrations:
    """What a fold is fitted on: trips that are cut, too."""
    return demonstrations("plaza-v0", split="fold1", rays=8, seed=7)


def test_minari_gives_back_the_pieces_bit_for_bit(shown: Demonstrations, datasets: Path) -> None:
    import minari

    shown.to_minari("crowdbench/plaza-fold1-v0")
    dataset = minari.load_dataset("crowdbench/plaza-fold1-v0")
    assert dataset.total_episodes == len(shown)
    assert dataset.total_steps == len(shown.pairs()[0])
    assert 0 < shown.complete.sum() < len(shown)
    episodes = list(dataset.iterate_episodes())
    for k, episode in enumerate(episodes):
        start, stop = shown.offsets[k], shown.offsets[k + 1]
        steps = stop - start - 1
        assert episode.observations.dtype == episode.actions.dtype == np.float32
        assert episode.observations.tobytes() == shown.observations[start:stop].tobytes()
        assert episode.actions.tobytes() == shown.actions[start : stop - 1].tobytes()
        assert episode.rewards.tolist() == [0.0] * steps
        ends = [False] * (steps - 1)
        assert episode.terminations.tolist() == [*ends, shown.complete[k]]
        assert episode.truncations.tolist() == [*ends, not shown.complete[k]]
        assert all(dataset.observation_space.contains(seen) for seen in episode.observations)
        assert all(dataset.action_space.contains(action) for action in episode.actions)
    assert len(episodes) == len(shown)
    notes = list(dataset.storage.get_episode_metadata(range(len(shown))))
    assert [int(note["person"]) for note in notes] == shown.person.tolist()
    assert [int(note["first_frame"]) for note in notes] == shown.first.tolist()
    assert [bool(note["entered"]) for note in notes] == shown.entered.tolist()


def test_a_dataset_tells_how_it_was_made(shown: Demonstrations, datasets: Path) -> None:
    some, _ = shown.split(0.9, seed=0)
    some.to_minari("some-v3")
    made = json.loads((datasets / "some-v3" / "data" / "metadata.json").read_text())
    assert made["crowdbench"] == dict(shown.provenance)
    assert made["crowdbench"] == {
        "version": crowdbench.__version__,
        "scene": "plaza-v0",
        "recording": "plaza",
        "sha256": "",
        "cite": "",
        "dt_s": 0.4,
        "max_speed_mps": 3.0,
        "split": "fold1",
        "observation": "lidar-2",
        "rays": 8,
        "ray_range_m": 10.0,
        "interval": 1,
        "smoothing_s": 0.0,
        "displaced_m": 0.0,
        "recovery_s": 1.5,
        "seed": 7,
    }
    assert "cite" not in made["description"]


def test_a_dataset_of_a_recording_says_whom_to_cite(opentraj: Path, datasets: Path) -> None:
    import_recording("eth", opentraj)
    dataset = demonstrations("eth-v0", rays=1).take(range(3)).to_minari("eth/few-v0")
    made = dataset.storage.metadata
    assert made["crowdbench"]["cite"].startswith("Pellegrini et al.")
    assert len(made["crowdbench"]["sha256"]) == 64
    assert "Cite: Pellegrini et al." in made["description"]


def test_a_dataset_is_never_written_over(shown: Demonstrations, datasets: Path) -> None:
    shown.take([0]).to_minari("crowdbench/one-v0")
    before = (datasets / "crowdbench/one-v0/data/main_data.hdf5").read_bytes()
    with pytest.raises(OutputError, match=r"already exists.*minari delete crowdbench/one-v0"):
        shown.take([1]).to_minari("crowdbench/one-v0")
    assert (datasets / "crowdbench/one-v0/data/main_data.hdf5").read_bytes() == before


def test_half_a_dataset_does_not_stay(
    shown: Demonstrations, datasets: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from minari.dataset.minari_storage import MinariStorage

    def full(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(MinariStorage, "update_metadata", full)
    with pytest.raises(OutputError, match=r"no space left.*MINARI_DATASETS_PATH"):
        shown.take([0]).to_minari("one-v0")
    assert not (datasets / "one-v0").exists()
    monkeypatch.undo()
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(datasets))
    assert shown.take([0]).to_minari("one-v0").total_episodes == 1


@pytest.mark.parametrize("dataset_id", ["plaza", "../plaza-v0", "a plaza-v0", ""])
def test_ids_that_minari_does_not_take_are_refused(
    shown: Demonstrations, datasets: Path, dataset_id: str
) -> None:
    with pytest.raises(SettingError, match="dataset_id"):
        shown.to_minari(dataset_id)
    assert not datasets.exists()


def test_no_demonstrations_are_no_dataset(shown: Demonstrations, datasets: Path) -> None:
    with pytest.raises(SettingError, match="no demonstrations"):
        shown.take([]).to_minari("none-v0")


def test_the_pages_example_of_minari_runs(datasets: Path) -> None:
    names = names_of("minari")
    assert names["dataset"].total_episodes == len(names["shown"])


# RLlib


@pytest.fixture(scope="module")
def rllib() -> Iterator[dict[str, Any]]:
    """What the page's example makes, after it has trained."""
    # RLlib needs dm-tree, Ray alone does not. CI installs no RLlib: this is never a failure.
    if not (find_spec("ray") and find_spec("tree")):
        pytest.skip("RLlib is missing; it needs an environment of its own, see the page")
    import ray

    names = names_of("ray")
    yield names
    names["algorithm"].stop()
    ray.shutdown()


# RLlib registers each environment under one and the same name.
AGAIN = pytest.mark.filterwarnings("ignore:.*Overriding environment rllib-multi-agent-env-v0")


class Trips:
    """An environment that writes down everyone's life."""

    def __init__(self, env: CrowdParallelEnv) -> None:
        self.possible_agents = env.possible_agents
        self.observation_space, self.action_space = env.observation_space, env.action_space
        self.env = env
        self.trips: list[dict[str, dict[str, Any]]] = []

    @property
    def agents(self) -> list[str]:
        return self.env.agents

    def _born(self, observations: dict[str, np.ndarray]) -> None:
        for name, seen in observations.items():
            self.trips[-1][name] = {"seen": [seen], "rewards": [], "end": None}

    def reset(self, **given: Any) -> tuple:
        observations, infos = self.env.reset(**given)
        self.trips.append({})
        self._born(observations)
        return observations, infos

    def step(self, actions: dict[str, np.ndarray]) -> tuple:
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        for name in actions:
            life = self.trips[-1][name]
            life["seen"].append(observations[name])
            life["rewards"].append(rewards[name])
            if terminated[name] or truncated[name]:
                life["end"] = "terminated" if terminated[name] else "truncated"
        self._born({name: observations[name] for name in set(observations) - set(actions)})
        return observations, rewards, terminated, truncated, infos


def sampled(names: dict[str, Any], scene: str, horizon_s: float, episodes: int) -> tuple:
    """RLlib's episodes of a scene, and the trips that the environment led meanwhile."""
    made: Callable[..., Any] = names["Crowd"]

    class Watched(made):  # type: ignore[misc, valid-type]
        def __init__(self, config: dict[str, Any]) -> None:
            super().__init__(config)
            self.crowd = Trips(self.crowd)

    config = names["config"].copy(copy_frozen=False)
    config.environment(Watched, env_config={"scene": scene, "horizon_s": horizon_s})
    algorithm = config.build_algo()
    runner = algorithm.env_runner
    watched = runner.env.envs[0].unwrapped.crowd
    watched.trips.clear()  # RLlib has tried a step
    found = runner.sample(num_episodes=episodes, explore=True)
    algorithm.stop()
    return found, watched.trips


@pytest.mark.slow
def test_ppo_of_rllib_trains_one_policy_for_everyone(rllib: dict[str, Any]) -> None:
    before = rllib["algorithm"].get_module("walker").state_dict()
    before = {name: values.clone() for name, values in before.items()}
    results = rllib["algorithm"].train()
    learned = results["learners"]["walker"]
    assert np.isfinite(learned["total_loss"])
    assert results["env_runners"]["num_episodes"] == 4  # 400 steps of 100 frames each
    after = rllib["algorithm"].get_module("walker").state_dict()
    assert any((before[name] != after[name]).any() for name in before)


@AGAIN
@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "horizon_s", "episodes"), [("plaza-v0", 40.0, 2), (*GAPS, 30)], ids=["busy", "gaps"]
)
def test_rllib_gets_every_life_as_it_was(
    rllib: dict[str, Any], scene: str, horizon_s: float, episodes: int
) -> None:
    found, trips = sampled(rllib, scene, horizon_s, episodes)
    assert len(found) == episodes
    at, compared = 0, set()
    ends = set()
    for episode in found:
        if any((at, name) in compared for name in episode.agent_episodes):
            at += 1  # names begin anew
        for name, got in episode.agent_episodes.items():
            life = trips[at][name]
            compared.add((at, name))
            assert np.array_equal(got.get_observations(), life["seen"])
            assert np.allclose(got.get_rewards(), life["rewards"], rtol=1e-6)
            assert got.is_done
            assert got.is_terminated == (life["end"] == "terminated")
            ends.add(life["end"])
    done = {(k, name) for k, of in enumerate(trips) for name, life in of.items() if life["end"]}
    assert compared == done
    assert ends == {"terminated", "truncated"}


@AGAIN
@pytest.mark.slow
def test_rllibs_own_wrapper_knows_only_those_who_were_there_first(rllib: dict[str, Any]) -> None:
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    register_env("own", lambda config: ParallelPettingZooEnv(crowdbench.parallel_env(**config)))
    config = rllib["config"].copy(copy_frozen=False).environment("own")
    algorithm = config.build_algo()
    with pytest.raises(KeyError, match="person_"):
        algorithm.train()
    algorithm.stop()


@pytest.mark.slow
def test_rllibs_own_wrapper_does_not_tell_a_mixed_end(rllib: dict[str, Any]) -> None:
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

    bare = env_of(Person(goal=(1.0, 0.0)), Person(start=(0.0, -5.0)), horizon_s=0.4)
    env = ParallelPettingZooEnv(bare)
    env.reset()
    _, _, terminated, truncated, _ = env.step(walk(bare))
    assert not bare.agents
    assert terminated == {"person_0": True, "person_1": False, "__all__": False}
    assert truncated == {"person_0": False, "person_1": True, "__all__": False}
