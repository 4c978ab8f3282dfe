"""Slots as environments of TorchRL: each person is an episode, and recurrent states are its own."""

import pytest
import torch
from given import Given
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import Compose, InitTracker, RewardSum, TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.modules import GRUModule, LSTMModule, set_recurrent_mode
from worlds import Person, square

from crowdbench.simulation.social import PREFERRED_SPEED, ROUTE_DIRECTION
from crowdbench.torchrl_env import CrowdEnv, SlotEnv

ASKED = {
    "worlds": 2,
    "max_alive": 20,
    "on_full": "drop",
    "horizon_s": 40.0,
    "observation": "social-1",
    "seed": 0,
}
UNITS = 8


@pytest.mark.parametrize("observation", ["lidar-2", "social-1"])
def test_specs_hold(observation: str) -> None:
    check_env_specs(SlotEnv("plaza-v0", **{**ASKED, "observation": observation, "horizon_s": 8.0}))


def test_it_is_the_crowd_of_the_other_view() -> None:
    slots = TransformedEnv(SlotEnv("plaza-v0", **ASKED), InitTracker())
    steps = slots.rollout(150, break_when_any_done=False)  # one episode of 100 frames and a half
    crowd = CrowdEnv("plaza-v0", **ASKED)
    now, of_crowd = crowd.reset(), []
    for action in steps["action"].unbind(2):
        now["agents", "action"] = action
        before, now = crowd.step_and_maybe_reset(now)
        of_crowd.append(before)
    agents = torch.stack(of_crowd, 1)["agents"].transpose(1, 2)
    after = torch.stack(of_crowd, 1)["next", "agents"].transpose(1, 2)
    mask = agents["mask"]
    assert torch.equal(steps["mask"], mask)
    for name in ("observation", "person_id"):
        assert torch.equal(steps[name][mask], agents[name][mask])
        assert torch.equal(steps["next", name], after[name])
        assert (steps[name][~mask] == (0 if name == "observation" else -1)).all()
    for name in ("reward", "reward_parts"):
        assert torch.equal(steps["next", name], after[name])
    for name in ("done", "terminated", "truncated"):
        assert torch.equal(steps["next", name][mask], after[name][mask])


def test_a_trip_and_a_wait_are_episodes() -> None:
    people = (
        Person(start=(0.0, 0.0), goal=(2.0, 0.0)),
        Person(time_s=1.2, start=(0.0, 5.0), goal=(4.0, 5.0)),
    )
    env = TransformedEnv(
        SlotEnv(square(), spawn=Given(*people), max_alive=2, rays=4, horizon_s=4.0), InitTracker()
    )
    now, rows = env.reset(), []
    for _ in range(12):  # the horizon is at 10
        now["action"] = torch.tensor([[[1.0, 0.0], [0.0, 0.0]]])
        step, now = env.step_and_maybe_reset(now)
        rows.append(step)
    steps = torch.stack(rows, 2)[0]

    def of(slot: int, *name: str) -> list:
        return steps[name][slot].flatten().int().tolist()

    assert of(0, "mask") == [1, 0, 0, 1, 1, 0, 0, 0, 0, 0, 1, 0]
    assert of(0, "person_id") == [0, -1, -1, 1, 1, -1, -1, -1, -1, -1, 0, -1]
    assert of(0, "is_init") == [1, 1, 0, 1, 0, 1, 0, 0, 0, 0, 1, 1]
    assert of(0, "next", "done") == [1, 0, 1, 0, 1, 0, 0, 0, 0, 1, 1, 0]
    assert of(0, "next", "terminated") == [1, 0, 1, 0, 1, 0, 0, 0, 0, 0, 1, 0]
    assert of(0, "next", "truncated") == [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0]
    assert of(1, "mask") == [0] * 12  # nobody ever enters
    assert of(1, "is_init") == [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0]


class Onward(nn.Module):
    """Walks along the route, so that people arrive, and a little as the network wants."""

    def __init__(self) -> None:
        super().__init__()
        self.out = nn.Linear(UNITS, 2)

    def forward(self, hidden: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        route = seen[..., ROUTE_DIRECTION] * seen[..., PREFERRED_SPEED]
        return route + 0.1 * torch.tanh(self.out(hidden))


@pytest.mark.parametrize("cell", [GRUModule, LSTMModule])
def test_states_are_each_persons_own_when_acting_and_when_training(cell: type) -> None:
    torch.manual_seed(0)
    env = TransformedEnv(SlotEnv("plaza-v0", **ASKED), Compose(InitTracker(), RewardSum()))
    states = ["state"] if cell is GRUModule else ["state", "cell"]
    memory = cell(
        env.observation_spec["observation"].shape[-1],
        UNITS,
        in_keys=["observation", *states],
        out_keys=["hidden", *(("next", name) for name in states)],
    )
    env.append_transform(memory.make_tensordict_primer())
    head = TensorDictModule(Onward(), ["hidden", "observation"], ["action"])
    policy = TensorDictSequential(memory, head)
    frames = 2 * 20 * 70  # an episode is longer, the third batch begins in the third
    collector = Collector(env, policy, frames_per_batch=frames, total_frames=3 * frames)
    batches = [batch.clone() for batch in collector]
    collector.shutdown()
    for batch in batches:
        with torch.no_grad(), set_recurrent_mode(True):
            again = policy(batch.select("observation", "is_init", *states))
            wrong = batch.select("observation", "is_init", *states)
            wrong["is_init"] = torch.zeros_like(wrong["is_init"])
            wrong = policy(wrong)
        mask = batch["mask"]
        torch.testing.assert_close(again["action"][mask], batch["action"][mask], rtol=0, atol=1e-5)
        assert (wrong["action"] - batch["action"])[mask].abs().max() > 1e-3
        assert (batch["is_init"][..., 1:, 0] & mask[..., 1:]).sum() > 5
    assert check_by_person(torch.cat(batches, dim=2), memory) > 40


def check_by_person(steps: TensorDict, memory: nn.Module) -> int:
    """Compare states with those of each person's own network, step by step; return their number."""
    network = memory.gru if isinstance(memory, GRUModule) else memory.lstm
    persons = 0
    for slot in steps.flatten(0, 1):
        first = slot["is_init"][:, 0] & slot["mask"]
        for begin in first.nonzero().flatten().tolist():
            ends = slot["next", "done"][begin:, 0].nonzero().flatten().tolist()
            trip = slot[begin : begin + ends[0] + 1] if ends else slot[begin:]
            assert trip["mask"].all()
            assert (trip["person_id"] == trip["person_id"][0]).all()
            with torch.no_grad():
                expected, _ = network(trip["observation"][None])
            torch.testing.assert_close(trip["hidden"], expected[0], rtol=0, atol=1e-5)
            total = trip["next", "reward"].sum()
            torch.testing.assert_close(trip["next", "episode_reward"][-1, 0], total)
            persons += 1
    return persons
