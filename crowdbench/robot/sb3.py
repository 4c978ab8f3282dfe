"""`RobotVecEnv`: robot worlds as a `VecEnv` of Stable-Baselines3."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from jaxtyping import UInt8

from crowdbench.envs.one_object import OneObjectVecEnv
from crowdbench.errors import check_seed, checked
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.vector_env import pictures_of, row
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene

if TYPE_CHECKING:
    from crowdbench.robot.drawing import WorldPictures

PICTURED = 4
"""Number of worlds that `render` shows at most."""


class RobotVecEnv(OneObjectVecEnv):
    """Robots in `num_envs` worlds of a scene, all stepped by one call of the compiled core.

    See `RobotEnv` for observations, actions and rewards. When an episode ends, the next one begins
    in the same step, among the people who are there. The last info of an episode contains
    `terminal_observation`, `TimeLimit.truncated`, `is_success`, the measures of
    `crowdbench.robot.measures.MEASURES` and, as that of a `Monitor`, `episode`: the reward `r`, the
    steps `l`, and the seconds `t` since the environment was made. Stable-Baselines3 logs these as
    `ep_rew_mean`, `ep_len_mean` and `success_rate`.
    """

    @checked()
    def __init__(
        self,
        scene: str | Path | Scene,
        num_envs: int = 16,
        config: RobotConfig | None = None,
        *,
        seed: int | None = None,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            num_envs: number of worlds.
            config: the settings, by default those of `RobotConfig()`.
            seed: that of the first world; world k has the seed `seed` + k. `seed()` also sets it.
            render_mode: `rgb_array` for images from `render`, of up to four worlds side by side.
            settings: fields of `RobotConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, policy, model, file or
                recording does not exist or does not fit.
        """
        self.worlds = RobotWorlds(scene, num_envs, config, **settings)
        self._actions = np.zeros((num_envs, 2), np.float32)
        self._collected = np.zeros(num_envs)
        self._made = time.monotonic()
        self._seed = None if seed is None else check_seed(seed)
        self._begun = False
        self._pictures: WorldPictures | None = None
        if render_mode is not None:
            self._pictures = pictures_of(self.worlds, render_mode, min(num_envs, PICTURED))
        super().__init__(
            num_envs,
            self.worlds.observation_space,
            spaces.Box(-1.0, 1.0, (2,), np.float32),
            render_mode,
        )

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the first world from the next `reset` on."""
        first = None if seed is None else check_seed(seed)
        self._seed, self._begun = first, False
        return [None if first is None else first + k for k in range(self.num_envs)]

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
        if self._pictures is not None:
            self._pictures.begin()
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
        if self._pictures is not None:
            self._pictures.follow(dones)
        return observations, reward, dones, infos

    def get_images(self) -> list[UInt8[np.ndarray, "h w 3"] | None]:
        """Pictures of up to four worlds, which `render` puts side by side.

        Raises:
            ActionError: `reset` has not been called.
        """
        return [] if self._pictures is None else [*self._pictures.draw()]
