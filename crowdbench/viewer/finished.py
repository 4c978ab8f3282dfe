"""Shows a finished crowd in the viewer, or writes a file for it."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.data.table import Trajectories
from crowdbench.files import replacing
from crowdbench.scene import Scene, load_scene
from crowdbench.viewer.access import check_rerun, new_stream, open_stream
from crowdbench.viewer.chosen import index_of, log_chosen
from crowdbench.viewer.crowd import WINDOW, log_counts, log_crowd, log_outcomes, log_series
from crowdbench.viewer.layout import layout
from crowdbench.viewer.place import log_place

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

SERIES = ((230, 159, 0), (150, 150, 150))
"""Colours of the lines of the simulation, and of the crowd that it is compared with."""


def save(
    crowd: Trajectories,
    scene: str | Path | Scene,
    path: str | Path,
    *,
    against: Trajectories | None = None,
    person: int | None = None,
) -> None:
    """Write a file that `rerun FILE.rrd` opens. An incomplete file is never left behind.

    Args:
        crowd: the trajectories to show.
        scene: their scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        path: the file, usually with the suffix `.rrd`.
        against: another crowd, usually the recording, shown beside it on the same time line.
        person: id of a person in `crowd` whose rays and complete path are also shown.

    Raises:
        SettingError: rerun is not installed, or no person has this id.
        SceneError: there is no such scene.
        OutputError: the file cannot be written.
    """
    check_rerun()
    import rerun as rr

    place = load_scene(scene)
    if person is not None:
        index_of(person, crowd)
    sides = _sides(crowd, place, against)
    stream = new_stream(place, title_of(crowd))
    # Kept in memory first, because on a full disk rerun's own writer never returns.
    kept = rr.binary_stream(stream)
    stream.send_blueprint(_layout(place, sides), make_active=False)
    _log(stream, place, sides, person)
    data = kept.read() or b""
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(data)


def show(
    crowd: Trajectories,
    scene: str | Path | Scene,
    *,
    against: Trajectories | None = None,
    person: int | None = None,
) -> None:
    """Show a crowd in the viewer that is open, or in a new window; arguments as for `save`.

    Raises:
        SettingError: rerun is not installed, there is no screen, or no person has this id.
        SceneError: there is no such scene.
    """
    place = load_scene(scene)
    if person is not None:
        index_of(person, crowd)
    sides = _sides(crowd, place, against)
    check_rerun()
    stream = open_stream(place, title_of(crowd), _layout(place, sides))
    _log(stream, place, sides, person)
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
    sides = {"simulation": crowd}
    if against is not None:
        sides["recording" if against.scene == scene.recording.name else "against"] = against
    return sides


def _layout(scene: Scene, sides: Mapping[str, Trajectories]) -> "Blueprint":
    crowds = sides.values()
    spawns = [np.bincount(c.first[c.entered] // WINDOW).max(initial=1) for c in crowds]
    most = {
        "agents": max(1.0, *(float(c.present().max()) for c in crowds)),
        "spawns": float(max(spawns)),
    }
    titles = {side: f"{side}: {title_of(c)}" for side, c in sides.items()}
    return layout(scene, titles, live=False, most=most)


def _log(
    stream: "RecordingStream",
    scene: Scene,
    sides: Mapping[str, Trajectories],
    person: int | None,
) -> None:
    log_place(stream, scene)
    for (side, crowd), colour in zip(sides.items(), SERIES, strict=False):
        log_series(stream, side, colour)
        log_counts(stream, side, crowd)
        log_crowd(stream, side, crowd, scene)
    crowd = sides["simulation"]
    log_outcomes(stream, crowd)
    if person is not None:
        log_chosen(stream, "simulation", crowd, scene, person)
