"""Rendering of an environment, according to its `render_mode`."""

from collections import deque
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Int, UInt8

from crowdbench.errors import ActionError
from crowdbench.run.episode import Recorder
from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.viewer.access import check_rerun
from crowdbench.viewer.picture import Now, Pictures, trail_steps

if TYPE_CHECKING:
    from crowdbench.viewer.live import Live

RenderMode = Literal["human", "rgb_array"]


class Renderer:
    """Shows an environment while it is stepped; it only reads the environment's recorder."""

    def __init__(self, scene: Scene, mode: RenderMode, title: str) -> None:
        """Prepare rendering; the viewer opens with the first episode.

        Raises:
            SettingError: the mode is `human` and rerun is not installed.
        """
        if mode == "human":
            check_rerun()
        self._scene, self._mode, self._title = scene, mode, title
        self._live: Live | None = None
        self._pictures: Pictures | None = None

    def begin(self, recorder: Recorder) -> None:
        """Show the first frame of an episode, if the mode is `human`.

        Raises:
            SettingError: there is no screen.
        """
        if self._mode == "human":
            from crowdbench.viewer.live import Live

            if self._live is None:
                self._live = Live(self._scene, self._title)
            self._live.begin()
            self._live.log(_now(recorder))

    def go_on(self, recorder: Recorder, skipped: int = 0) -> None:
        """Show the next frame, if the mode is `human`; `skipped` frames before it were empty."""
        if self._live is not None:
            self._live.log(_now(recorder), skipped)

    def picture(self, recorder: Recorder) -> UInt8[np.ndarray, "h w 3"] | None:
        """The present frame as pixels, if the mode is `rgb_array`; else None."""
        if self._mode != "rgb_array":
            return None
        if self._pictures is None:
            self._pictures = Pictures(self._scene)
        return self._pictures.draw(_now(recorder))

    def close(self) -> None:
        """Send all remaining data to the viewer, which stays open."""
        if self._live is not None:
            self._live.close()


def _now(recorder: Recorder) -> Now:
    steps = trail_steps(recorder.simulation.scene.dt_s)
    return Now.of(recorder.simulation, recorder.latest(steps + 1))


class Camera:
    """Takes pictures of the first world of a simulation that others step."""

    def __init__(self, simulation: Simulation) -> None:
        """A camera that has seen nothing yet."""
        self._simulation = simulation
        self._pictures: Pictures | None = None
        steps = trail_steps(simulation.scene.dt_s)
        self._past: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=steps + 1)
        self._episode = -1

    def follow(self) -> None:
        """See where people are, for their trails; called in each frame."""
        episode, slots = int(self._simulation.episode[0]), self._simulation.slots
        if episode != self._episode:
            self._past.clear()
            self._episode = episode
        there = np.flatnonzero(slots.alive[0] | (slots.ended[0] != 0))
        self._past.append((slots.person[0, there], slots.position[0, there]))

    def picture(self, ringed: Int[np.ndarray, " _"] | None = None) -> UInt8[np.ndarray, "h w 3"]:
        """The present frame as pixels, with a ring around people with these ids.

        Raises:
            ActionError: nothing has been seen yet.
        """
        if not self._past:
            raise ActionError("render", got="no episode", expected="a call of reset first")
        if self._pictures is None:
            self._pictures = Pictures(self._simulation.scene)
        chosen = [] if ringed is None else ringed.tolist()
        return self._pictures.draw(Now.of(self._simulation, self._past), chosen)
