"""The TorchRL environment in which each slot is an environment, as recurrent networks need it.

It arranges the tensors of `CrowdEnv` in another way and has no rules of its own.
"""

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite

from crowdbench.envs.torchrl_env import CrowdEnv


class SlotEnv(CrowdEnv):
    """A `CrowdEnv` with batch size (W, N): an episode is the trip of one person.

    It has the same arguments. All tensors of the group `agents` are at the root: `observation`,
    `action`, `mask`, `reward` (W, N, 1), `done` (W, N, 1) and so on. When a person has ended its
    trip, its slot waits for the next person. The wait is an episode too, which ends (`terminated`)
    in the step in which that person enters. Its rewards are zero and its `mask` is false: leave it
    out of losses.

    So whatever TorchRL does where an environment is done, it does for each person: `InitTracker`
    marks the first step of each person in `is_init`, with which `GRUModule` and `LSTMModule` begin
    with an empty state, both when acting and when training on sequences; value estimators do not
    pass from one person to the next; `RewardSum` sums the rewards of a trip.

    A reset of slots that are done, as by TorchRL's collectors, shows their next episodes and leaves
    everyone else alone. At the horizon all slots of a world are done, and their reset begins a new
    episode of the world. `reset()` begins one in all worlds.
    """

    @staticmethod
    def _batch(worlds: int, slots: int) -> torch.Size:
        return torch.Size([worlds, slots])

    def _specs(self, worlds: int, slots: int, numbers: int) -> dict[str, Composite]:
        specs = super()._specs(worlds, slots, numbers)
        return {name: spec["agents"] for name, spec in specs.items()}

    def _reset(self, tensordict: TensorDictBase | None = None, **_: object) -> TensorDictBase:
        asked = None if tensordict is None else tensordict.get("_reset", None)
        over = self._simulation.clock.frame >= self.frames
        if asked is None:
            over[:] = True
        else:
            over &= asked.reshape(len(over), -1).any(dim=1).cpu().numpy()
        if over.any():
            self._begin(over.nonzero()[0])
        agents: TensorDict = self._first()["agents"].to(self.device)
        there = agents["mask"]  # without those whose trips have just ended
        agents["observation"] *= there[..., None]
        agents["person_id"][~there] = -1
        for name in ("done", "terminated", "truncated"):
            agents[name][:] = False
        return agents

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        after = self._advance(tensordict["action"]).to(self.device)
        agents: TensorDict = after["agents"]
        waiting = (agents["person_id"] < 0)[..., None]
        agents["terminated"] &= ~waiting
        agents["truncated"] |= waiting & after["done"][:, None]
        agents["done"] = agents["terminated"] | agents["truncated"]
        return agents
