"""The environment for Stable-Baselines3 and `imitation`.

A sub-environment controls one person at a time, and an episode is that person's trip. The module
adds the selection of persons and a reward to `Simulation`; all physics is in `Simulation`.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from gymnasium import spaces
from jaxtyping import Float32, Int, UInt8

from crowdbench.data.table import OUTCOMES
from crowdbench.envs.config import FPS, EnvConfig, EnvCrowd, EnvSettings, Pictured, Seeds
from crowdbench.envs.controlled import ControlledPeople, checked_actions
from crowdbench.envs.one_object import OneObjectVecEnv
from crowdbench.errors import checked
from crowdbench.policies import Policy, Straight
from crowdbench.registry import spawn_model
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation.reward import total
from crowdbench.simulation.simulation import check_count
from crowdbench.simulation.state import TERMINAL
from crowdbench.spawn import SpawnModel

RESERVE = 3
"""Expected number of people present per sub-environment, so that it rarely waits for a person."""


class CrowdVecEnv(OneObjectVecEnv):
    """A `VecEnv` that controls `num_envs` persons at a time in the worlds of a scene.

    When a trip ends, the sub-environment continues with the first observation of another person, as
    a `VecEnv` must: of the people without a sub-environment, the one who entered last, usually in
    the same step. All other people are controlled by the policy `others`.

    - Episodes differ in length. They end at the goal or outside the bounds (`TimeLimit.truncated`
      is false), or by a timeout or the horizon (true). Their last info contains
      `terminal_observation`, `outcome` and, as that of a `Monitor`, `episode`: the reward `r` and
      the steps `l` of the controlled trip, and the seconds `t` since the environment was made.
      Stable-Baselines3 logs their means as `ep_rew_mean` and `ep_len_mean`.
    - `infos` contain the `person_id`, `world` and `reward_parts` of the transition.
    - If no person is free, a sub-environment waits. Each waiting step is an episode of its own with
      an all-zero observation, reward 0 and `waiting`, but no `episode`, in its info. In a rollout
      buffer such a step is a row whose advantage is minus the value of the all-zero observation.
      That is the same for all actions, and soon 0. No advantage passes to a trip before or after
      it, and recurrent policies begin each trip with an empty state. `waited` counts these steps:
      their share is `waited / (num_envs * steps)`. More `worlds` reduce it.
    - All worlds end together at the horizon and restart with new arrivals in the same step.
    - With `render_mode="rgb_array"`, `render` returns a picture of the first world, in which those
      who are controlled have a black ring.
    """

    @checked()
    def __init__(
        self,
        scene: str | Path | Scene,
        num_envs: int = 16,
        config: EnvConfig | None = None,
        *,
        others: Policy | None = None,
        worlds: int | None = None,
        seed: int | None = None,
        render_mode: Pictured | None = None,
        **settings: Unpack[EnvSettings],
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            num_envs: number of sub-environments, that is, of controlled persons in all worlds.
            config: the settings, by default those of `EnvConfig()`.
            others: policy of all other people; default: `straight`. If it names an observation, it
                sees that one, whichever the environment has. It can be replaced later, and moves
                people from the next `reset` on.
            worlds: number of worlds; default: enough for three people per sub-environment.
            seed: seed of the first episode, from which the seeds of later episodes are drawn;
                `seed()` also sets it.
            render_mode: `rgb_array` for images from `render`.
            settings: fields of `EnvConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, model, file or
                recording does not exist or does not fit.
        """
        config = EnvConfig.of(type(self), config, **settings)
        check_count("num_envs", num_envs)
        place = load_scene(scene)
        spawn = spawn_model(config.spawn, place)
        if worlds is None:
            worlds = max(1, math.ceil(RESERVE * num_envs / _persons_at_once(spawn, place)))
        config = replace(config, spawn=spawn)
        self._crowd = EnvCrowd(place, config, worlds=worlds, render_mode=render_mode)
        self.scene, self.spawn, self.frames = place, spawn, self._crowd.frames
        self._simulation = self._crowd.simulation
        self._people = ControlledPeople(self._crowd, num_envs)
        self.others: Policy = others or Straight()
        self.waited = 0
        self._actions = np.zeros((num_envs, 2), np.float32)
        self._collected = np.zeros(num_envs)  # rewards and steps of each trip so far
        self._steps = np.zeros(num_envs, np.int64)
        self._made = time.monotonic()
        size = self._simulation.observation.shape[-1]
        super().__init__(
            num_envs,
            spaces.Box(-1.0, 1.0, (size,), np.float32),
            spaces.Box(-1.0, 1.0, (2,), np.float32),
            render_mode,
        )
        self.metadata["render_fps"] = FPS
        self.seed(seed)

    @property
    def person_id(self) -> Int[np.ndarray, " num_envs"]:
        """Id of each sub-environment's person within its `world`; −1 while it waits."""
        return self._people.person_id

    @property
    def world(self) -> Int[np.ndarray, " num_envs"]:
        """World of each sub-environment's person."""
        return self._people.at[0].copy()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the next episode, from which the seeds of later episodes are drawn."""
        self._episode_seeds = Seeds(seed)
        return [seed] * self.num_envs

    def reset(self) -> Float32[np.ndarray, "num_envs obs"]:
        """Restart all worlds with new arrivals and return the first observations.

        Raises:
            CapacityError: there are more people than `max_alive`.
        """
        self._people.begin(self._episode_seeds.draw(), self.others)
        self._collected[:] = 0
        self._steps[:] = 0
        self._people.take_newest()
        return self._people.observations()

    def step_async(self, actions: np.ndarray) -> None:
        """Set the actions of the next step.

        Raises:
            ActionError: actions have another shape or are not finite.
        """
        self._actions = checked_actions("CrowdVecEnv.step", actions, self.num_envs)

    def step_wait(
        self,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Advance all worlds by one frame; return observations, rewards, dones and infos.

        Raises:
            CapacityError: there are more people than `max_alive`.
        """
        people = self._people
        world, waits = people.at[0].copy(), people.free.copy()
        made = people.step(self._actions)

        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        rewards = np.zeros(self.num_envs, np.float32)
        rewards[made.acting] = total(made.parts[made.acting])
        self._collected += rewards
        self._steps += made.acting
        for k in np.flatnonzero(made.acting).tolist():
            infos[k] = {
                "person_id": int(made.person[k]),
                "world": int(world[k]),
                "reward_parts": made.parts[k].tolist(),
            }
        seconds = time.monotonic() - self._made
        over = made.ended != 0
        for k in np.flatnonzero(over).tolist():
            how = int(made.ended[k])
            infos[k] |= {
                "outcome": OUTCOMES[how],
                "TimeLimit.truncated": how not in TERMINAL,
                "terminal_observation": made.seen[k],
                "episode": {
                    "r": float(self._collected[k]),
                    "l": int(self._steps[k]),
                    "t": round(seconds, 6),
                },
            }
        for k in np.flatnonzero(waits).tolist():
            infos[k] = {
                "waiting": True,
                "TimeLimit.truncated": False,
                "terminal_observation": made.seen[k],
            }
        self.waited += int(waits.sum())
        dones = waits | over

        if people.over:
            return self.reset(), rewards, dones, infos
        self._collected[over] = 0
        self._steps[over] = 0
        people.take_newest()
        return people.observations(), rewards, dones, infos

    def get_images(self) -> list[UInt8[np.ndarray, "h w 3"] | None]:
        """The picture that `render` returns, see there.

        Raises:
            ActionError: `reset` has not been called.
        """
        return [self._crowd.render(self.person_id[(self.world == 0) & ~self._people.free])]


def _persons_at_once(spawn: SpawnModel, scene: Scene) -> float:
    """Mean number of people present if all walk straight to their goals or until the timeout."""
    events = spawn.sample(scene.horizon_s, scene, np.random.default_rng(0))
    via = np.where(np.isnan(events.via), events.start, events.via)
    way = np.linalg.norm(via - events.start, axis=1) + np.linalg.norm(events.goal - via, axis=1)
    dwell_s = way / np.maximum(events.speed, 1e-3) + events.wait_s
    return max(float(np.minimum(dwell_s, scene.timeout_s).sum()) / scene.horizon_s, 1e-3)
