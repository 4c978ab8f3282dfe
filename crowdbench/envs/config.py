"""The settings that the environments have in common, and the simulation that they run."""

from dataclasses import dataclass, field, fields, replace
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict, Unpack, get_args

import numpy as np
from gymnasium import logger
from jaxtyping import Float32, Int, UInt8

from crowdbench.errors import SettingError, check_seed, checked, did_you_mean
from crowdbench.policies import Straight
from crowdbench.registry import DEFAULT_SPAWN, spawn_model
from crowdbench.run.episode import begin, check_capacity, check_horizon, sample_of, slots_for
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.simulation.reward import Reward, RewardFn, reward_function
from crowdbench.simulation.simulation import check_count
from crowdbench.spawn import SpawnModel
from crowdbench.spawn.model import Start

if TYPE_CHECKING:
    from crowdbench.viewer.renderer import Camera

OnFull = Literal["error", "drop"]
Pictured = Literal["rgb_array"]
"""The `render_mode` of environments that a viewer cannot follow, because of their many worlds or
because they go on from one trip to the next."""
FPS = 10
"""Frames per second of videos; four times real time on most scenes."""


class EnvSettings(TypedDict, total=False):
    """The fields of `EnvConfig` as keywords, for type checkers."""

    spawn: str | SpawnModel
    horizon_s: float | None
    start: Start | None
    observation: str
    rays: int
    ray_range_m: float
    reward: Reward | RewardFn
    max_alive: int | None
    on_full: OnFull


@checked("crowdbench.simulation.state:CrowdState")
@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """Settings of `parallel_env`, `CrowdEnv`, `SlotEnv` and `CrowdVecEnv`.

    Each environment takes them as keywords, or a config, whose values keywords replace.

    Raises:
        SettingError: a value is out of range.
    """

    spawn: str | SpawnModel = DEFAULT_SPAWN
    """The spawn model: a name (default `ntpp-gmm`), `pkg.module:Class`, or an object."""
    horizon_s: float | None = None
    """Length of an episode in seconds; default: the length of the recording."""
    start: Start | None = None
    """How an episode begins: `stationary` (after a discarded warm-up with straight walkers),
    `recorded` (replay only) or `empty`; default: the spawn model's attribute `start`."""
    observation: str = OBSERVATION
    """`lidar-1`; `lidar-2` (default), which contains the preferred speed and the path around walls;
    `lidar-3`, which also contains the distances to the bounds; `social-1`, the nearest people in
    the person's own frame, without rays; `lidar-2-contact` and `social-1-contact`, which also
    contain what bodies and walls kept the person from walking; or a registered observation."""
    rays: int = 32
    """Number of rays of an observation."""
    ray_range_m: float = 10.0
    """Range of the rays in metres."""
    reward: Reward | RewardFn = field(default_factory=Reward)
    """Weights of the parts of the usual reward, or a reward of one's own, see
    `crowdbench.simulation.reward.RewardFn`."""
    max_alive: int | None = None
    """Number of slots: maximum number of people at the same time per world; default: 256, or twice
    the size of a crowd in which nobody reaches a goal, if that is more. Fewer slots are faster."""
    on_full: OnFull = "error"
    """What happens if someone enters and all slots (or, in `parallel_env`, ids) are in use: `error`
    raises a `CapacityError`, `drop` omits the person and counts it in the environment's
    `dropped`."""

    def __post_init__(self) -> None:
        if self.horizon_s is not None:
            check_horizon(self.horizon_s)

    @classmethod
    def of(
        cls, env: type, config: "EnvConfig | None", **settings: Unpack[EnvSettings]
    ) -> "EnvConfig":
        """The config of an environment, whose values `settings` replace.

        Raises:
            SettingError: the environment has no such setting, or a value is out of range.
        """
        known = [f.name for f in fields(cls)]
        for name in settings:
            if name not in known:
                parameters = signature(env.__init__).parameters.values()  # type: ignore[misc]
                ours = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
                got = f"the setting {name!r}"
                expected = f"one of {', '.join([*known, *ours])}"
                hint = did_you_mean(name, [*known, *ours])
                raise SettingError(env.__name__, got=got, expected=expected, hint=hint)
        return replace(config or cls(), **settings)


class EnvCrowd:
    """The simulation that an environment runs, how its episodes begin, and its reward."""

    def __init__(
        self,
        scene: str | Path | Scene,
        config: EnvConfig,
        *,
        worlds: int = 1,
        max_persons: int | None = Settings.max_persons,
        render_mode: Pictured | None = None,
    ) -> None:
        """Create the simulation.

        `max_persons` is the maximum number of people per world, in an episode and its warm-up;
        None: twice the size of a sample of the spawn model, plus 100. With `render_mode`, `render`
        makes pictures of the first world.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, model, file or
                recording does not exist or does not fit.
        """
        check_count("worlds", worlds)
        if render_mode not in (None, *get_args(Pictured)):
            raise SettingError("render_mode", got=repr(render_mode), expected="None or 'rgb_array'")
        self.config, self.render_mode = config, render_mode
        self.scene = load_scene(scene)
        self.spawn = spawn_model(config.spawn, self.scene)
        horizon_s = self.scene.horizon_s if config.horizon_s is None else config.horizon_s
        self.frames = self.scene.frames(horizon_s)
        max_alive = config.max_alive
        if max_persons is None or max_alive is None:
            sample = sample_of(self.spawn, self.scene, horizon_s)
            max_persons = 2 * len(sample) + 100 if max_persons is None else max_persons
            max_alive = slots_for(sample, self.scene) if max_alive is None else max_alive
        settings = Settings(
            max_alive=max_alive,
            max_persons=max_persons,
            rays=config.rays,
            ray_range_m=config.ray_range_m,
            observation=config.observation,
        )
        self.simulation = Simulation(self.scene, worlds=worlds, settings=settings)
        self._reward = reward_function(config.reward)
        self._camera: Camera | None = None
        if render_mode is not None:
            from crowdbench.viewer import renderer

            self._camera = renderer.Camera(self.simulation)

    def begin(
        self, seed: int, *, simulation: Simulation | None = None, first_world: int = 0
    ) -> None:
        """Begin an episode in all worlds, or in another simulation from `first_world` on."""
        begin(
            simulation or self.simulation,
            self.spawn,
            seed=seed,
            frames=self.frames,
            start=self.config.start,
            walker=Straight(),
            first_world=first_world,
        )

    def reward_parts(self) -> Float32[np.ndarray, "W N parts"]:
        """Parts of the reward of everyone who acted in the last step, zeros in other slots.

        Raises:
            OwnCodeError: a reward function of a user's own raised an exception, or returned an
                array of another shape or numbers that are not finite.
        """
        parts: np.ndarray = self._reward(self.simulation)
        return parts

    def follow(self) -> None:
        """See where people are now, for trails in pictures; called after each reset and step."""
        if self._camera is not None:
            self._camera.follow()

    def render(
        self, controlled: Int[np.ndarray, " _"] | None = None
    ) -> UInt8[np.ndarray, "h w 3"] | None:
        """The first world as an RGB image, with a ring around those with the ids `controlled`.

        None, with a warning, without a `render_mode`.

        Raises:
            ActionError: there has been no episode yet.
        """
        if self._camera is None:
            logger.warn("render draws nothing: the environment was created without a render_mode.")
            return None
        return self._camera.picture(controlled)

    @property
    def dropped(self) -> int:
        """Number of people, in all worlds, who could not enter for lack of slots or ids."""
        clock = self.simulation.clock
        return int(clock.no_slot.sum() + clock.no_id.sum())

    def check_capacity(self) -> None:
        """Check that everyone could enter, unless `on_full` is `drop`.

        Raises:
            CapacityError: there are more people than slots or ids.
        """
        if self.config.on_full == "error":
            check_capacity(self.simulation)


class Seeds:
    """The seeds of an environment's episodes: a given one, then those that are drawn from it."""

    def __init__(self, first: int | None = None) -> None:
        self._first = None if first is None else check_seed(first)
        self._rng = np.random.default_rng(self._first)

    def draw(self) -> int:
        """The seed of the next episode."""
        first, self._first = self._first, None
        return int(self._rng.integers(2**31)) if first is None else first
