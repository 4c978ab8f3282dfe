"""The TorchRL view: the other views' crowd bit for bit, and no life that runs into another."""

import numpy as np
import pytest
import torch
from given import Given
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs, step_mdp
from torchrl.record import PixelRenderTransform
from worlds import Person, square, with_bodies

import crowdbench
from crowdbench.envs.torchrl_env import CrowdEnv
from crowdbench.errors import ActionError, CapacityError, SettingError
from crowdbench.simulation import Settings
from crowdbench.simulation.reward import PARTS


@pytest.mark.parametrize("observation", ["lidar-1", "lidar-2", "lidar-3", "social-1-contact"])
@pytest.mark.parametrize("worlds", [1, 3])
def test_specs_hold(worlds: int, observation: str) -> None:
    env = CrowdEnv("plaza-v0", worlds=worlds, max_alive=16, on_full="drop", horizon_s=20.0,
                   seed=0, observation=observation, rays=8)  # fmt: skip
    check_env_specs(env)


def walked(env: CrowdEnv, actions: np.ndarray) -> list[TensorDict]:
    """The steps of an episode in which slot i gets the action i of each frame."""
    now, steps = env.reset(), []
    for frame in actions:
        now["agents", "action"] = torch.from_numpy(frame)
        after = env.step(now)
        steps.append(after)
        now = step_mdp(after)
    return steps


@pytest.mark.parametrize("observation", ["lidar-2", "social-1", "lidar-2-contact"])
def test_it_is_the_crowd_of_the_pettingzoo_view(observation: str) -> None:
    frames, slots = 100, 40
    asked = {"max_alive": slots, "horizon_s": frames * 0.4, "rays": 8, "observation": observation}
    torchs = CrowdEnv("plaza-v0", worlds=2, seed=7, **asked)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (frames, 2, slots, 2)).astype(np.float32)
    steps = walked(torchs, actions)

    env = crowdbench.parallel_env("plaza-v0", max_persons=10_000, **asked)
    observations, _ = env.reset(seed=7)
    for step, of_frame in zip(steps, actions[:, 0], strict=True):
        before, after = step["agents"][0], step["next", "agents"][0]
        assert before["mask"].sum() == len(env.agents)
        slot_of = {f"person_{p}": i for i, p in enumerate(before["person_id"].tolist())
                   if before["mask"][i]}  # fmt: skip
        assert set(slot_of) == set(env.agents)
        for name, i in slot_of.items():
            assert observations[name].tolist() == before["observation"][i].tolist()
        observations, rewards, terminated, truncated, infos = env.step(
            {name: of_frame[i] for name, i in slot_of.items()}
        )
        for name, i in slot_of.items():
            assert observations[name].tolist() == after["observation"][i].tolist()
            assert rewards[name] == pytest.approx(after["reward"][i].item(), abs=1e-6)
            assert infos[name]["reward_parts"] == after["reward_parts"][i].tolist()
            assert terminated[name] == after["terminated"][i].item()
            assert truncated[name] == after["truncated"][i].item()
        if not env.agents:
            break
    assert not env.agents
    assert steps[-1]["next", "done"].all()


def test_worlds_have_arrivals_of_their_own() -> None:
    env = CrowdEnv("plaza-v0", worlds=2, horizon_s=20.0, seed=0)
    first = env.reset()["agents", "observation"]
    assert not torch.equal(first[0], first[1])
    again = CrowdEnv("plaza-v0", worlds=2, horizon_s=20.0, seed=0).reset()
    assert torch.equal(first, again["agents", "observation"])
    assert not torch.equal(first, env.reset()["agents", "observation"])  # the next episode


def walk_on(env: CrowdEnv, now: TensorDict, frames: int, seed: int) -> TensorDict:
    """Steps (W, T) from `now` on, in which slot i of every world does the same."""
    rng, steps = np.random.default_rng(seed), []
    worlds, slots = now["agents", "mask"].shape
    for _ in range(frames):
        action = torch.from_numpy(rng.uniform(-1, 1, (slots, 2)).astype(np.float32))
        now["agents", "action"] = action.expand(worlds, slots, 2)
        steps.append(env.step(now))
        now = env.step_mdp(steps[-1])
    return torch.stack(steps, dim=1)


def same_bytes(one: TensorDict, other: TensorDict) -> bool:
    """Whether they have the same tensors, but for actions, which resets do not have."""
    one, other = (steps.exclude(("agents", "action")) for steps in (one, other))
    names = set(one.keys(True, True))
    return names == set(other.keys(True, True)) and all(
        torch.equal(one[name], other[name]) for name in names
    )


@pytest.mark.parametrize("observation", ["lidar-2", "social-1"])
@pytest.mark.parametrize("start", ["stationary", "empty"])
def test_a_world_reset_alone_is_that_reset_with_all(start: str, observation: str) -> None:
    asked = {"spawn": "cox-plans", "start": start, "observation": observation, "rays": 8}
    asked |= {"worlds": 3, "max_alive": 24, "on_full": "drop", "horizon_s": 24.0, "seed": 5}
    singly, together = CrowdEnv("plaza-v0", **asked), CrowdEnv("plaza-v0", **asked)
    before = walk_on(singly, singly.reset(), 20, seed=1)
    assert same_bytes(before, walk_on(together, together.reset(), 20, seed=1))

    now = singly.step_mdp(before[:, -1])
    kept, now["_reset"] = now.clone(), torch.tensor([[False], [True], [False]])
    now = singly.reset(now)
    begun, after = now.clone(), walk_on(singly, now, 40, seed=2)
    undisturbed = walk_on(together, kept.clone(), 40, seed=2)
    second = together.reset()  # is the second episode of all worlds
    of_all = walk_on(together, second.clone(), 40, seed=2)
    for world in (0, 2):
        assert same_bytes(begun[world], kept[world])
        assert same_bytes(after[world], undisturbed[world])
    assert same_bytes(begun[1], second[1])
    assert same_bytes(after[1], of_all[1])
    assert after["agents", "mask"][1].any()
    assert after["next", "done"][:, -1].flatten().tolist() == [True, False, True]

    now = singly.maybe_reset(singly.step_mdp(after[:, -1]))  # the others have reached the horizon
    for world in (0, 2):
        assert same_bytes(now[world], second[world])
    assert not same_bytes(begun[0], second[0])


def test_rollouts_reset_worlds_that_end_at_different_times() -> None:
    env = CrowdEnv("plaza-v0", worlds=2, max_alive=8, on_full="drop", horizon_s=8.0, seed=0, rays=4)
    now = env.step_mdp(walk_on(env, env.reset(), 5, seed=0)[:, -1])
    now["_reset"] = torch.tensor([[True], [False]])
    steps = env.rollout(60, auto_reset=False, tensordict=env.reset(now), break_when_any_done=False)
    ends = [row.flatten().nonzero().flatten().tolist() for row in steps["next", "done"]]
    assert ends == [[19, 39, 59], [14, 34, 54]]


DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(
    not torch.cuda.is_available(), reason="no CUDA"))]  # fmt: skip


@pytest.mark.parametrize("device", DEVICES)
def test_all_tensors_are_on_the_device(device: str) -> None:
    env = CrowdEnv(
        "plaza-v0",
        worlds=2,
        max_alive=8,
        on_full="drop",
        horizon_s=8.0,
        seed=0,
        rays=4,
        device=device,
    )
    check_env_specs(env)
    steps = env.rollout(30, break_when_any_done=False)
    specs = [*env.input_spec.values(True, True), *env.output_spec.values(True, True)]
    for part in (env, steps, env.state(), *specs, *steps.values(True, True)):
        assert part.device.type == device


def two_after_each_other(**changes: object) -> CrowdEnv:
    """One slot: someone who is at the goal after a step, and someone who comes later."""
    people = (
        Person(start=(0.0, 0.0), goal=(2.0, 0.0)),
        Person(time_s=0.8, start=(0.0, 5.0), goal=(9.0, 5.0)),
    )
    return CrowdEnv(
        square(), spawn=Given(*people), max_alive=1, rays=4, **{"horizon_s": 4.0, **changes}
    )


def test_a_slot_is_handed_over_after_the_step_that_ended_a_life() -> None:
    env = two_after_each_other()
    now, rows = env.reset(), []
    for _ in range(4):
        now["agents", "action"] = torch.tensor([[[1.0, 0.0]]])
        step = env.step(now)
        rows.append(step)
        now = step_mdp(step)

    def column(name: str) -> list:
        return [row["next", "agents", name].flatten().tolist()[0] for row in rows]

    before = [row["agents", "mask"].item() for row in rows]
    assert before == [True, False, True, True]
    assert column("person_id") == [0, 1, 1, 1]
    assert column("just_spawned") == [False, True, False, False]
    assert column("done") == [True, True, False, False]
    assert column("terminated") == [True, True, False, False]
    assert rows[1]["next", "agents", "reward"].item() == 0.0
    # The last observation of the first life is its own: at the goal.
    assert rows[0]["next", "agents", "observation"][0, 0, 2].item() < 0.02


def test_a_timeout_and_the_horizon_truncate() -> None:
    env = CrowdEnv(square(dwell_p99_s=0.4), spawn=Given(Person()), max_alive=1, rays=4,
                   horizon_s=4.0)  # fmt: skip
    steps = walked(env, np.zeros((10, 1, 1, 2), np.float32))
    ended = [s["next", "agents", "truncated"].item() for s in steps]
    assert ended.index(True) == 1
    assert not steps[1]["next", "agents", "terminated"].item()
    env = CrowdEnv(square(), spawn=Given(Person()), max_alive=1, rays=4, horizon_s=0.8)
    last = walked(env, np.zeros((2, 1, 1, 2), np.float32))[-1]["next"]
    assert last["agents", "truncated"].item()
    assert last["done"].item()
    assert last["truncated"].item()
    assert not last["terminated"].item()


def test_parts_add_up_to_the_reward() -> None:
    # Its people have companions and bodies, and stop.
    scene = with_bodies(crowdbench.load_scene("plaza-v0"))
    env = CrowdEnv(scene, spawn="cox-plans", worlds=2, horizon_s=60.0, seed=0)
    steps = env.rollout(60)
    after = steps["next", "agents"]
    torch.testing.assert_close(after["reward_parts"].sum(-1, keepdim=True), after["reward"])
    acted = steps["agents", "mask"]
    assert (after["reward_parts"][~acted] == 0).all()
    assert (after["reward_parts"][acted] != 0).flatten(0, -2).any(0).sum() >= len(PARTS) - 2


def test_people_without_a_slot_are_counted_or_an_error() -> None:
    env = CrowdEnv("plaza-v0", max_alive=2, horizon_s=60.0, seed=0, on_full="drop")
    env.rollout(100)
    assert env.dropped > 0
    with pytest.raises(CapacityError, match="max_alive"):
        CrowdEnv("plaza-v0", max_alive=2, horizon_s=60.0, seed=0).rollout(100)


def test_all_environments_have_as_many_slots_by_default() -> None:
    torchs = CrowdEnv("plaza-v0", horizon_s=60.0)
    ours = crowdbench.parallel_env("plaza-v0", horizon_s=60.0)
    assert torchs.batch_size == (1,)
    assert torchs.reset()["agents", "mask"].shape[1] == len(ours.state())
    assert len(ours.state()) >= Settings().max_alive


def test_the_collector_goes_through_episodes() -> None:
    env = CrowdEnv("plaza-v0", worlds=2, max_alive=8, on_full="drop", horizon_s=8.0, seed=0, rays=4)
    collector = Collector(env, None, frames_per_batch=60, total_frames=180)
    seen = [batch.clone() for batch in collector]
    collector.shutdown()
    done = torch.cat([batch["next", "done"] for batch in seen], dim=1)
    assert done.sum() > 2
    for batch in seen:
        life = batch["agents", "person_id"] == batch["next", "agents", "person_id"]
        assert life[batch["agents", "mask"]].all()


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_actions_that_are_no_numbers_are_refused(bad: float) -> None:
    env = two_after_each_other()
    now = env.reset()
    now["agents", "action"] = torch.full((1, 1, 2), bad)
    with pytest.raises(SettingError, match="finite"):
        env.step(now)


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(SettingError, match="worlds"):
        CrowdEnv("plaza-v0", worlds=0)
    with pytest.raises(SettingError, match="horizon_s"):
        CrowdEnv("plaza-v0", horizon_s=float("nan"))


def test_the_crowd_is_by_default_as_ntpp_gmm_spawns() -> None:
    assert CrowdEnv("plaza-v0", horizon_s=20.0).spawn.name == "ntpp-gmm"


def test_torchrl_takes_pictures_of_the_first_world() -> None:
    env = CrowdEnv("plaza-v0", worlds=2, max_alive=40, horizon_s=20.0, render_mode="rgb_array")
    with pytest.raises(ActionError, match="render: got no episode"):
        env.render()
    of_worlds = TransformedEnv(env, PixelRenderTransform()).rollout(5).get("pixels").tolist()
    assert [len(steps) for steps in of_worlds] == [5, 5]
    pictures = [picture.tobytes() for picture in of_worlds[0]]
    assert len(set(pictures)) == 5
    assert env.render().tobytes() not in pictures  # which are of the frames before
