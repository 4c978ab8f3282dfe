"""Logs a finished crowd: to the viewer, or as the bytes of a file for it."""

from collections.abc import Mapping
from contextlib import suppress

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crowdbench.data.table import Trajectories
from crowdbench.scene import Scene
from crowdbench.viewer.chosen import index_of, log_chosen
from crowdbench.viewer.crowd import WINDOW, log_counts, log_crowd, log_outcomes, log_place
from crowdbench.viewer.layout import layout, new_stream, open_stream
from crowdbench.viewer.place import SIMULATION


def packed(
    crowd: Trajectories, scene: Scene, against: Trajectories | None, person: int | None
) -> bytes:
    """The content of a file that `rerun FILE.rrd` opens; arguments as for `viewer.save`.

    Raises:
        SettingError: no person has this id.
    """
    chosen = None if person is None else index_of(person, crowd)
    sides = _sides(crowd, scene, against)
    stream = new_stream(scene, title_of(crowd))
    # Kept in memory, because on a full disk rerun's own writer never returns.
    kept = rr.binary_stream(stream)
    stream.send_blueprint(_layout(scene, sides), make_active=False)
    _log(stream, scene, sides, chosen)
    return kept.read() or b""


def show(
    crowd: Trajectories, scene: Scene, against: Trajectories | None, person: int | None
) -> None:
    """Show a crowd in the viewer; arguments and errors as for `viewer.show`."""
    chosen = None if person is None else index_of(person, crowd)
    sides = _sides(crowd, scene, against)
    stream = open_stream(scene, title_of(crowd), _layout(scene, sides))
    _log(stream, scene, sides, chosen)
    with suppress(RuntimeError):  # the window was closed
        stream.flush()
    stream.disconnect()


def title_of(crowd: Trajectories) -> str:
    """Title of a crowd: its models and seed, or its file or scene."""
    told = crowd.provenance
    if {"spawn", "policy", "seed"} <= told.keys():
        return f"{told['spawn']} × {told['policy']}, seed {told['seed']}"
    return str(told.get("file", crowd.scene))


def _sides(
    crowd: Trajectories, scene: Scene, against: Trajectories | None
) -> dict[str, Trajectories]:
    sides = {SIMULATION: crowd}
    if against is not None:
        sides["recording" if against.scene == scene.recording.name else "against"] = against
    return sides


def _layout(scene: Scene, sides: Mapping[str, Trajectories]) -> rrb.Blueprint:
    crowds = sides.values()
    spawns = [np.bincount(c.first[c.entered] // WINDOW).max(initial=1) for c in crowds]
    most = {
        "agents": max(1.0, *(float(c.present().max()) for c in crowds)),
        "spawns": float(max(spawns)),
    }
    titles = {side: f"{side}: {title_of(c)}" for side, c in sides.items()}
    return layout(scene, titles, live=False, most=most)


def _log(
    stream: rr.RecordingStream, scene: Scene, sides: Mapping[str, Trajectories], chosen: int | None
) -> None:
    log_place(stream, scene)
    for side, crowd in sides.items():
        log_counts(stream, side, crowd)
        log_crowd(stream, side, crowd, scene)
    log_outcomes(stream, sides[SIMULATION])
    if chosen is not None:
        log_chosen(stream, sides[SIMULATION], scene, chosen)
