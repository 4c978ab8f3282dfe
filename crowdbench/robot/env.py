"""`RobotEnv`: one robot among people, as an environment of gymnasium."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from jaxtyping import UInt8

from crowdbench.errors import SettingError, check_seed, checked
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.record import EpisodeRecorder, RobotEpisode
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene

if TYPE_CHECKING:
    from crowdbench.robot.drawing import RobotPictures


class RobotEnv(gymnasium.Env[Any, np.ndarray]):
    """A robot that drives to a goal among people who come and go.

    - Observation: `social`, `lidar` or `state`, see `crowdbench.robot.observing.Observer`.
    - Action, Box(−1, 1, (2,)): of a holonomic robot, a velocity in its own frame (x ahead, y to the
      left) divided by its largest speed; of a unicycle, forward speed and turn rate, divided by
      their largest values; of a bicycle, forward speed and steering angle, likewise. Values out of
      range are clipped. Speeds approach those commanded as fast as the robot's accelerations allow.
    - Reward: see `crowdbench.robot.config.RobotReward`.
    - An episode terminates when the (last) goal is reached, or by a contact with a person or a wall
      unless `collision="count"`. It is truncated by the time limit.
    - `info` at the end contains the measures of `crowdbench.robot.measures.MEASURES`, and with
      `costs=True` also those of `crowdbench.robot.costs.COSTS`. `info` of `reset` contains
      `people_react`, which is False for recorded people and if they do not see the robot.

    `episode` returns the episode so far, which can be written to a file. With
    `render_mode="rgb_array"`, `render` returns a picture.

    People walk on between episodes: `reset` without a seed begins an episode among those who are
    there, with a new crowd after `horizon_s`. With a seed, a new crowd is there at once.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium reads the class's
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }

    @checked()
    def __init__(
        self,
        scene: str | Path | Scene,
        config: RobotConfig | None = None,
        *,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            config: the settings, by default those of `RobotConfig()`.
            render_mode: `rgb_array` for images from `render`.
            settings: fields of `RobotConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, policy, model, file or
                recording does not exist or does not fit.
        """
        self.worlds = RobotWorlds(scene, 1, config, **settings)
        if render_mode not in (None, "rgb_array"):
            raise SettingError("render_mode", got=repr(render_mode), expected="None or 'rgb_array'")
        self.render_mode = render_mode
        self._recorder = EpisodeRecorder(self.worlds)
        self._pictures: RobotPictures | None = None
        self.observation_space = self.worlds.observation_space
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._begun = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; with a seed, among a new crowd. `options` are ignored.

        Raises:
            SettingError: `seed` is no integer from 0.
        """
        seed = None if seed is None else check_seed(seed)
        super().reset(seed=seed)
        if seed is not None or not self._begun:
            first = int(self.np_random.integers(2**31)) if seed is None else seed
            self.worlds.begin(np.array([first]))
            self._begun = True
        else:
            self.worlds.go_on(np.array([0]))
        self._recorder.begin()
        return self._observation(), {"people_react": self.worlds.crowds.react}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drive for a control period; returns observation, reward, terminated, truncated, info.

        Raises:
            ActionError: there is no episode, or the action is not a finite pair of numbers.
        """
        step = self.worlds.step(np.asarray(action)[None])
        self._recorder.write()
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        info: dict[str, Any] = {}
        if terminated or truncated:
            results = self.worlds.results(np.array([0]))
            info = {name: float(values[0]) for name, values in results.items()}
        return self._observation(), float(step.reward[0]), terminated, truncated, info

    def episode(self) -> RobotEpisode:
        """The present episode so far, with methods that write files of it.

        Raises:
            ActionError: no episode has begun.
        """
        return self._recorder.episode()

    def render(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """The present state as an RGB image if `render_mode` is `rgb_array`, else None.

        Raises:
            ActionError: no episode has begun.
        """
        if self.render_mode is None:
            return None
        if self._pictures is None:
            from crowdbench.robot.drawing import RobotPictures

            self._pictures = RobotPictures(self.worlds.scene)
        return self._pictures.draw(self.episode())

    def _observation(self) -> Any:
        seen = self.worlds.observe()
        if isinstance(seen, dict):
            return {name: values[0] for name, values in seen.items()}
        return seen[0]


robot_env = RobotEnv
"""The short name of `RobotEnv`: `crowdbench.robot_env("eth-v0")`."""
