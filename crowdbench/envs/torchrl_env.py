"""The TorchRL environments: `W` worlds of `N` slots as tensors, with a mask.

It adds names and a reward to `Simulation`; all physics is in `Simulation`.
"""

import weakref
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import torch
from jaxtyping import Bool, Int, UInt8
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from crowdbench.envs.config import EnvConfig, EnvCrowd, EnvSettings, Pictured, Seeds
from crowdbench.envs.global_state import global_state
from crowdbench.errors import SettingError, checked
from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.simulation.reward import total
from crowdbench.simulation.state import TERMINAL


class CrowdEnv(EnvBase):
    """Worlds of a scene as a TorchRL environment with batch size (W,) and the N slots as agents.

    Tensors under `agents`, with leading shape (W, N):

    - `observation`, `action`: as in `parallel_env`.
    - `mask`: whether the slot is occupied by a person, who acts in the next step. Actions of empty
      slots are ignored. Train only on transitions whose mask is true before the step.
    - `reward` (W, N, 1) and its parts `reward_parts` (W, N, parts): zero where nobody acted.
    - `done`, `terminated`, `truncated` (W, N, 1): whether the person's trip ended in this step, at
      the goal or outside the bounds (terminated), or by a timeout or the horizon (truncated). The
      observation of this step is the last one of the trip; bootstrap the value of a truncated trip
      from it. In empty slots `done` and `terminated` are true, so that no advantage is propagated
      back from the next person in the slot. A slot is never reused in the step in which a trip
      ends.
    - `person_id`: −1 in empty slots. `just_spawned`: whether the person entered in this step.

    Each world has its own arrivals. All worlds begin together and end together at the horizon,
    unless worlds are reset singly, by the mask `_reset` (W, 1) of TorchRL. A world that is reset
    does not disturb the others, whose episodes go on. The k-th episode of world w is the same
    whenever it begins: its seed is the k-th that is drawn from `seed`.

    Tensors are on `device`. The simulation runs on the CPU: in each step the actions are copied
    there, and what it returns is copied back once. For a CUDA device, the simulation writes
    observations into page-locked memory, from which they are copied straight to the device.

    For recurrent networks, and for everything else in TorchRL that begins anew where an
    environment is done, see `SlotEnv`.
    """

    batch_locked = True

    @checked()
    def __init__(
        self,
        scene: str | Path | Scene,
        config: EnvConfig | None = None,
        *,
        worlds: int = 1,
        seed: int | None = None,
        device: torch.device | str = "cpu",
        render_mode: Pictured | None = None,
        **settings: Unpack[EnvSettings],
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            config: the settings, by default those of `EnvConfig()`; its `max_alive` is N.
            worlds: number of worlds W.
            seed: seed of the first episode, from which the seeds of later episodes are drawn.
            device: device of all tensors.
            render_mode: `rgb_array` for images from `render`.
            settings: fields of `EnvConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, model, file or
                recording does not exist or does not fit.
        """
        config = EnvConfig.of(type(self), config, **settings)
        crowd = EnvCrowd(scene, config, worlds=worlds, render_mode=render_mode)
        slots = crowd.simulation.settings.max_alive
        super().__init__(device=device, batch_size=self._batch(worlds, slots))
        self._crowd, self._simulation = crowd, crowd.simulation
        self.scene, self.spawn, self.frames = crowd.scene, crowd.spawn, crowd.frames
        if self._on_gpu():  # from locked memory, copies to the GPU are several times as fast
            seen, runtime = self._simulation.observation, torch.cuda.cudart()
            torch.cuda.check_error(runtime.cudaHostRegister(seen.ctypes.data, seen.nbytes, 0))
            weakref.finalize(seen, runtime.cudaHostUnregister, seen.ctypes.data)
        self._parts = crowd.reward_parts().shape[-1]
        specs = self._specs(worlds, slots, self._simulation.observation.shape[-1])
        for name, spec in specs.items():
            setattr(self, name, spec)
        self.set_seed(seed)

    def state(self) -> torch.Tensor:
        """State of everyone present by world and slot, (W, N, 9), for centralised critics.

        See `crowdbench.envs.global_state`.
        """
        return torch.from_numpy(global_state(self._simulation)).to(self.device)

    def render(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """The first world as an RGB image if `render_mode` is `rgb_array`, else None.

        TorchRL's `PixelRenderTransform` calls it.

        Raises:
            ActionError: `reset` has not been called.
        """
        return self._crowd.render()

    @staticmethod
    def _batch(worlds: int, slots: int) -> torch.Size:
        return torch.Size([worlds])

    def _specs(self, worlds: int, slots: int, numbers: int) -> dict[str, Composite]:
        leading = (worlds, slots)

        def box(*shape: int) -> Bounded:
            return Bounded(-1.0, 1.0, shape=(*leading, *shape), dtype=torch.float32)

        def flags(*shape: int) -> Binary:
            return Binary(n=(*leading, *shape)[-1], shape=(*leading, *shape), dtype=torch.bool)

        def of_agents(**specs: Any) -> Composite:
            agents = Composite(specs, shape=leading)
            return Composite({"agents": agents}, shape=(worlds,))

        done = of_agents(done=flags(1), terminated=flags(1), truncated=flags(1))
        for name in ("done", "terminated", "truncated"):
            done[name] = Binary(n=1, shape=(worlds, 1), dtype=torch.bool)
        return {
            "observation_spec": of_agents(
                observation=box(numbers),
                mask=flags(),
                person_id=Unbounded(shape=leading, dtype=torch.int64),
                just_spawned=flags(),
                reward_parts=Unbounded(shape=(*leading, self._parts), dtype=torch.float32),
            ),
            "action_spec": of_agents(action=box(2)),
            "reward_spec": of_agents(reward=Unbounded(shape=(*leading, 1), dtype=torch.float32)),
            "done_spec": done,
        }

    def _set_seed(self, seed: int | None) -> None:
        self._seeds = Seeds(seed)
        self._drawn: list[int] = []
        self._episodes = np.zeros(self._simulation.worlds, np.int64)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        asked = None if tensordict is None else tensordict.get("_reset", None)
        worlds = np.arange(self._simulation.worlds)
        if asked is not None:
            worlds = worlds[asked.reshape(len(worlds), -1).any(dim=1).cpu().numpy()]
        self._begin(worlds)
        return self._first()

    def _begin(self, worlds: Int[np.ndarray, " n"]) -> None:
        episodes = self._episodes[worlds].tolist()
        while len(self._drawn) <= max(episodes):
            self._drawn.append(self._seeds.draw())
        seeds = [self._drawn[k] for k in episodes]
        self._episodes[worlds] += 1
        simulation = self._simulation
        if len(worlds) == simulation.worlds and len(set(seeds)) == 1:
            self._crowd.begin(seeds[0])
        else:
            alone = Simulation(self.scene, settings=simulation.settings)
            for world, seed in zip(worlds.tolist(), seeds, strict=True):
                self._crowd.begin(seed, simulation=alone, first_world=world)
                simulation.copy_world(world, alone)
        self._crowd.check_capacity()
        simulation.observe()
        self._crowd.follow()

    def _first(self) -> TensorDict:
        """Tensors at the beginning of an episode, when nobody has acted."""
        shape = self._simulation.slots.alive.shape
        return self._tensors(np.zeros((*shape, self._parts), np.float32), np.zeros(shape, bool))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._advance(tensordict["agents", "action"])

    def _advance(self, action: torch.Tensor) -> TensorDict:
        simulation = self._simulation
        acted = simulation.slots.alive.copy()
        actions = action.detach().cpu().numpy()
        actions = np.where(acted[..., None], actions, 0).astype(np.float32)
        if not np.isfinite(actions).all():
            got = f"{int((~np.isfinite(actions)).sum())} values that are not finite"
            hint = "Check the policy for a division by zero or a diverged network."
            raise SettingError("action", got=got, expected="numbers in [−1, 1]", hint=hint)
        simulation.step(actions)
        self._crowd.check_capacity()
        simulation.observe()
        self._crowd.follow()
        parts = self._crowd.reward_parts()
        tensors = self._tensors(parts, ~acted)
        tensors["agents", "reward"] = torch.from_numpy(total(parts)[..., None])
        return tensors

    def _tensors(self, parts: np.ndarray, nobody: np.ndarray) -> TensorDict:
        """Tensors of everyone present or just ended; zeros, and −1 as id, in empty slots.

        The slots `nobody`, in which nobody acted, are terminated, so that no value is propagated
        through them.
        """
        simulation, slots = self._simulation, self._simulation.slots
        there = slots.alive | (slots.ended != 0)
        terminated = np.isin(slots.ended, TERMINAL) | nobody
        truncated = (slots.ended != 0) & ~terminated
        flags = {
            "terminated": terminated,
            "truncated": truncated,
            "done": terminated | truncated,
        }
        agents = {name: torch.from_numpy(flag)[..., None] for name, flag in flags.items()} | {
            "observation": self._copy_observation(there),
            "mask": torch.from_numpy(slots.alive.copy()),
            "person_id": torch.from_numpy(np.where(there, slots.person, -1).astype(np.int64)),
            "just_spawned": torch.from_numpy(slots.spawned & slots.alive),
            "reward_parts": torch.from_numpy(parts),
        }
        over = torch.from_numpy(simulation.clock.frame >= self.frames)[:, None]
        return TensorDict(
            {
                "agents": TensorDict(agents, batch_size=there.shape),
                "done": over,
                "terminated": torch.zeros_like(over),
                "truncated": over.clone(),
            },
            batch_size=[len(there)],
        ).to(self.device)

    def _copy_observation(self, there: Bool[np.ndarray, "W N"]) -> torch.Tensor:
        """A copy of the observations, zeros in empty slots; on a GPU if that is the device."""
        seen = self._simulation.observation
        if not self._on_gpu():
            return torch.from_numpy(np.where(there[..., None], seen, np.float32(0)))
        empty = torch.from_numpy(~there[..., None]).to(self.device)
        # This copy has ended before the simulation writes the next observations.
        return torch.from_numpy(seen).to(self.device).masked_fill_(empty, 0.0)

    def _on_gpu(self) -> bool:
        return self.device is not None and self.device.type == "cuda"

    @property
    def dropped(self) -> int:
        """Number of people who could not enter in this episode, in all worlds."""
        return self._crowd.dropped


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
        agents: TensorDict = self._first()["agents"]
        there = agents["mask"]  # without those whose trips have just ended
        agents["observation"] *= there[..., None]
        agents["person_id"][~there] = -1
        for name in ("done", "terminated", "truncated"):
            agents[name][:] = False
        return agents

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        after = self._advance(tensordict["action"])
        agents: TensorDict = after["agents"]
        waiting = (agents["person_id"] < 0)[..., None]
        agents["terminated"] &= ~waiting
        agents["truncated"] |= waiting & after["done"][:, None]
        agents["done"] = agents["terminated"] | agents["truncated"]
        return agents
