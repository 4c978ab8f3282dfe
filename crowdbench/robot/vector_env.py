"""`RobotVectorEnv`: many robot worlds as one vector environment of gymnasium."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float32, UInt8

from crowdbench.errors import SettingError, check_seed, checked
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene

if TYPE_CHECKING:
    from crowdbench.robot.drawing import WorldPictures

Autoreset = Literal["same_step", "next_step", "disabled"]
MODES = getattr(gymnasium.vector, "AutoresetMode", None)
"""gymnasium's names of the ways to begin the next episode; None before gymnasium 1.1."""
FINAL = ("final_obs" if MODES else "final_observation", "final_info")


class RobotVectorEnv(gymnasium.vector.VectorEnv):
    """W robots in W worlds of a scene, all stepped by one call of the compiled core.

    See `RobotEnv` for observations, actions, rewards and infos. Arrays have one row per world.

    Where an episode ends, `autoreset` says when the next one begins: in the same step (default;
    infos then contain `final_obs` and `final_info`, in gymnasium 0.29 `final_observation`); in the
    next step, whose action is ignored; or when `reset` is called with the option `reset_mask`.
    With `same_step`, the measures of an episode that ended are in `infos["final_info"]`, else in
    `infos`: arrays by name, with a mask of the worlds that they are about under `_` and the name.

    World k begins with the seed s + k if `reset` is given the seed s, and has the same episodes as
    a `RobotEnv` with that seed. A `reset` without a seed begins new episodes among the people who
    are there.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium reads the class's
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }

    @checked()
    def __init__(
        self,
        scene: str | Path | Scene,
        num_envs: int = 1,
        config: RobotConfig | None = None,
        *,
        autoreset: Autoreset = "same_step",
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            num_envs: number of worlds W.
            config: the settings, by default those of `RobotConfig()`.
            autoreset: when the next episode begins.
            render_mode: `rgb_array` for images from `render`.
            settings: fields of `RobotConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, policy, model, file or
                recording does not exist or does not fit.
        """
        if autoreset not in get_args(Autoreset):
            raise SettingError(
                "autoreset",
                got=repr(autoreset),
                expected=f"one of {', '.join(get_args(Autoreset))}",
            )
        self.worlds = RobotWorlds(scene, num_envs, config, **settings)
        self.autoreset = autoreset
        self.metadata = dict(type(self).metadata)  # type: ignore[misc]
        if MODES is not None:
            self.metadata["autoreset_mode"] = MODES[autoreset.upper()]
        self.num_envs = num_envs
        self.closed = False
        self.single_observation_space = self.worlds.observation_space
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = render_mode
        self._pictures: WorldPictures | None = None
        if render_mode is not None:
            self._pictures = pictures_of(self.worlds, render_mode, num_envs)
        self._over, self._nowhere = np.zeros(num_envs, bool), np.zeros(num_envs, bool)
        self._begun = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes in all worlds, or in those of `options["reset_mask"]`.

        Raises:
            SettingError: the seeds or the mask have the wrong number.
        """
        mask = np.ones(self.num_envs, bool)
        if options and options.get("reset_mask") is not None:
            mask = np.asarray(options["reset_mask"], bool)
            if mask.shape != (self.num_envs,) or not (self._begun or mask.all()):
                raise SettingError(
                    "reset_mask",
                    got=f"a mask of shape {mask.shape} for {int(mask.sum())} worlds",
                    expected=f"a mask of shape ({self.num_envs},), with all worlds at first",
                )
        seeds = self._seeds(seed)
        given = np.array([s is not None for s in seeds]) & mask
        if not self._begun:
            drawn = np.random.default_rng().integers(2**31, size=self.num_envs).tolist()
            seeds = [d if s is None else s for s, d in zip(seeds, drawn, strict=True)]
            given = mask
        if given.any():
            chosen = np.flatnonzero(given)
            self.worlds.begin(np.array([seeds[w] for w in chosen.tolist()], np.int64), chosen)
            self._begun = True
        if (mask & ~given).any():
            self.worlds.go_on(np.flatnonzero(mask & ~given))
        self._over[mask] = False
        if self._pictures is not None:
            self._pictures.begin(mask)
        return self.worlds.observe(), {}

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [check_seed(seed) + k for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise SettingError(
                "seed", got=f"{len(seed)} seeds", expected=f"one for each of {self.num_envs} worlds"
            )
        return [None if s is None else check_seed(s) for s in seed]

    def step(
        self, actions: np.ndarray
    ) -> tuple[
        Any,
        Float32[np.ndarray, " W"],
        Bool[np.ndarray, " W"],
        Bool[np.ndarray, " W"],
        dict[str, Any],
    ]:
        """Drive all robots for a control period by actions (W, 2).

        Returns observations, rewards, terminations, truncations and infos.

        Raises:
            ActionError: actions have another shape or are not finite.
        """
        worlds = self.worlds
        reward, terminated, truncated = worlds.step(actions)
        again = self._over
        if self.autoreset == "next_step" and again.any():
            worlds.go_on(np.flatnonzero(again))
            reward[again] = 0.0
            terminated, truncated = terminated & ~again, truncated & ~again
        over = terminated | truncated
        if self._pictures is not None:
            self._pictures.follow(again if self.autoreset == "next_step" else self._nowhere)
        observations = worlds.observe()
        infos: dict[str, Any] = {}
        if over.any():
            at = np.flatnonzero(over)
            ended = self._infos(at, over)
            if self.autoreset == "same_step":
                infos = self._final(observations, ended, over)
                worlds.go_on(at)
                if self._pictures is not None:
                    self._pictures.begin(over)
                observations = worlds.observe(at)
            else:
                infos = ended
        self._over = over
        return observations, reward, terminated, truncated, infos

    def _infos(self, at: np.ndarray, over: np.ndarray) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        for name, values in self.worlds.results(at).items():
            infos[name] = np.zeros(self.num_envs)
            infos[name][at] = values
            infos[f"_{name}"] = over
        return infos

    def _final(self, observations: Any, ended: dict[str, Any], over: np.ndarray) -> dict[str, Any]:
        observed, info = FINAL
        if MODES is None:  # gymnasium 0.29: one object per world
            objects = np.full((2, self.num_envs), None, object)
            named = [name for name in ended if not name.startswith("_")]
            for w in np.flatnonzero(over).tolist():
                objects[0, w] = row(observations, w)
                objects[1, w] = {name: float(ended[name][w]) for name in named}
            return {
                observed: objects[0], f"_{observed}": over, info: objects[1], f"_{info}": over,
            }  # fmt: skip
        return {observed: observations, f"_{observed}": over, info: ended, f"_{info}": over}

    def render(self) -> tuple[UInt8[np.ndarray, "h w 3"], ...] | None:
        """A picture of each world if `render_mode` is `rgb_array`, else None.

        Raises:
            ActionError: no episode has begun.
        """
        return None if self._pictures is None else tuple(self._pictures.draw())

    def close(self, **kwargs: Any) -> None:
        """Do nothing: there is nothing to close."""
        self.closed = True


def pictures_of(worlds: RobotWorlds, render_mode: str, count: int) -> "WorldPictures":
    """What draws the first `count` worlds.

    Raises:
        SettingError: `render_mode` is another one than `rgb_array`.
    """
    if render_mode != "rgb_array":
        raise SettingError("render_mode", got=repr(render_mode), expected="None or 'rgb_array'")
    from crowdbench.robot.drawing import WorldPictures

    return WorldPictures(worlds, count)


def row(observations: Any, world: int) -> Any:
    """The observation of one robot."""
    if isinstance(observations, dict):
        return {name: values[world] for name, values in observations.items()}
    return observations[world]
