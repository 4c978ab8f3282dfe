"""The PettingZoo environment: a `ParallelEnv` whose agents enter and leave during an episode.

It adds names, dictionaries and a reward to `Simulation`; all physics is in `Simulation`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Unpack

import numpy as np
from gymnasium import logger, spaces
from jaxtyping import UInt8
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import parallel_to_aec

from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.envs.config import FPS, EnvConfig, EnvCrowd, EnvSettings, Seeds
from crowdbench.envs.global_state import SIZE as STATE_SIZE
from crowdbench.envs.global_state import global_state
from crowdbench.errors import ActionError, SettingError, checked
from crowdbench.run.episode import Recorder
from crowdbench.scene import Scene
from crowdbench.simulation.reward import total
from crowdbench.simulation.state import TERMINAL

if TYPE_CHECKING:
    from crowdbench.viewer.renderer import Renderer, RenderMode

RENDER_MODES = ("human", "rgb_array")


class CrowdParallelEnv(ParallelEnv):  # type: ignore[misc]  # pettingzoo is untyped
    """A crowd as a parallel environment; created by `crowdbench.parallel_env`.

    An agent is a person. It appears when the person enters (with reward 0, not done), acts once
    per frame, and disappears when the person's trip ends. The trip is terminated at the goal,
    outside the bounds, or where its recording ends. It is truncated by the scene's timeout or by
    the episode's horizon. Nobody enters at the horizon.

    Empty frames are skipped: the call continues to the next arrival. `infos` contain the `frame`,
    the number of `frames_skipped` and, in the last step of a trip, the `outcome`. `agents` is
    therefore empty only when the episode is over.

    - Observation: `lidar-2` or another one of `crowdbench.simulation.observations`.
    - Action: velocity in units of the scene's maximum speed, Box(−1, 1, (2,)), in the frame of the
      observation: the world frame, or with `social-1` the own frame. Values out of range are
      clipped. NaN, infinity, or missing or unknown agents raise an `ActionError`.
    - Reward: see `crowdbench.simulation.reward.Reward`. `infos` contain its parts as
      `reward_parts`, in the order of `reward.PARTS`, or those of a reward of one's own.
    - `state()`: everyone's state for a centralised critic, see `crowdbench.envs.global_state`.
    - Rendering: with `render_mode="rgb_array"`, `render` returns an image. With `"human"`, a rerun
      viewer shows each frame. Rendering does not affect the simulation.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "crowdbench",
        "render_modes": list(RENDER_MODES),
        "render_fps": FPS,
        "is_parallelizable": True,
    }

    @checked("crowdbench.viewer.renderer:RenderMode")
    def __init__(
        self,
        scene: str | Path | Scene,
        config: EnvConfig | None = None,
        *,
        max_persons: int | None = None,
        render_mode: "RenderMode | None" = None,
        **settings: Unpack[EnvSettings],
    ) -> None:
        """Create the environment.

        Args:
            scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
            config: the settings, by default those of `EnvConfig()`.
            max_persons: maximum number of people in an episode and its warm-up, and the length of
                `possible_agents`; default: twice the size of a sample of the spawn model, plus 100.
            render_mode: `rgb_array` for images from `render`, or `human` for a live rerun viewer
                (needs the extra `viewer`). If your program logs to rerun, the crowd is added to its
                recording stream.
            settings: fields of `EnvConfig`, which replace those of `config`.

        Raises:
            SceneError, SettingError, WeightsError, RecordingError: a scene, model, file or
                recording does not exist or does not fit.
        """
        config = EnvConfig.of(type(self), config, **settings)
        if render_mode not in (None, *RENDER_MODES):
            raise SettingError(
                "render_mode", got=repr(render_mode), expected="None, 'human' or 'rgb_array'"
            )
        self.render_mode = render_mode
        self._crowd = EnvCrowd(scene, config, max_persons=max_persons)
        self.scene, self.spawn = self._crowd.scene, self._crowd.spawn
        self.frames, self._simulation = self._crowd.frames, self._crowd.simulation
        self._seeds = Seeds()
        sizes = self._simulation.settings
        self.possible_agents = [f"person_{k}" for k in range(sizes.max_persons)]
        self.agents: list[str] = []
        self._there = np.empty(0, np.int64)  # slots of `agents`
        self._actions = np.zeros((1, sizes.max_alive, 2), np.float32)
        size = self._simulation.observation.shape[-1]
        self._observation_space = spaces.Box(-1.0, 1.0, (size,), np.float32)
        self._action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.state_space = spaces.Box(-1.0, 1.0, (sizes.max_alive, STATE_SIZE), np.float32)
        self._recorder: Recorder | None = None
        self._seed = 0
        self._renderer: Renderer | None = None
        if render_mode is not None:
            from crowdbench.viewer import renderer

            title = f"{self.spawn.name} × environment"
            self._renderer = renderer.Renderer(self.scene, render_mode, title)

    def observation_space(self, agent: str) -> spaces.Box:
        """Observation space, the same for each agent."""
        return self._observation_space

    def action_space(self, agent: str) -> spaces.Box:
        """Action space, the same for each agent."""
        return self._action_space

    def state(self) -> np.ndarray:
        """State of everyone present by slot, (max_alive, 9); see `envs.global_state`."""
        state: np.ndarray = global_state(self._simulation)[0]
        return state

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin an episode; return observations and infos by agent.

        The same seed gives the same arrivals. `options` are ignored.

        Raises:
            CapacityError: there are more people than slots or ids, unless `on_full` is `drop`.
            SettingError: `seed` is no integer from 0.
        """
        if seed is not None:
            self._seeds = Seeds(seed)
        self._seed = self._seeds.draw()
        simulation = self._simulation
        self._crowd.begin(self._seed)
        self._recorder = Recorder(simulation)
        self._recorder.write()
        if self._renderer is not None:
            self._renderer.begin(self._recorder)
        skipped = self._skip_empty()
        self._crowd.check_capacity()
        self._there = simulation.slots.alive[0].nonzero()[0]
        self.agents = self._names(self._there)
        observations = simulation.observe()[0, self._there]
        return dict(zip(self.agents, observations, strict=True)), self._infos(self.agents, skipped)

    def step(
        self, actions: Mapping[str, np.ndarray]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Advance by one frame and, if nobody is present then, to the next arrival.

        Returns observations, rewards, terminations, truncations and infos by agent.

        Raises:
            ActionError: the episode has not begun or is over, or actions do not match `agents`.
            CapacityError: there are more people than slots or ids, unless `on_full` is `drop`.
        """
        simulation, slots = self._simulation, self._simulation.slots
        acted, acting = self._there, self.agents
        commands = self._actions  # rows of empty slots are not read
        commands[0][acted] = _commands_of(actions, self.agents)
        simulation.step(commands)
        self._record()
        frame = int(simulation.clock.frame[0])
        observations = dict(zip(acting, simulation.observe()[0].take(acted, axis=0), strict=True))
        parts = self._crowd.reward_parts()[0].take(acted, axis=0)
        rewards = dict(zip(acting, total(parts).tolist(), strict=True))
        terminations = dict.fromkeys(acting, False)
        truncations = dict.fromkeys(acting, False)
        infos: dict[str, dict[str, Any]] = {
            name: {"frame": frame, "frames_skipped": 0, "reward_parts": of_name}
            for name, of_name in zip(acting, parts.tolist(), strict=True)
        }
        if simulation.clock.changed[0]:
            ended = slots.ended[0, acted]
            for k in ended.nonzero()[0].tolist():
                name, how = acting[k], int(ended[k])
                terminations[name] = how in TERMINAL
                truncations[name] = how not in TERMINAL
                infos[name]["outcome"] = OUTCOMES[how]
            skipped = self._skip_empty()
            born = (slots.alive[0] if skipped else slots.spawned[0]).nonzero()[0]
            if skipped:
                simulation.observe()
            names = self._names(born)
            observations.update(zip(names, simulation.observation[0, born], strict=True))
            rewards.update(dict.fromkeys(names, 0.0))
            terminations.update(dict.fromkeys(names, False))
            truncations.update(dict.fromkeys(names, False))
            infos.update(self._infos(names, skipped))
            self._there = slots.alive[0].nonzero()[0]
            self.agents = self._names(self._there)
            self._crowd.check_capacity()
        return observations, rewards, terminations, truncations, infos

    def trajectories(self) -> Trajectories:
        """The trajectories of the episode so far.

        Raises:
            ActionError: `reset` has not been called.
            RecordingError: nobody has entered.
        """
        return self._recorded("trajectories").trajectories(
            {"spawn": self.spawn.name, "policy": "environment", "seed": self._seed}
        )

    @property
    def dropped(self) -> int:
        """Number of people who could not enter in this episode for lack of slots or ids."""
        return self._crowd.dropped

    def render(self) -> UInt8[np.ndarray, "h w 3"] | None:
        """The current frame as an RGB image if `render_mode` is `rgb_array`, else None.

        With `human`, `reset` and `step` already send each frame to the viewer.

        Raises:
            ActionError: `reset` has not been called.
        """
        if self._renderer is None:
            logger.warn("render draws nothing: the environment was created without a render_mode.")
            return None
        return self._renderer.picture(self._recorded("render"))

    def close(self) -> None:
        """Send the remaining frames to the viewer, if there is one. The viewer stays open."""
        if self._renderer is not None:
            self._renderer.close()

    def _skip_empty(self) -> int:
        """Continue to the next arrival or horizon if nobody is there; return the frames skipped."""
        simulation = self._simulation
        slots, clock = simulation.slots, simulation.clock
        first = int(clock.frame[0])
        nobody = np.zeros(slots.position.shape, np.float32)
        while not slots.alive[0].any() and clock.frame[0] < self.frames:
            due = simulation.next_due()
            simulation.skip_to(self.frames if due is None else min(due, self.frames))
            simulation.step(nobody)
        skipped = int(clock.frame[0]) - first
        if skipped:
            self._record(skipped)
        return skipped

    def _record(self, skipped: int = 0) -> None:
        recorder = self._recorded("step")
        recorder.write()
        if self._renderer is not None:
            self._renderer.go_on(recorder, skipped)

    def _recorded(self, where: str) -> Recorder:
        if self._recorder is None:
            raise ActionError(where, got="no episode", expected="a call of reset first")
        return self._recorder

    def _names(self, slots: np.ndarray) -> list[str]:
        return [self.possible_agents[k] for k in self._simulation.slots.person[0, slots].tolist()]

    def _infos(self, names: list[str], skipped: int) -> dict[str, dict[str, Any]]:
        frame = int(self._simulation.clock.frame[0])
        return {name: {"frame": frame, "frames_skipped": skipped} for name in names}


def _commands_of(actions: Mapping[str, np.ndarray], agents: Sequence[str]) -> np.ndarray:
    """Velocity commands of shape (A, 2) in [−1, 1], in the order of `agents`."""
    if not agents:
        raise ActionError(
            "step", got="no agents", expected="a call of reset first",
            hint="The episode is over or has not begun.",
        )  # fmt: skip
    try:
        given = [actions[name] for name in agents]
    except KeyError:
        given = []
    except (TypeError, IndexError) as error:
        got = f"actions of type {type(actions).__name__}"
        expected = "a dictionary from the names in env.agents to arrays of shape (2,)"
        raise ActionError("step", got=got, expected=expected) from error
    if not given or len(actions) != len(given):
        missing = [name for name in agents if name not in actions]
        unknown = sorted(set(actions) - set(agents))
        got = f"missing actions for {missing[:3]}, actions for unknown agents {unknown[:3]}"
        expected = f"one action for each of the {len(agents)} agents"
        hint = "Pass one action for each name in env.agents."
        raise ActionError("step", got=got, expected=expected, hint=hint)
    try:
        commands = np.array(given)
    except ValueError:  # rows of different shapes
        commands = np.array(None)
    if commands.dtype.kind not in "fiu" or commands.shape != (len(agents), 2):
        raise ActionError(
            "step",
            got=f"actions of shape {commands.shape[1:]}"
            if commands.dtype.kind in "fiu"
            else "actions that are not pairs of numbers",
            expected="arrays of shape (2,): a velocity in units of the maximum speed",
        )
    if not np.isfinite(commands).all():
        name = agents[int(np.flatnonzero(~np.isfinite(commands).all(axis=1))[0])]
        raise ActionError(
            "step", got=f"{actions[name]} from {name}", expected="finite numbers",
            hint="Check the policy for a division by zero or a diverged network.",
        )  # fmt: skip
    if commands.dtype != np.float32:
        commands = commands.clip(-1, 1)  # before the conversion to float32, which may overflow
    return commands


parallel_env = CrowdParallelEnv
"""The name by which PettingZoo's users create a parallel environment."""


@checked("crowdbench.viewer.renderer:RenderMode")
def aec_env(
    scene: str | Path | Scene,
    config: EnvConfig | None = None,
    *,
    max_persons: int | None = None,
    render_mode: "RenderMode | None" = None,
    **settings: Unpack[EnvSettings],
) -> AECEnv:
    """The same environment as an `AECEnv`, in which agents act one after the other.

    The crowd advances by a frame when everybody present has acted. Arguments and errors are those
    of `parallel_env`.
    """
    return parallel_to_aec(
        CrowdParallelEnv(
            scene, config, max_persons=max_persons, render_mode=render_mode, **settings
        )
    )
