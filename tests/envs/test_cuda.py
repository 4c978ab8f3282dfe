"""The TorchRL environments and PPO on a GPU: the same worlds as on the CPU."""

from collections.abc import Iterator

import pytest
import torch
from tensordict import TensorDictBase

from crowdbench.baselines import ppo
from crowdbench.envs.torchrl_env import CrowdEnv, SlotEnv

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU"),
]

WORLDS, SLOTS, FRAMES = 3, 12, 60


def steps(kind: type[CrowdEnv], device: str) -> Iterator[TensorDictBase]:
    """Steps with random actions; one world is reset on the way."""
    env = kind(
        "plaza-v0",
        worlds=WORLDS,
        max_alive=SLOTS,
        on_full="drop",
        horizon_s=20.0,
        seed=3,
        device=device,
    )
    rng = torch.Generator().manual_seed(0)
    now = env.reset()
    yield now
    for k in range(FRAMES):
        actions = torch.rand((WORLDS, SLOTS, 2), generator=rng) - 0.3
        key = ("agents", "action") if kind is CrowdEnv else "action"
        now[key] = actions.to(device)
        now = env.step(now)["next"]
        yield now
        if k == 30:
            chosen = torch.zeros(*env.batch_size, 1, dtype=torch.bool, device=device)
            chosen[1] = True
            now["_reset"] = chosen
            now = env.reset(now)
            yield now


@pytest.mark.parametrize("kind", [CrowdEnv, SlotEnv])
def test_worlds_are_the_same_on_a_gpu(kind: type[CrowdEnv]) -> None:
    for k, (there, here) in enumerate(zip(steps(kind, "cuda"), steps(kind, "cpu"), strict=True)):
        for name, tensor in here.items(True, True):
            other = there[name]
            assert other.device.type == "cuda", name
            torch.testing.assert_close(other.cpu(), tensor, rtol=0, atol=0, msg=f"{name}, step {k}")


def test_what_is_seen_stays_when_the_world_goes_on() -> None:
    env = CrowdEnv(
        "plaza-v0", worlds=WORLDS, max_alive=SLOTS, on_full="drop", seed=0, device="cuda"
    )
    now = env.reset()
    seen = now["agents", "observation"]
    before = seen.clone()
    for _ in range(5):
        now["agents", "action"] = torch.ones((WORLDS, SLOTS, 2), device="cuda")
        now = env.step(now)["next"]
    assert torch.equal(seen, before)
    assert not torch.equal(now["agents", "observation"], before)


@pytest.mark.parametrize("collectors", [1, 2])
def test_ppo_trains_on_a_gpu(collectors: int) -> None:
    settings = ppo.PpoSettings(
        worlds=8, frames=3200, batch_frames=800, device="cuda", collectors=collectors
    )
    rounds = list(ppo.train("plaza-v0", settings))
    assert len(rounds) == 4
    assert all(each.steps > 0 for each in rounds)
    assert rounds[-1].figures["at goal"] > 0.8
    assert {p.device.type for p in rounds[-1].network.parameters()} == {"cuda"}
