"""`RobotVecEnv`: robot worlds as a `VecEnv` of Stable-Baselines3."""

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from crowdbench.errors import SettingError
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.vector_env import row
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene


class RobotVecEnv(VecEnv):
    """Robots in `num_envs` worlds of a scene, all stepped by one call of the compiled core.

    See `RobotEnv` for observations, actions and rewards. When an episode ends, the next one begins
    in the same step, among the people who are there. The last info of an episode contains
    `terminal_observation`, `TimeLimit.truncated`, `is_success`, the measures of
    `crowdbench.robot.measures.MEASURES` and, as that of a `Monitor`, `episode`: the reward `r`, the
    steps `l`, and the seconds `t` since the environment was made. Stable-Baselines3 logs these as
    `ep_rew_mean`, `ep_len_mean` and `success_rate`.
    """

    def __init__(
        self,
        scene: str | Path | Scene,
        num_envs: int = 16,
        config: RobotConfig | None = None,
        *,
        seed: int | None = None,
        **settings: Any,
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            num_envs: number of worlds.
            config: the settings, by default those of `RobotConfig()`.
            seed: that of the first world; world k has the seed `seed` + k. `seed()` also sets it.
            settings: fields of `RobotConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, policy, model, file or
                recording does not exist or does not fit.
        """
        self.worlds = RobotWorlds(scene, num_envs, config, **settings)
        self._actions = np.zeros((num_envs, 2), np.float32)
        self._collected = np.zeros(num_envs)
        self._made = time.monotonic()
        self._seed = seed
        self._begun = False
        self.render_mode = None
        super().__init__(
            num_envs, self.worlds.observation_space, spaces.Box(-1.0, 1.0, (2,), np.float32)
        )

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the first world from the next `reset` on."""
        self._seed, self._begun = seed, False
        return [None if seed is None else seed + k for k in range(self.num_envs)]

    def reset(self) -> Any:
        """Begin new episodes in all worlds; the first time, with new crowds."""
        if self._begun:
            self.worlds.go_on(np.arange(self.num_envs))
        else:
            first = self._seed
            if first is None:
                first = int(np.random.default_rng().integers(2**31))
            self.worlds.begin(first + np.arange(self.num_envs))
            self._begun = True
        self._collected[:] = 0.0
        return self.worlds.observe()

    def step_async(self, actions: np.ndarray) -> None:
        """Set the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Drive all robots for a control period; return observations, rewards, dones and infos.

        Raises:
            ActionError: actions have another shape or are not finite.
        """
        worlds = self.worlds
        reward, terminated, truncated = worlds.step(self._actions)
        dones = terminated | truncated
        self._collected += reward
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        observations = worlds.observe()
        if dones.any():
            at = np.flatnonzero(dones)
            results = worlds.results(at)
            seconds = round(time.monotonic() - self._made, 6)
            steps = worlds.measures.steps
            for k, w in enumerate(at.tolist()):
                info = {name: float(values[k]) for name, values in results.items()}
                infos[w] = info | {
                    "TimeLimit.truncated": bool(truncated[w]),
                    "is_success": bool(info["success"]),
                    "terminal_observation": row(observations, w),
                    "episode": {
                        "r": float(self._collected[w]), "l": int(steps[w]), "t": seconds,
                    },
                }  # fmt: skip
            self._collected[at] = 0.0
            worlds.go_on(at)
            observations = worlds.observe(at)
        return observations, reward, dones, infos

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """The attribute of this object, repeated for each world."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None
    ) -> None:
        """Set an attribute of this object, which all worlds share."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Not supported: worlds are not objects with methods.

        Raises:
            SettingError: always.
        """
        got = f"a call of {method_name} in sub-environments"
        expected = "a method of the whole environment"
        raise SettingError("RobotVecEnv", got=got, expected=expected)

    def env_is_wrapped(
        self, wrapper_class: type[Any], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """True for `Monitor`, because infos contain what it would add, and else false."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]
