"""The TorchRL view: `W` worlds of `N` slots as tensors, with a mask.

It adds names and a reward to `Simulation`, and no physics.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from crowdbench.errors import SettingError
from crowdbench.policies import Straight
from crowdbench.registry import DEFAULT_SPAWN, spawn_model
from crowdbench.rollouts.episode import begin, check_capacity, check_horizon
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.simulation.reward import PARTS, Reward, Rewarder
from crowdbench.simulation.state import TERMINAL
from crowdbench.spawn import SpawnModel
from crowdbench.spawn.model import Start


class CrowdEnv(EnvBase):
    """Worlds of a scene as a TorchRL environment of batch size (W,), its agents the N slots.

    Under `agents`, with a leading (W, N):

    - `observation`, `action`: as in `parallel_env`.
    - `mask`: whether someone is there, who acts in the coming step. Actions of the others are not
      read; learn from transitions whose mask, before the step, is true, and from no others.
    - `reward` (W, N, 1), and its parts in `reward_parts` (W, N, 5); zeros where nobody acted.
    - `done`, `terminated`, `truncated` (W, N, 1): the person's life has ended in this step, at its
      goal or outside (terminated), or by a timeout or the horizon (truncated). The observation
      that comes with them is the last of that life: values of truncated lives are of it. Where
      nobody is, `done` and `terminated` are true, so that no advantage is passed on from whoever
      has the slot next. A slot is handed over in a later step, never in the one that ends a life.
    - `person_id`: −1 where nobody is; `just_spawned`: the person entered in this step.

    All worlds begin and end together, at the horizon. Each has arrivals of its own.
    """

    batch_locked = True

    def __init__(
        self,
        scene: str | Path | Scene,
        *,
        spawn: str | SpawnModel = DEFAULT_SPAWN,
        worlds: int = 1,
        max_alive: int = 64,
        horizon_s: float | None = None,
        start: Start | None = None,
        rays: int = 32,
        ray_range_m: float = 10.0,
        observation: str = OBSERVATION,
        reward: Reward | None = None,
        drop: bool = True,
        seed: int | None = None,
    ) -> None:
        """Make the worlds.

        Args:
            scene: an id from `list_scenes()`, or a folder with a `scene.toml`.
            spawn: who enters when and where: a name, `pkg.module:Class`, or a model; by default
                the crowd that `ntpp-gmm` spawns.
            worlds: W.
            max_alive: N, persons at once in each world.
            horizon_s: length of an episode in seconds, by default the recording's.
            start: how it begins, as in `parallel_env`.
            rays: R, number of rays that a person sees by.
            ray_range_m: their range in metres.
            observation: `lidar-1`, `lidar-2` (the default) or `lidar-3`.
            reward: weights of its parts, by default those of `Reward()`.
            drop: whether people for whom there is no slot are turned away, and counted in
                `dropped`; else they are an error.
            seed: of the first episode and of the seeds of all others.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: what was asked for does not
                exist or does not fit.
        """
        if worlds < 1:
            raise SettingError("worlds", got=str(worlds), expected="a whole number, 1 or more")
        super().__init__(device="cpu", batch_size=torch.Size([worlds]))
        self.scene = load_scene(scene)
        self.spawn = spawn_model(spawn, self.scene)
        horizon_s = self.scene.horizon_s if horizon_s is None else horizon_s
        check_horizon(horizon_s)
        self.frames = self.scene.frames(horizon_s)
        self._start = start
        self._drop = drop
        self._simulation = Simulation(
            self.scene,
            worlds=worlds,
            settings=Settings(
                max_alive=max_alive, rays=rays, ray_range_m=ray_range_m, observation=observation
            ),
        )
        self._rewarder = Rewarder(reward or Reward(), self._simulation)
        self._make_specs(worlds, max_alive, self._simulation.observation.shape[-1])
        self.set_seed(seed)

    def _make_specs(self, worlds: int, slots: int, numbers: int) -> None:
        each = (worlds, slots)

        def box(*shape: int) -> Bounded:
            return Bounded(-1.0, 1.0, shape=(*each, *shape), dtype=torch.float32)

        def flags(*shape: int) -> Binary:
            return Binary(n=(*each, *shape)[-1], shape=(*each, *shape), dtype=torch.bool)

        def of_agents(**specs: Any) -> Composite:
            agents = Composite(specs, shape=each)
            return Composite({"agents": agents}, shape=(worlds,))

        self.observation_spec = of_agents(
            observation=box(numbers),
            mask=flags(),
            person_id=Unbounded(shape=each, dtype=torch.int64),
            just_spawned=flags(),
            reward_parts=Unbounded(shape=(*each, len(PARTS)), dtype=torch.float32),
        )
        self.action_spec = of_agents(action=box(2))
        self.reward_spec = of_agents(reward=Unbounded(shape=(*each, 1), dtype=torch.float32))
        done = of_agents(done=flags(1), terminated=flags(1), truncated=flags(1))
        for name in ("done", "terminated", "truncated"):
            done[name] = Binary(n=1, shape=(worlds, 1), dtype=torch.bool)
        self.done_spec = done

    def _set_seed(self, seed: int | None) -> None:
        self._seeds = np.random.default_rng(seed)
        self._next_seed = seed

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        asked = None if tensordict is None else tensordict.get("_reset", None)
        if asked is not None and not asked.all():
            raise SettingError(
                "reset", got="some of the worlds", expected="all of them: they end together"
            )
        seed = int(self._seeds.integers(2**31)) if self._next_seed is None else self._next_seed
        self._next_seed = None
        begin(
            self._simulation,
            self.spawn,
            seed=seed,
            frames=self.frames,
            start=self._start,
            walker=Straight(),
        )
        self._rewarder.begin()
        self._check_capacity()
        self._simulation.observe()
        shape = self._simulation.slots.alive.shape
        found = self._seen(np.zeros((*shape, len(PARTS)), np.float32))
        found.update(self._ended(np.zeros(shape, bool)))
        return found

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        simulation = self._simulation
        acted = simulation.slots.alive.copy()
        actions = tensordict["agents", "action"].detach().numpy()
        actions = np.where(acted[..., None], actions, 0).astype(np.float32)
        if not np.isfinite(actions).all():
            raise SettingError(
                "action",
                got=f"{int((~np.isfinite(actions)).sum())} values that are not finite",
                expected="numbers in [−1, 1]",
                hint="Look for a division by zero or a diverged network in the policy.",
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
        """What everyone sees who is there or has just ended; zeros and −1 in free slots."""
        simulation, slots = self._simulation, self._simulation.slots
        there = slots.alive | (slots.ended != 0)
        seen = np.where(there[..., None], simulation.observation, np.float32(0))
        agents = {
            "observation": torch.from_numpy(seen),
            "mask": torch.from_numpy(slots.alive.copy()),
            "person_id": torch.from_numpy(np.where(there, slots.person, -1).astype(np.int64)),
            "just_spawned": torch.from_numpy(slots.spawned & slots.alive),
            "reward_parts": torch.from_numpy(parts),
        }
        return TensorDict(
            {"agents": TensorDict(agents, batch_size=slots.alive.shape)},
            batch_size=self.batch_size,
        )

    def _ended(self, nobody: np.ndarray) -> TensorDict:
        """Who ended in this step; where nobody acted there is nothing to carry on."""
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
            batch_size=self.batch_size,
        )

    @property
    def dropped(self) -> int:
        """Persons turned away in this episode for want of slots, in all worlds."""
        return int(self._simulation.clock.no_slot.sum())

    def _check_capacity(self) -> None:
        if not self._drop:
            check_capacity(self._simulation)
