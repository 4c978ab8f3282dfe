"""The TorchRL environment: `W` worlds of `N` slots as tensors, with a mask.

It adds names and a reward to `Simulation`; all physics is in `Simulation`.
"""

import weakref
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Int
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from crowdbench.envs.global_state import global_state
from crowdbench.errors import SettingError
from crowdbench.policies import Straight
from crowdbench.registry import DEFAULT_SPAWN, spawn_model
from crowdbench.run.episode import (
    OnFull,
    begin,
    check_capacity,
    check_horizon,
    check_on_full,
    dropped,
    sample_of,
    slots_for,
)
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.simulation.reward import PARTS, Reward, Rewarder
from crowdbench.simulation.state import TERMINAL
from crowdbench.spawn import SpawnModel
from crowdbench.spawn.model import Start


class CrowdEnv(EnvBase):
    """Worlds of a scene as a TorchRL environment with batch size (W,) and the N slots as agents.

    Tensors under `agents`, with leading shape (W, N):

    - `observation`, `action`: as in `parallel_env`.
    - `mask`: whether the slot is occupied by a person, who acts in the next step. Actions of empty
      slots are ignored. Train only on transitions whose mask is true before the step.
    - `reward` (W, N, 1) and its parts `reward_parts` (W, N, 7): zero where nobody acted.
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

    def __init__(
        self,
        scene: str | Path | Scene,
        *,
        spawn: str | SpawnModel = DEFAULT_SPAWN,
        worlds: int = 1,
        max_alive: int | None = None,
        horizon_s: float | None = None,
        start: Start | None = None,
        rays: int = 32,
        ray_range_m: float = 10.0,
        observation: str = OBSERVATION,
        reward: Reward | None = None,
        on_full: OnFull = "error",
        seed: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            spawn: the spawn model: a name (default `ntpp-gmm`), `pkg.module:Class`, or an object.
            worlds: number of worlds W.
            max_alive: number of slots N, the maximum number of people at the same time per world;
                default as in `parallel_env`. Fewer slots are faster.
            horizon_s: length of an episode in seconds; default: the length of the recording.
            start: how an episode begins, as in `parallel_env`.
            rays: number of rays of an observation.
            ray_range_m: range of the rays in metres.
            observation: `lidar-1`, `lidar-2` (default), `lidar-3` or `social-1`.
            reward: weights of the parts of the reward; default: `Reward()`.
            on_full: what happens if someone enters and all slots are occupied: `error` raises a
                `CapacityError`, `drop` omits the person and counts it in `dropped`.
            seed: seed of the first episode, from which the seeds of later episodes are drawn.
            device: device of all tensors.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, model, file or
                recording does not exist or does not fit.
        """
        if worlds < 1:
            raise SettingError("worlds", got=str(worlds), expected="a whole number, 1 or more")
        check_on_full(on_full)
        place = load_scene(scene)
        model = spawn_model(spawn, place)
        horizon_s = place.horizon_s if horizon_s is None else horizon_s
        check_horizon(horizon_s)
        if max_alive is None:
            max_alive = slots_for(sample_of(model, place, horizon_s), place)
        super().__init__(device=device, batch_size=self._batch(worlds, max_alive))
        self.scene = place
        self.spawn = model
        self.frames = place.frames(horizon_s)
        self._start = start
        self._on_full = on_full
        settings = Settings(
            max_alive=max_alive, rays=rays, ray_range_m=ray_range_m, observation=observation
        )
        self._simulation = Simulation(self.scene, worlds=worlds, settings=settings)
        self._rewarder = Rewarder(reward or Reward(), self._simulation)
        if self._on_gpu():
            _lock_pages(self._simulation.observation)
        specs = self._specs(worlds, max_alive, self._simulation.observation.shape[-1])
        for name, spec in specs.items():
            setattr(self, name, spec)
        self.set_seed(seed)

    def state(self) -> torch.Tensor:
        """State of everyone present by world and slot, (W, N, 9), for centralised critics.

        See `crowdbench.envs.global_state`.
        """
        return torch.from_numpy(global_state(self._simulation)).to(self.device)

    @staticmethod
    def _batch(worlds: int, slots: int) -> torch.Size:
        return torch.Size([worlds])

    def _specs(self, worlds: int, slots: int, numbers: int) -> dict[str, Composite]:
        each = (worlds, slots)

        def box(*shape: int) -> Bounded:
            return Bounded(-1.0, 1.0, shape=(*each, *shape), dtype=torch.float32)

        def flags(*shape: int) -> Binary:
            return Binary(n=(*each, *shape)[-1], shape=(*each, *shape), dtype=torch.bool)

        def of_agents(**specs: Any) -> Composite:
            agents = Composite(specs, shape=each)
            return Composite({"agents": agents}, shape=(worlds,))

        done = of_agents(done=flags(1), terminated=flags(1), truncated=flags(1))
        for name in ("done", "terminated", "truncated"):
            done[name] = Binary(n=1, shape=(worlds, 1), dtype=torch.bool)
        return {
            "observation_spec": of_agents(
                observation=box(numbers),
                mask=flags(),
                person_id=Unbounded(shape=each, dtype=torch.int64),
                just_spawned=flags(),
                reward_parts=Unbounded(shape=(*each, len(PARTS)), dtype=torch.float32),
            ),
            "action_spec": of_agents(action=box(2)),
            "reward_spec": of_agents(reward=Unbounded(shape=(*each, 1), dtype=torch.float32)),
            "done_spec": done,
        }

    def _set_seed(self, seed: int | None) -> None:
        self._rng = np.random.default_rng(seed)
        self._seeds = [] if seed is None else [seed]
        self._episodes = np.zeros(self._simulation.worlds, np.int64)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        asked = None if tensordict is None else tensordict.get("_reset", None)
        worlds = np.arange(self._simulation.worlds)
        if asked is not None:
            worlds = worlds[asked.reshape(len(worlds), -1).any(dim=1).cpu().numpy()]
        self._begin(worlds)
        return self._present().to(self.device)

    def _begin(self, worlds: Int[np.ndarray, " n"]) -> None:
        """Begin the next episodes of these worlds."""
        seeds = [self._seed_of(int(k)) for k in self._episodes[worlds]]
        self._episodes[worlds] += 1
        simulation = self._simulation
        if len(worlds) == simulation.worlds and len(set(seeds)) == 1:
            self._fill(simulation, seeds[0], first_world=0)
        else:
            alone = Simulation(self.scene, settings=simulation.settings)
            for world, seed in zip(worlds.tolist(), seeds, strict=True):
                self._fill(alone, seed, first_world=world)
                simulation.copy_world(world, alone)
        self._rewarder.begin(worlds)
        self._check_capacity()
        simulation.observe()

    def _fill(self, simulation: Simulation, seed: int, first_world: int) -> None:
        begin(
            simulation,
            self.spawn,
            seed=seed,
            frames=self.frames,
            start=self._start,
            walker=Straight(),
            first_world=first_world,
        )

    def _seed_of(self, episode: int) -> int:
        while len(self._seeds) <= episode:
            self._seeds.append(int(self._rng.integers(2**31)))
        return self._seeds[episode]

    def _present(self) -> TensorDict:
        """Tensors at the beginning of an episode, when nobody has acted."""
        shape = self._simulation.slots.alive.shape
        found = self._seen(np.zeros((*shape, len(PARTS)), np.float32))
        found.update(self._ended(np.zeros(shape, bool)))
        return found

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self._after(tensordict["agents", "action"]).to(self.device)

    def _after(self, action: torch.Tensor) -> TensorDict:
        """Tensors after a step with these actions (W, N, 2)."""
        simulation = self._simulation
        acted = simulation.slots.alive.copy()
        actions = action.detach().cpu().numpy()
        actions = np.where(acted[..., None], actions, 0).astype(np.float32)
        if not np.isfinite(actions).all():
            raise SettingError(
                "action",
                got=f"{int((~np.isfinite(actions)).sum())} values that are not finite",
                expected="numbers in [−1, 1]",
                hint="Check the policy for a division by zero or a diverged network.",
            )
        simulation.step(actions)
        self._check_capacity()
        simulation.observe()
        parts = self._rewarder.parts()
        found = self._seen(parts)
        found["agents", "reward"] = torch.from_numpy(parts.sum(axis=2, keepdims=True))
        found.update(self._ended(~acted))
        return found

    def _seen(self, parts: np.ndarray) -> TensorDict:
        """Tensors of everyone present or just ended; zeros, and −1 as id, in empty slots."""
        slots = self._simulation.slots
        there = slots.alive | (slots.ended != 0)
        agents = {
            "observation": self._shown(there),
            "mask": torch.from_numpy(slots.alive.copy()),
            "person_id": torch.from_numpy(np.where(there, slots.person, -1).astype(np.int64)),
            "just_spawned": torch.from_numpy(slots.spawned & slots.alive),
            "reward_parts": torch.from_numpy(parts),
        }
        return TensorDict(
            {"agents": TensorDict(agents, batch_size=slots.alive.shape)},
            batch_size=[len(slots.alive)],
        )

    def _shown(self, there: Bool[np.ndarray, "W N"]) -> torch.Tensor:
        """A copy of the observations, zeros in empty slots; on a GPU if that is the device."""
        seen = self._simulation.observation
        if not self._on_gpu():
            return torch.from_numpy(np.where(there[..., None], seen, np.float32(0)))
        empty = torch.from_numpy(~there[..., None]).to(self.device)
        # This copy has ended before the simulation writes the next observations.
        return torch.from_numpy(seen).to(self.device).masked_fill_(empty, 0.0)

    def _on_gpu(self) -> bool:
        return self.device is not None and self.device.type == "cuda"

    def _ended(self, nobody: np.ndarray) -> TensorDict:
        """The flags `done`, `terminated` and `truncated`; in the slots `nobody`, nobody acted.

        Those slots are terminated, so that no value is propagated through them.
        """
        simulation = self._simulation
        ended = simulation.slots.ended
        terminated = np.isin(ended, TERMINAL) | nobody
        truncated = (ended != 0) & ~terminated
        over = torch.from_numpy(simulation.clock.frame >= self.frames)[:, None]
        agents = {
            "terminated": torch.from_numpy(terminated)[..., None],
            "truncated": torch.from_numpy(truncated)[..., None],
            "done": torch.from_numpy(terminated | truncated)[..., None],
        }
        return TensorDict(
            {
                "agents": TensorDict(agents, batch_size=ended.shape),
                "done": over,
                "terminated": torch.zeros_like(over),
                "truncated": over.clone(),
            },
            batch_size=[len(ended)],
        )

    @property
    def dropped(self) -> int:
        """Number of people who could not enter in this episode, in all worlds."""
        return dropped(self._simulation)

    def _check_capacity(self) -> None:
        if self._on_full == "error":
            check_capacity(self._simulation)


def _lock_pages(array: np.ndarray) -> None:
    """Lock the memory of an array, from which copies to the GPU are then several times as fast."""
    runtime, address = torch.cuda.cudart(), array.ctypes.data
    torch.cuda.check_error(runtime.cudaHostRegister(address, array.nbytes, 0))
    weakref.finalize(array, runtime.cudaHostUnregister, address)
