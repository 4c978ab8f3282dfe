"""One person of a crowd as a `gymnasium.Env`: `gymnasium.make("crowdbench/eth-v0")`.

For many persons at a time, which learn much faster, see `CrowdVecEnv` and `CrowdEnv`.
"""

from pathlib import Path
from typing import Any, ClassVar, Unpack

import gymnasium
import numpy as np
from gymnasium import spaces
from jaxtyping import UInt8

from crowdbench.data.table import OUTCOMES
from crowdbench.envs.config import FPS, EnvConfig, EnvCrowd, EnvSettings, Pictured, Seeds
from crowdbench.envs.controlled import ControlledPeople, checked_actions
from crowdbench.errors import ActionError, SettingError, check_seed, checked
from crowdbench.policies import Policy, Straight
from crowdbench.scene import Scene
from crowdbench.simulation.reward import total
from crowdbench.simulation.state import TERMINAL

_NOBODY = np.zeros((1, 2), np.float32)
_TRIES = 10  # crowds in which nobody enters, before `reset` gives up


class PersonEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A crowd in which the environment's user walks one person at a time.

    An episode is the trip of one person, from its entry on. It is terminated at the goal or outside
    the bounds, and truncated by the scene's timeout or when the crowd reaches its horizon. All
    other people are walked by the policy `others`. `reset` goes on in the same crowd, with the
    person who enters next (of several in one frame, the first). A new crowd begins at the horizon,
    and with `reset(seed=…)`.

    - Observation, action and reward are those of `parallel_env`.
    - `info` contains the `person_id` and the `frame` of the crowd; after a step the
      `reward_parts`, and in the last step of a trip the `outcome`.
    - With `render_mode="rgb_array"`, `render` returns a picture in which the person has a black
      ring.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # gymnasium reads the class's
        "render_modes": ["rgb_array"],
        "render_fps": FPS,
    }

    @checked()
    def __init__(
        self,
        scene: str | Path | Scene,
        config: EnvConfig | None = None,
        *,
        others: Policy | None = None,
        render_mode: Pictured | None = None,
        **settings: Unpack[EnvSettings],
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            config: the settings, by default those of `EnvConfig()`.
            others: policy of all other people; default: `straight`. If it names an observation, it
                sees that one, whichever the environment has.
            render_mode: `rgb_array` for images from `render`.
            settings: fields of `EnvConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, model, file or
                recording does not exist or does not fit.
        """
        config = EnvConfig.of(type(self), config, **settings)
        self._crowd = EnvCrowd(scene, config, render_mode=render_mode)
        self.render_mode = render_mode
        self.scene, self.spawn = self._crowd.scene, self._crowd.spawn
        self.others: Policy = others or Straight()
        self._people = ControlledPeople(self._crowd, 1)
        self._seeds = Seeds()
        self._begun = False
        self._last = -1  # the person of the last trip
        size = self._crowd.simulation.observation.shape[-1]
        self.observation_space = spaces.Box(-1.0, 1.0, (size,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Go on to the next person who enters; return its observation and an info.

        With a seed, a new crowd begins, whose arrivals and those of all later ones depend on
        nothing else. `options` are ignored.

        Raises:
            CapacityError: there are more people than slots, unless `on_full` is `drop`.
            SettingError: nobody enters in several crowds.
        """
        seed = None if seed is None else check_seed(seed)
        super().reset(seed=seed)
        people = self._people
        if seed is not None:
            self._seeds, self._begun = Seeds(seed), False
        people.release(~people.free)  # who is left in the middle of a trip walks on
        begun = 0
        while not (self._begun and self._take_entered()):
            if not self._begun or people.over:
                self._check_arrivals(begun)
                people.begin(self._seeds.draw(), self.others)
                self._begun, self._last, begun = True, -1, begun + 1
            else:
                people.step(_NOBODY)
        return people.observations()[0], self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance the crowd by one frame; return observation, reward, flags and info.

        Raises:
            ActionError: the trip is over or has not begun, or the action has another shape or is
                not finite.
            CapacityError: there are more people than slots, unless `on_full` is `drop`.
        """
        people = self._people
        if people.free[0]:
            raise ActionError(
                "PersonEnv.step", got="no trip", expected="a call of reset first",
                hint="The trip is over or has not begun.",
            )  # fmt: skip
        made = people.step(checked_actions("PersonEnv.step", np.asarray(action)[None], 1))
        info = self._info() | {
            "person_id": int(made.person[0]),
            "reward_parts": made.parts[0].tolist(),
        }
        how = int(made.ended[0])
        if how:
            info["outcome"] = OUTCOMES[how]
        reward = float(total(made.parts)[0])
        return made.seen[0], reward, how in TERMINAL, how != 0 and how not in TERMINAL, info

    def render(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """The current frame as an RGB image if `render_mode` is `rgb_array`, else None.

        Raises:
            ActionError: `reset` has not been called.
        """
        return self._crowd.render(self._people.person_id)

    def _take_entered(self) -> bool:
        """Control the first of those who entered in this frame and have had no trip, if any."""
        simulation = self._crowd.simulation
        slots, entered = simulation.slots, simulation.events[0].entered
        slot = np.flatnonzero(slots.spawned[0] & slots.alive[0])
        person = slots.person[0, slot]
        new = (person > self._last) & entered[slots.event[0, slot]]  # others were there before
        if not new.any():
            return False
        self._last = int(person[new].min())
        self._people.take(np.zeros(1, np.int64), slot[person == self._last])
        return True

    def _check_arrivals(self, begun: int) -> None:
        if begun >= _TRIES:
            raise SettingError(
                f"arrivals of {self.spawn.name}",
                got=f"nobody who enters in {begun} episodes of {self._crowd.frames} frames",
                expected="people who enter",
                hint="Set a longer horizon_s, or another spawn model.",
            )

    def _info(self) -> dict[str, Any]:
        frame = int(self._crowd.simulation.clock.frame[0])
        return {"person_id": int(self._people.person_id[0]), "frame": frame}


person_env = PersonEnv
"""The name beside `parallel_env` and `aec_env`."""
