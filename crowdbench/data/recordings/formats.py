"""Users' own recordings in files of several formats."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crowdbench.data import storage
from crowdbench.data.companions import with_companions
from crowdbench.data.recordings import gc
from crowdbench.data.recordings.catalogue import hash_of
from crowdbench.data.recordings.forum import FPS as FORUM_FPS
from crowdbench.data.recordings.forum import PIXEL_M, read_forum
from crowdbench.data.recordings.jupedsim import parse_jupedsim, write_jupedsim
from crowdbench.data.recordings.mending import Gaps, Stamped, on_frames
from crowdbench.data.recordings.obsmat import parse_obsmat, step_by_speed_s
from crowdbench.data.recordings.pixels import parse_sdd, parse_vsp
from crowdbench.data.recordings.placing import check_placing, placed, resampled
from crowdbench.data.recordings.plausible import check_lives, check_motion
from crowdbench.data.recordings.simulators import BY_PEDPY, parse_fcd, read_by_pedpy
from crowdbench.data.recordings.text_rows import FRAME_PED_XY, parse_frame_ped_xy
from crowdbench.data.recordings.timing import LONGEST_DT_S, at_scene_frames, checked_dt_s
from crowdbench.data.recordings.trajnet import parse_trajnet, write_trajnet
from crowdbench.data.table import Trajectories
from crowdbench.errors import OwnCodeError, RecordingError, SettingError, hinting
from crowdbench.files import read_bytes
from crowdbench.plugins import blaming, find

FORMATS = {
    "obsmat": "rows `frame person x z y vx vz vy`, in metres, each person in every n-th frame",
    "gc": "a folder with H.json and Annotation/NUMBER.txt for each person (six digits), in pixels",
    "forum": "Matlab code, `TRACK.Rn=[[x y t];…];`, in pixels of a camera of 640 × 480",
    "csv": "a table (.csv or .parquet): person_id, frame (from 0, one per --dt-s) or time_s, x, y",
    "trajnet": 'TrajNet++, lines like {"track": {"f": 10, "p": 3, "x": 1.25, "y": 4.5}}',
    "jupedsim": "`# framerate: 16.00` and rows `id frame x y z`, or JuPedSim's SQLite",
    FRAME_PED_XY: "rows `frame person x y`, as in TrajNet and Social GAN",
    "vsp": "UCY's splines of control points, in pixels",
    "sdd": "annotations.txt of the Stanford Drone Dataset: boxes in pixels",
    "sumo": "XML of SUMO's --fcd-output: <timestep time> with <person id x y>",
    "vadere": "Vadere's .traj, read by PedPy",
    "hdf5": "HDF5 of the pedestrian data archive, read by PedPy",
    "viswalk": "Viswalk's .pp, read by PedPy",
    "pathfinder": "Pathfinder's CSV or JSON, read by PedPy",
    "crowdit": "crowd:it's CSV, read by PedPy",
}
"""The formats of recordings, each with a short description."""

WRITERS: dict[str, Callable[[Trajectories, Path], None]] = {
    "csv": storage.write_csv,
    "trajnet": write_trajnet,
    "jupedsim": write_jupedsim,
}
"""The formats that a crowd can be written in, and what writes it."""

_METRES = {
    "gc": f"by H.json × {gc.UNIT_M} m, as for Grand Central",
    "forum": f"{1000 * PIXEL_M:.1f} mm per pixel, as for the Edinburgh Forum",
}
"""How pixels are converted to metres, as a note that the user can check."""
_PARSERS: dict[str, Callable[[bytes, object], tuple[Stamped, float | None]]] = {
    "trajnet": parse_trajnet,
    "jupedsim": parse_jupedsim,
    FRAME_PED_XY: parse_frame_ped_xy,
    "vsp": parse_vsp,
    "sdd": parse_sdd,
    "sumo": parse_fcd,
}
_IN_PIXELS = ("vsp", "sdd")


@dataclass(frozen=True)
class _Asked:
    path: Path
    layout: str
    name: str
    dt_s: float | None
    gaps: Gaps | None
    offset_s: float | None
    scale: float | None = None
    homography: Path | None = None
    every_s: float | None = None


class _Found(NamedTuple):
    """A crowd in a file, at its own interval."""

    crowd: Trajectories
    files: Mapping[str, bytes]
    """The files that were read."""
    ours: bool = False
    """Whether crowdbench wrote it."""
    states_units: bool = False
    """Whether the file states its rate, and that positions are in metres."""


def read_recording(
    path: Path,
    layout: str,
    *,
    name: str,
    dt_s: float | None = None,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
    scale: float | None = None,
    homography: Path | None = None,
    resample: float | None = None,
    at_frames: bool = True,
) -> Trajectories:
    """Read a recording in one of `FORMATS` and convert it to the frames of a scene.

    `dt_s` is the time between consecutive rows of a person in seconds; if the file states it, the
    two must agree. `gaps` says how missing rows, and rows between two frames, are repaired (see
    `mending`). `offset_s` is the time of the first frame for tables with a column `time_s`. The
    repairs are listed in the notes of the provenance. Positions are multiplied by `scale`, or
    mapped by the matrix in the file `homography`. With `resample`, rows at any times are
    interpolated to frames of so many seconds. Without `at_frames`, rows and frames are those of the
    file; otherwise they are those of a scene, unless crowdbench wrote the table.

    Raises:
        SettingError: the format does not exist, or does not support one of the options.
        RecordingError: the file is missing or broken, states another time step, or needs repairs
            while `gaps` is None; or, with `at_frames`, speeds or distances are implausible, or all
            persons have as many rows, so that they are fragments.
    """
    asked = _Asked(path, layout, name, dt_s, gaps, offset_s, scale, homography, resample)
    found = (_read if layout in FORMATS else _read_by_others)(asked)
    crowd, files = found.crowd, found.files
    notes = dict(crowd.provenance.get("notes", {}))
    if layout in _METRES:
        notes["metres"] = _METRES[layout]
    provenance = {"source": path.name, "sha256": hash_of(files), "notes": notes}
    crowd = replace(crowd, provenance=provenance)
    if not at_frames:
        return crowd
    check_lives(crowd, path)
    if not found.ours:
        # Only human annotators pause. Automatic tracking does not, but it often loses people
        # mid-scene, which would look like a pause.
        crowd = at_scene_frames(crowd, pauses=layout not in ("gc", "forum"), where=path)
    if warning := check_motion(crowd, path, may_jam=found.states_units):
        notes = {**crowd.provenance["notes"], "speed warning": warning}
        crowd = replace(crowd, provenance={**crowd.provenance, "notes": notes})
    crowd = replace(crowd, scene=name)
    return crowd if (crowd.group >= 0).any() else with_companions(crowd)


def _read(asked: _Asked) -> _Found:
    path, layout, name, dt_s = asked.path, asked.layout, asked.name, asked.dt_s
    _check_options(asked)
    hint = f"The format {layout}: {FORMATS[layout]}."
    if layout == "gc":
        files = gc.files_in(path, hint)
        with hinting(hint):
            checked_dt_s(path, gc.STEP / gc.FPS, dt_s)
            return _Found(gc.read_gc(files, path, name=name, video_frames=None), files)
    data = read_bytes(path, RecordingError, hint)
    files = {path.name: data}
    with hinting(hint):
        if layout == "csv":
            crowd, ours = _table(asked)
            return _Found(crowd, files, ours)
        if layout == "forum":
            checked_dt_s(path, 1 / FORUM_FPS, dt_s)
            return _Found(read_forum(data, name=name, where=path), files)
        if layout == "obsmat":
            return _Found(_obsmat(data, asked), files)
        parse = (lambda *_: read_by_pedpy(path, layout)) if layout in BY_PEDPY else _PARSERS[layout]
        rows, stated_s = parse(data, path)
        if layout in _IN_PIXELS and (asked.scale, asked.homography) == (None, None):
            expected = "--scale METRES_PER_PIXEL or --homography FILE"
            raise RecordingError(path, got="positions in pixels", expected=expected)
        states_units = stated_s is not None and layout not in _IN_PIXELS
        return _Found(_crowd(rows, stated_s, asked), files, states_units=states_units)


def _read_by_others(asked: _Asked) -> _Found:
    """Read a format that another package registered, by its function `read(path, name=, dt_s=)`."""
    path, layout = asked.path, asked.layout
    read = find("recordings", layout, FORMATS)
    _check_options(asked)
    with blaming(f"format {layout}, {path}"):
        crowd = read(path, name=asked.name, dt_s=asked.dt_s)
    if not isinstance(crowd, Trajectories):
        raise OwnCodeError(f"format {layout}", got=repr(crowd)[:200], expected="Trajectories")
    files = (file for file in (path, *sorted(path.rglob("*"))) if file.is_file())
    data = {str(file.relative_to(path.parent)): file.read_bytes() for file in files}
    return _Found(crowd, data)


def _check_options(asked: _Asked) -> None:
    gaps, offset_s, layout = asked.gaps, asked.offset_s, asked.layout
    mendable = [name for name in FORMATS if name not in ("gc", "forum")]
    if gaps is not None and layout not in mendable:
        got = f"{gaps} with the format {layout}"
        expected = f"one of the formats {', '.join(mendable)}"
        hint = "In the formats gc and forum, missing rows are always interpolated linearly."
        raise SettingError("--gaps", got=got, expected=expected, hint=hint)
    placing = {"--scale": asked.scale, "--homography": asked.homography}
    placing |= {"--resample": asked.every_s}
    given = [option for option, value in placing.items() if value is not None]
    if given and layout not in mendable:
        got = f"{given[0]} with the format {layout}"
        expected = f"one of the formats {', '.join(mendable)}"
        raise SettingError(given[0], got=got, expected=expected)
    check_placing(asked.scale, asked.homography)
    if asked.every_s is not None:
        if not 0 < asked.every_s <= LONGEST_DT_S:
            expected = f"an interval of more than 0 and at most {LONGEST_DT_S:g} s"
            raise SettingError("--resample", got=f"{asked.every_s}", expected=expected)
        for option, value in (("--gaps", gaps), ("--offset-s", offset_s)):
            if value is not None:
                raise SettingError(
                    option,
                    got=f"{value} with --resample",
                    expected="one of the two",
                    hint="With --resample, frames begin at the first row, and gaps of up to 2 s "
                    "are interpolated; longer ones split a person.",
                )
    if offset_s is not None and layout != "csv":
        got = f"the format {layout}, whose frames are numbered"
        raise SettingError("--offset-s", got=got, expected="the format csv with a column time_s")
    if offset_s is not None and not np.isfinite(offset_s):
        raise SettingError("--offset-s", got=f"{offset_s}", expected="a finite number of seconds")


def _table(asked: _Asked) -> tuple[Trajectories, bool]:
    path, offset_s = asked.path, asked.offset_s
    table = storage.read_table(path)
    ours = storage.own_metadata(table, path) is not None
    if offset_s is not None and (ours or "time_s" not in table.column_names):
        got = f"{path.name}, which crowdbench wrote or which has no column time_s"
        expected = "a table of another program with that column"
        raise SettingError("--offset-s", got=got, expected=expected)
    if ours:
        given = [asked.scale, asked.homography, asked.every_s]
        if any(value is not None for value in given):
            expected = "none of --scale, --homography and --resample"
            got = "one for a table that crowdbench wrote"
            raise SettingError(path.name, got=got, expected=expected)
        crowd = storage.of_table(table, path)
        checked_dt_s(path, crowd.dt_s, asked.dt_s)
        return crowd, True
    columns = storage.columns_of(table, path)
    if asked.every_s is not None and "time_s" in columns:
        at = np.stack([columns["x"], columns["y"]], axis=1).astype(np.float64)
        stamped = Stamped(columns["person_id"], columns["time_s"], at, "s", asked.every_s)
        if asked.dt_s is not None:
            got = f"{asked.dt_s:g} with --resample and a column time_s"
            raise SettingError("--dt-s", got=got, expected="--resample alone")
        return _resampled(stamped, 1.0, asked, columns), False
    dt_s = checked_dt_s(path, None, asked.dt_s)
    stamped = _stamped(columns, dt_s, asked)
    if asked.every_s is not None:
        return _resampled(stamped, dt_s / stamped.step, asked, columns), False
    stamped = placed(stamped, asked.scale, asked.homography)
    rows = on_frames(stamped, gaps=asked.gaps, dt_s=dt_s, where=path)
    if stamped.step != 1 and stamped.unit == "frame":
        rows.notes["frames"] = f"every {stamped.step:g}th has rows"
    if offset_s:
        rows.notes["times"] = f"reduced by {offset_s:g} s"
        for column in {"spawn_s", "requested_s"} & set(columns):
            columns[column] = columns[column] - offset_s
    return rows.crowd(scene=asked.name, dt_s=dt_s, where=path, columns=columns), False


def _stamped(columns: Mapping[str, np.ndarray], dt_s: float, asked: _Asked) -> Stamped:
    """Rows of a table with their `frame` or `time_s`; if both columns exist, they must agree."""
    person, frame, offset_s = columns["person_id"], columns.get("frame"), asked.offset_s
    xy = np.stack([columns["x"], columns["y"]], axis=1).astype(np.float64)
    if "time_s" not in columns:
        return Stamped.of_frames(person, columns["frame"], xy)
    rows = Stamped(person, columns["time_s"], xy, "s", step=dt_s, origin=offset_s or 0.0)
    if frame is not None:
        _check_agree(rows, frame, asked.path)
    ticks = rows.ticks()
    if offset_s is not None and ticks.min() < -0.05:
        got = rows.named(int(ticks.argmin()))
        expected = f"times of at least {offset_s:g} s, as set by --offset-s"
        hint = "--offset-s must not be later than the first row."
        raise RecordingError(asked.path, got=got, expected=expected, hint=hint)
    return rows


def _check_agree(rows: Stamped, frame: np.ndarray, path: Path) -> None:
    """Raise if the columns `frame` and `time_s` of a table contradict each other."""
    late = rows.ticks() - frame
    wrong = ~(np.abs(late) < 0.05)
    if not wrong.any():
        return
    row = int(wrong.argmax())
    usual = float(np.median(late))
    constant = (np.abs(late - usual) < 0.05).mean() > 0.5 and abs(usual) >= 0.05
    raise RecordingError(
        path,
        got=f"{rows.named(row, f'in frame {frame[row]} at')} ({wrong.sum()} of {len(wrong)} rows "
        "whose time does not match their frame)",
        expected=f"time_s equal to frame × {rows.step:g} s",
        hint=f"Use --offset-s {usual * rows.step + rows.origin:.4g} to start frame 0 at that time."
        if constant
        else "Remove the wrong column; the other one is sufficient.",
    )


def _obsmat(data: bytes, asked: _Asked) -> Trajectories:
    path = asked.path
    rows, velocity = parse_obsmat(data, path)
    dt_s = checked_dt_s(path, None, asked.dt_s)
    by_speed_s = step_by_speed_s(rows, velocity)
    if by_speed_s is not None and not np.isclose(by_speed_s, dt_s, rtol=0.1):
        got = f"rows {by_speed_s:.2f} s apart according to their positions and velocities"
        expected = f"rows {dt_s:g} s apart, as set by --dt-s"
        hint = "Correct --dt-s, or set the velocities to zero if they are wrong."
        raise RecordingError(path, got=got, expected=expected, hint=hint)
    return _crowd(rows, None, asked)


def _crowd(rows: Stamped, stated_s: float | None, asked: _Asked) -> Trajectories:
    """The crowd of rows in a file that states so many seconds from row to row, or nothing."""
    dt_s = checked_dt_s(asked.path, stated_s, asked.dt_s)
    if asked.every_s is not None:
        return _resampled(rows, dt_s / rows.step, asked)
    rows = placed(rows, asked.scale, asked.homography)
    whole = on_frames(rows, gaps=asked.gaps, dt_s=dt_s, where=asked.path)
    return whole.crowd(scene=asked.name, dt_s=dt_s, where=asked.path)


def _resampled(
    rows: Stamped, unit_s: float, asked: _Asked, columns: Mapping[str, np.ndarray] | None = None
) -> Trajectories:
    """The crowd at frames of `--resample`; `unit_s` is the time that 1 in the stamps stands for.

    `columns` are those of a table; times of entry in them count from the first row, too.
    """
    assert asked.every_s is not None
    in_s = replace(rows, values=rows.values * unit_s, unit="s", step=asked.every_s, origin=0.0)
    at = placed(in_s, asked.scale, asked.homography)
    whole = resampled(at, asked.every_s, asked.path)
    of_rows = dict(columns or {})
    for column in {"spawn_s", "requested_s"} & set(of_rows):
        of_rows[column] = of_rows[column] - in_s.values.min()
    return whole.crowd(scene=asked.name, dt_s=asked.every_s, where=asked.path, columns=of_rows)
