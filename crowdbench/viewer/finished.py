"""A finished crowd in the viewer, or in a file for it."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.files import replacing
from crowdbench.scene import Scene, load_scene
from crowdbench.trajectories.table import Trajectories
from crowdbench.viewer.access import check_rerun, new_stream, open_stream
from crowdbench.viewer.chosen import index_of, log_chosen
from crowdbench.viewer.crowd import WINDOW, log_counts, log_crowd, log_outcomes, log_series
from crowdbench.viewer.layout import layout
from crowdbench.viewer.place import log_place

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

SERIES = ((230, 159, 0), (150, 150, 150))
"""Colours of the simulation's lines, and of those of what it is held against."""


def save(
    crowd: Trajectories,
    scene: str | Path | Scene,
    path: str | Path,
    *,
    against: Trajectories | None = None,
    person: int | None = None,
) -> None:
    """Write a file that `rerun FILE.rrd` opens, whole or not at all.

    Args:
        crowd: what to show.
        scene: where it walks: an id from `list_scenes()`, a folder with a `scene.toml`, or a scene.
        path: the file, by custom `.rrd`.
        against: another crowd, by custom the recording, shown beside it on the same clock.
        person: id of a person in `crowd`, whose rays and whole way are shown too.

    Raises:
        SettingError: rerun is not installed, or there is no such person.
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
    # Kept in memory first: on a full disk rerun's own writer waits for ever.
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
    """Open the viewer, or add to the one that is open; the arguments are those of `save`.

    Raises:
        SettingError: rerun is not installed, there is no screen, or there is no such person.
        SceneError: there is no such scene.
    """
    place = load_scene(scene)
    if person is not None:
        index_of(person, crowd)
    sides = _sides(crowd, place, against)
    check_rerun()
    stream = open_stream(place, title_of(crowd), _layout(place, sides))
    _log(stream, place, sides, person)
    with suppress(RuntimeError):  # who closed the window wants to see no more
        stream.flush()
    stream.disconnect()


def title_of(crowd: Trajectories) -> str:
    """What a crowd is called: by its models and seed, or by its file."""
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
    length_s = max(c.duration_s for c in crowds)
    titles = {side: f"{side}: {title_of(c)}" for side, c in sides.items()}
    return layout(scene, titles, length_s=length_s, most=most)


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
