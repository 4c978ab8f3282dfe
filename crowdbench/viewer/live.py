"""Shows an environment in the viewer, frame by frame, while it is stepped."""

from contextlib import suppress

import numpy as np
import rerun as rr

from crowdbench.scene import Scene
from crowdbench.viewer.crowd import WINDOW, class_of, ending, ids, log_looks, log_place
from crowdbench.viewer.layout import layout, open_stream
from crowdbench.viewer.picture import Now
from crowdbench.viewer.place import SIMULATION, WORLD


class Live:
    """Logs to the user's recording stream if there is one, else to a viewer that it opens.

    Episodes follow each other on one time line.
    """

    def __init__(self, scene: Scene, title: str) -> None:
        """Open the viewer and log the scene.

        Raises:
            SettingError: there is no recording stream, and the viewer cannot open.
        """
        self._scene = scene
        self._begun = 0  # frame of the time line in which the episode began
        self._until = 0
        self._window, self._spawned = 0, 0
        given = rr.get_data_recording()
        first_look = layout(scene, {SIMULATION: title}, live=True, most={})
        if given is not None:
            self._stream = given
            given.send_blueprint(first_look, make_active=False)
        else:
            self._stream = open_stream(scene, title, first_look)
        log_place(self._stream, scene)
        log_looks(self._stream, SIMULATION, scene)
        dot = rr.Points2D.from_fields(radii=rr.Radius.ui_points(2.0), show_labels=False)
        self._stream.log(f"{WORLD}/{SIMULATION}/goals", dot, static=True)

    def begin(self) -> None:
        """Begin an episode, after the frames that were logged before."""
        self._log_spawns(self._until)
        self._begun = self._until

    def log(self, now: Now, skipped: int = 0) -> None:
        """Log a frame; in the `skipped` frames before it, nobody was present."""
        frame = self._begun + now.frame
        if skipped:
            self._at(frame - skipped + 1)
            self._log_people(None)
        self._log_spawns(frame)
        if now.frame > 0:  # the initial population does not count as spawns
            self._spawned += int(now.spawned.sum())
        self._until = frame + 1
        self._at(frame)
        self._log_people(now)
        for k in np.flatnonzero(now.ended).tolist():
            from_s, to_s = (f * self._scene.dt_s for f in (self._begun + int(now.born[k]), frame))
            text, level = ending(int(now.person_id[k]), int(now.ended[k]), from_s, to_s)
            self._stream.log("outcomes", rr.TextLog(text, level=level))

    def close(self) -> None:
        """Send all remaining data; the viewer stays open."""
        with suppress(RuntimeError):  # the window was closed
            self._stream.flush()

    def _log_people(self, now: Now | None) -> None:
        stream, where = self._stream, f"{WORLD}/{SIMULATION}"
        there = 0 if now is None else len(now.xy)
        stream.log(f"agents/{SIMULATION}", rr.Scalars(float(there)))
        if now is None:
            for name in ("people", "trails", "goals"):
                stream.log(f"{where}/{name}", rr.Clear(recursive=False))
            return
        goal = class_of(now.goal_area)
        # Only the given fields are updated; others keep their static values.
        stream.log(
            f"{where}/people",
            rr.Points2D.from_fields(positions=now.xy, class_ids=goal),
            rr.AnyValues(person_id=ids(now.person_id), group=ids(now.group)),
        )
        stream.log(f"{where}/trails", rr.LineStrips2D.from_fields(strips=now.trail, class_ids=goal))
        stream.log(f"{where}/goals", rr.Points2D.from_fields(positions=now.target, class_ids=goal))

    def _log_spawns(self, frame: int) -> None:
        while (self._window + 1) * WINDOW <= frame:
            self._at(self._window * WINDOW)
            self._stream.log(f"spawns/{SIMULATION}", rr.Scalars(float(self._spawned)))
            self._window, self._spawned = self._window + 1, 0

    def _at(self, frame: int) -> None:
        self._stream.set_time("time", duration=frame * self._scene.dt_s)
        self._stream.set_time("frame", sequence=frame)
