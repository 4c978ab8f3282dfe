"""The view of Stable-Baselines3 and `imitation`: a sub-environment is a person, an episode a life.

It adds choosing persons and a reward to `Simulation`, and no physics.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from jaxtyping import Float32, Int
from stable_baselines3.common.vec_env import VecEnv

from crowdbench.errors import ActionError, SettingError
from crowdbench.policies import Policy, Straight
from crowdbench.registry import DEFAULT_SPAWN, spawn_model
from crowdbench.rollouts.episode import (
    actions_of,
    begin,
    check_capacity,
    check_horizon,
    generator,
    slots_for,
)
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.simulation.reward import Reward, Rewarder
from crowdbench.simulation.simulation import TIMEOUT_DWELLS
from crowdbench.simulation.state import TERMINAL
from crowdbench.spawn import SpawnEvents, SpawnModel
from crowdbench.spawn.model import Start
from crowdbench.trajectories.table import OUTCOMES

RESERVE = 3
"""Persons expected to be there for each sub-environment, so that it seldom waits for one."""


class LivesVecEnv(VecEnv):
    """`num_envs` persons at a time in the worlds of a scene, each until its life ends.

    A sub-environment whose person's life has ended goes on, as the contract of a `VecEnv` has it,
    with the first observation of its next one: of the persons whom no sub-environment has, the one
    who entered last, most often in this very step. All who are not chosen are walked by `others`.

    - Episodes differ in length: they end at the goal or outside (`TimeLimit.truncated` False), or
      by a timeout or the horizon (True). The last observation of a life is its
      `terminal_observation`, and `outcome` says how it ended.
    - `infos` hold `person_id` and `world` of whom the transition is about, and `reward_parts`.
    - Where everyone is taken, a sub-environment waits: it sees zeros, and each step is an episode
      of its own with reward 0 and `waiting` in its info. `waited` counts these steps; more
      `worlds` make them fewer.
    - All worlds end together at the horizon, and begin anew with other arrivals in the same step.
    """

    def __init__(
        self,
        scene: str | Path | Scene,
        num_envs: int = 16,
        *,
        spawn: str | SpawnModel = DEFAULT_SPAWN,
        others: Policy | None = None,
        worlds: int | None = None,
        max_alive: int | None = None,
        horizon_s: float | None = None,
        start: Start | None = None,
        rays: int = 32,
        ray_range_m: float = 10.0,
        observation: str = OBSERVATION,
        reward: Reward | None = None,
        seed: int | None = None,
    ) -> None:
        """Make the worlds.

        Args:
            scene: an id from `list_scenes()`, or a folder with a `scene.toml`.
            num_envs: sub-environments, which is persons at a time in all worlds together.
            spawn: who enters when and where: a name, `pkg.module:Class`, or a model; by default
                the crowd that `ntpp-gmm` spawns.
            others: who walks everyone else, by default `straight`. It can be set later.
            worlds: by default as many as hold three persons for each sub-environment.
            max_alive: persons at once in each world; by default as in `parallel_env`.
            horizon_s: length of an episode of the worlds, by default the recording's.
            start: how it begins, as in `parallel_env`.
            rays: R, number of rays that a person sees by.
            ray_range_m: their range in metres.
            observation: `lidar-1`, `lidar-2` (the default) or `lidar-3`.
            reward: weights of its parts, by default those of `Reward()`.
            seed: of the first episode and of the seeds of all others; `seed()` sets it too.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: what was asked for does not
                exist or does not fit.
        """
        for name, value in (("num_envs", num_envs), ("worlds", 1 if worlds is None else worlds)):
            if not isinstance(value, int | np.integer) or value < 1:
                raise SettingError(name, got=repr(value), expected="a whole number, 1 or more")
        self.scene = load_scene(scene)
        self.spawn = spawn_model(spawn, self.scene)
        horizon_s = self.scene.horizon_s if horizon_s is None else horizon_s
        check_horizon(horizon_s)
        self.frames = self.scene.frames(horizon_s)
        self.others: Policy = others or Straight()
        self.waited = 0
        sample = self.spawn.sample(self.scene.horizon_s, self.scene, np.random.default_rng(0))
        if worlds is None:
            worlds = max(1, math.ceil(RESERVE * num_envs / _persons_at_once(sample, self.scene)))
        if max_alive is None:
            max_alive = slots_for(sample, self.scene)
        self._start = start
        self._simulation = Simulation(
            self.scene,
            worlds=worlds,
            settings=Settings(
                max_alive=max_alive, rays=rays, ray_range_m=ray_range_m, observation=observation
            ),
        )
        self._rewarder = Rewarder(reward or Reward(), self._simulation)
        self._actions = np.zeros((num_envs, 2), np.float32)
        self._at = np.zeros((2, num_envs), np.int64)  # world and slot of each one's person
        self._waits = np.ones(num_envs, bool)
        self._taken = np.zeros((worlds, max_alive), bool)
        size = self._simulation.observation.shape[-1]
        super().__init__(
            num_envs,
            spaces.Box(-1.0, 1.0, (size,), np.float32),
            spaces.Box(-1.0, 1.0, (2,), np.float32),
        )
        self.seed(seed)

    @property
    def person_id(self) -> Int[np.ndarray, " num_envs"]:
        """Whom each sub-environment has, numbered within its `world`; −1 for nobody."""
        ids = self._simulation.slots.person[*self._at].astype(np.int64)
        return np.where(self._waits, -1, ids)

    @property
    def world(self) -> Int[np.ndarray, " num_envs"]:
        """The world of that person."""
        return self._at[0].copy()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the next episode, and of the seeds of those that follow."""
        self._rng = np.random.default_rng(seed)
        self._next_seed = seed
        return [seed] * self.num_envs

    def reset(self) -> Float32[np.ndarray, "num_envs obs"]:
        """Begin an episode of all worlds with new arrivals; first observations.

        Raises:
            CapacityError: more persons than `max_alive`.
        """
        simulation = self._simulation
        seed = int(self._rng.integers(2**31)) if self._next_seed is None else self._next_seed
        self._next_seed = None
        begin(
            simulation,
            self.spawn,
            seed=seed,
            frames=self.frames,
            start=self._start,
            walker=Straight(),
        )
        self._rewarder.begin()
        check_capacity(simulation)
        self.others.reset(self.scene, generator(seed, 0, "policy"))
        simulation.observe()
        self._waits[:] = True
        self._taken[:] = False
        self._choose()
        return self._seen()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the coming step.

        Raises:
            ActionError: another shape, or values that are not finite.
        """
        given = np.asarray(actions, np.float32)
        if given.shape != (self.num_envs, 2) or not np.isfinite(given).all():
            raise ActionError(
                "LivesVecEnv.step",
                got=f"an array of shape {given.shape}"
                if given.shape != (self.num_envs, 2)
                else f"{int((~np.isfinite(given)).sum())} values that are not finite",
                expected=f"finite numbers of shape ({self.num_envs}, 2)",
            )
        self._actions = given

    def step_wait(
        self,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Advance all worlds by a frame.

        Raises:
            CapacityError: more persons than `max_alive`.
        """
        simulation = self._simulation
        acting = ~self._waits
        at = tuple(self._at[:, acting])
        actions = actions_of(self.others, simulation, ~self._taken)
        actions[at] = self._actions[acting]
        simulation.step(actions)
        check_capacity(simulation)
        simulation.observe()

        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        rewards = np.zeros(self.num_envs, np.float32)
        parts = self._rewarder.parts()[at]
        rewards[acting] = parts.sum(axis=1)
        ended = np.zeros(self.num_envs, np.int8)
        ended[acting] = simulation.slots.ended[at]
        whose = zip(
            np.flatnonzero(acting).tolist(),
            self.person_id[acting].tolist(),
            at[0].tolist(),
            parts.tolist(),
            strict=True,
        )
        for k, person, world, of_person in whose:
            infos[k] = {"person_id": person, "world": world, "reward_parts": of_person}
        before = self._seen()
        for k in np.flatnonzero(ended).tolist():
            how = int(ended[k])
            infos[k] |= {
                "outcome": OUTCOMES[how],
                "TimeLimit.truncated": how not in TERMINAL,
                "terminal_observation": before[k],
            }
        for k in np.flatnonzero(self._waits).tolist():
            infos[k] = {
                "waiting": True,
                "TimeLimit.truncated": False,
                "terminal_observation": before[k],
            }
        self.waited += int(self._waits.sum())
        dones = self._waits | (ended != 0)

        if simulation.clock.frame[0] >= self.frames:
            return self.reset(), rewards, dones, infos
        over = ended != 0
        self._taken[tuple(self._at[:, over])] = False
        self._waits |= over
        self._choose()
        return self._seen(), rewards, dones, infos

    def _choose(self) -> None:
        """Give those who have nobody the persons who entered last, ties by world and slot."""
        free = np.flatnonzero(self._waits)
        if not len(free):
            return
        slots = self._simulation.slots
        w, i = np.nonzero(slots.alive & ~self._taken)
        newest = np.argsort(-slots.born[w, i], kind="stable")[: len(free)]
        w, i, free = w[newest], i[newest], free[: len(newest)]
        self._at[:, free] = w, i
        self._taken[w, i] = True
        self._waits[free] = False

    def _seen(self) -> Float32[np.ndarray, "num_envs obs"]:
        seen = self._simulation.observation[*self._at]
        seen[self._waits] = 0
        return seen

    def close(self) -> None:
        """Hold nothing that needs closing."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """The attribute of this object, once for each sub-environment: they share it."""
        if attr_name == "render_mode":
            return [None] * len(self._indices(indices))
        return [getattr(self, attr_name) for _ in self._indices(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None
    ) -> None:
        """Set an attribute of this object: all sub-environments share it."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Not there: persons have no methods.

        Raises:
            SettingError: always.
        """
        raise SettingError(
            "LivesVecEnv",
            got=f"a call of {method_name} in sub-environments",
            expected="a method of the whole",
            hint="Sub-environments are persons of the same worlds, not objects of their own.",
        )

    def env_is_wrapped(
        self, wrapper_class: type[Any], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """No sub-environment is wrapped."""
        return [False] * len(self._indices(indices))

    def _indices(self, indices: int | Iterable[int] | None) -> list[int]:
        return list(self._get_indices(indices))


def _persons_at_once(events: SpawnEvents, scene: Scene) -> float:
    """Mean number of persons who are there if all walk straight, with their patience."""
    way = np.linalg.norm(events.goal - events.start, axis=1)
    patience_s = TIMEOUT_DWELLS * scene.recording.dwell_p99_s
    dwell_s = way / np.maximum(events.speed, 1e-3)
    return max(float(np.minimum(dwell_s, patience_s).sum()) / scene.horizon_s, 1e-3)
