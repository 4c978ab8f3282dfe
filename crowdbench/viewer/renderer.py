"""Rendering of an environment, according to its `render_mode`."""

from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import UInt8

from crowdbench.run.episode import Recorder
from crowdbench.scene import Scene
from crowdbench.viewer.access import check_rerun
from crowdbench.viewer.picture import Now, Pictures

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
            self._live.log(Now.of(recorder, self._scene.dt_s))

    def go_on(self, recorder: Recorder, skipped: int = 0) -> None:
        """Show the next frame, if the mode is `human`; `skipped` frames before it were empty."""
        if self._live is not None:
            self._live.log(Now.of(recorder, self._scene.dt_s), skipped)

    def picture(self, recorder: Recorder) -> UInt8[np.ndarray, "h w 3"] | None:
        """The present frame as pixels, if the mode is `rgb_array`; else None."""
        if self._mode != "rgb_array":
            return None
        if self._pictures is None:
            self._pictures = Pictures(self._scene)
        return self._pictures.draw(Now.of(recorder, self._scene.dt_s))

    def close(self) -> None:
        """Send all remaining data to the viewer, which stays open."""
        if self._live is not None:
            self._live.close()
