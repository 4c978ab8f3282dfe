"""Users' own recordings: read from files in several formats, stored by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from crowdbench.data import storage
from crowdbench.data.companions import with_companions
from crowdbench.data.recordings import gc
from crowdbench.data.recordings.catalogue import OWN_NAME, SOURCES, cached, hash_of
from crowdbench.data.recordings.forum import FPS as FORUM_FPS
from crowdbench.data.recordings.forum import PIXEL_M, read_forum
from crowdbench.data.recordings.jupedsim import parse_jupedsim, write_jupedsim
from crowdbench.data.recordings.mending import Gaps, Stamped, on_frames
from crowdbench.data.recordings.obsmat import parse_obsmat, step_by_speed_s
from crowdbench.data.recordings.timing import at_scene_frames, checked_dt_s
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
_SPEEDS_MPS = (0.2, 3.0)
"""Plausible range of the median of people's mean speeds; outside it the units are wrong."""
_LONGEST_M = 300.0


@dataclass(frozen=True)
class _Asked:
    path: Path
    layout: str
    name: str
    dt_s: float | None
    gaps: Gaps | None
    offset_s: float | None


def read_recording(
    path: Path,
    layout: str,
    *,
    name: str,
    dt_s: float | None = None,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
    resample: bool = True,
) -> Trajectories:
    """Read a recording in one of `FORMATS` and convert it to the frames of a scene.

    `dt_s` is the time between consecutive rows of a person in seconds; if the file states it, the
    two must agree. `gaps` says how missing rows, and rows between two frames, are repaired (see
    `mending`). `offset_s` is the time of the first frame for tables with a column `time_s`. The
    repairs are listed in the notes of the provenance. A table that crowdbench wrote is not
    resampled. Without `resample`, rows and frames are those of the file.

    Raises:
        SettingError: the format does not exist, or does not support `gaps` or `offset_s`.
        RecordingError: the file is missing or broken, states another time step, or needs repairs
            while `gaps` is None; or, with `resample`, speeds or distances are implausible.
    """
    asked = _Asked(path, layout, name, dt_s, gaps, offset_s)
    crowd, files, ours = (_read if layout in FORMATS else _read_by_others)(asked)
    notes = dict(crowd.provenance.get("notes", {}))
    if layout in _METRES:
        notes["metres"] = _METRES[layout]
    provenance = {"source": path.name, "sha256": hash_of(files), "notes": notes}
    crowd = replace(crowd, provenance=provenance)
    if not resample:
        return crowd
    if not ours:
        # Only human annotators pause. Automatic tracking does not, but it often loses people
        # mid-scene, which would look like a pause.
        crowd = at_scene_frames(crowd, pauses=layout not in ("gc", "forum"), where=path)
    _check_motion(crowd, path)
    crowd = replace(crowd, scene=name)
    return crowd if (crowd.group >= 0).any() else with_companions(crowd)


def import_own(
    name: str,
    path: Path,
    layout: str,
    dt_s: float | None = None,
    *,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
) -> Trajectories:
    """Read a recording and store it for later use under a name that the user chooses.

    The options are those of `read_recording`. Returns the recording.

    Raises:
        SettingError: the name is taken or invalid, or the format does not exist.
        RecordingError: the file cannot be read; see `read_recording`.
        OutputError: the imported table cannot be written.
    """
    check_name(name)
    crowd = read_recording(path, layout, name=name, dt_s=dt_s, gaps=gaps, offset_s=offset_s)
    keep(crowd)
    return crowd


def check_name(name: str) -> None:
    """Check that a name can be used for a user's own recording.

    Raises:
        SettingError: it is the name of a published recording, or not a valid name.
    """
    if name in (*SOURCES, "plaza") or not OWN_NAME.fullmatch(name):
        raise SettingError(
            "recording",
            got=f"the name {name!r}",
            expected="a new name of lower-case letters, digits and _, beginning with a letter and "
            f"different from {', '.join((*SOURCES, 'plaza'))}",
        )


def keep(crowd: Trajectories) -> bool:
    """Store a recording under its name; returns False if the same table is stored already.

    Raises:
        SettingError: another recording is stored under that name.
        OutputError: the table cannot be written.
    """
    path = cached(crowd.scene)
    if not path.exists():
        storage.write_parquet(crowd, path)
        return True
    kept = storage.read_own(path)
    same = all(np.array_equal(getattr(kept, n), getattr(crowd, n)) for n in ("first", "offsets"))
    if kept.dt_s == crowd.dt_s and same and np.array_equal(kept.xy, crowd.xy):
        return False
    raise SettingError(
        f"recording {crowd.scene}",
        got="another imported recording of that name",
        expected="an unused name",
        hint=f"Choose another name, or run `crowdbench data remove {crowd.scene}` if the other "
        "recording is no longer needed.",
    )


def _read(asked: _Asked) -> tuple[Trajectories, Mapping[str, bytes], bool]:
    """The crowd in a file, the files that were read, and whether crowdbench wrote them."""
    path, layout, name, dt_s = asked.path, asked.layout, asked.name, asked.dt_s
    _check_options(asked)
    hint = f"The format {layout}: {FORMATS[layout]}."
    if layout == "gc":
        files = gc.files_in(path, hint)
        with hinting(hint):
            checked_dt_s(path, gc.STEP / gc.FPS, dt_s)
            return gc.read_gc(files, path, name=name, video_frames=None), files, False
    data = read_bytes(path, RecordingError, hint)
    files, ours = {path.name: data}, False
    with hinting(hint):
        if layout == "csv":
            crowd, ours = _table(asked)
        elif layout == "forum":
            checked_dt_s(path, 1 / FORUM_FPS, dt_s)
            crowd = read_forum(data, name=name, where=path)
        else:
            crowd = _numbered(data, asked)
    return crowd, files, ours


def _read_by_others(asked: _Asked) -> tuple[Trajectories, Mapping[str, bytes], bool]:
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
    return crowd, data, False


def _check_options(asked: _Asked) -> None:
    gaps, offset_s, layout = asked.gaps, asked.offset_s, asked.layout
    mendable = [name for name in FORMATS if name not in ("gc", "forum")]
    if gaps is not None and layout not in mendable:
        got = f"{gaps} with the format {layout}"
        expected = f"one of the formats {', '.join(mendable)}"
        hint = "In the formats gc and forum, missing rows are always interpolated linearly."
        raise SettingError("--gaps", got=got, expected=expected, hint=hint)
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
        crowd = storage.of_table(table, path)
        checked_dt_s(path, crowd.dt_s, asked.dt_s)
        return crowd, True
    columns = storage.columns_of(table, path)
    dt_s = checked_dt_s(path, None, asked.dt_s)
    rows = on_frames(_stamped(columns, dt_s, asked), gaps=asked.gaps, where=path)
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
        return Stamped(person, columns["frame"], xy, "frame", step=1.0)
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


def _numbered(data: bytes, asked: _Asked) -> Trajectories:
    path = asked.path
    if asked.layout == "obsmat":
        rows, velocity = parse_obsmat(data, path)
        dt_s = checked_dt_s(path, None, asked.dt_s)
        by_speed_s = step_by_speed_s(rows, velocity)
        if by_speed_s is not None and not np.isclose(by_speed_s, dt_s, rtol=0.1):
            got = f"rows {by_speed_s:.2f} s apart according to their positions and velocities"
            expected = f"rows {dt_s:g} s apart, as set by --dt-s"
            hint = "Correct --dt-s, or set the velocities to zero if they are wrong."
            raise RecordingError(path, got=got, expected=expected, hint=hint)
    else:
        parse = {"trajnet": parse_trajnet, "jupedsim": parse_jupedsim}[asked.layout]
        rows, stated_s = parse(data, path)
        dt_s = checked_dt_s(path, stated_s, asked.dt_s)
    whole = on_frames(rows, gaps=asked.gaps, where=path)
    return whole.crowd(scene=asked.name, dt_s=dt_s, where=path)


def _check_motion(crowd: Trajectories, path: Path) -> None:
    speeds = crowd.mean_speeds()
    size = float(np.ptp(crowd.xy.astype(np.float64), axis=0).max())
    hint = "Positions must be in metres, not in pixels or centimetres, and --dt-s must be the time "
    hint += "between consecutive rows of a person."
    if np.isnan(speeds).all():
        got = "no person with more than one row"
        raise RecordingError(path, got=got, expected="people with two rows or more", hint=hint)
    median = float(np.nanmedian(speeds))
    if not _SPEEDS_MPS[0] <= median <= _SPEEDS_MPS[1]:
        got = f"a median walking speed of {median:.3g} m/s"
        expected = f"{_SPEEDS_MPS[0]:g} to {_SPEEDS_MPS[1]:g} m/s"
        raise RecordingError(path, got=got, expected=expected, hint=hint)
    if size > _LONGEST_M:
        raise RecordingError(
            path,
            got=f"positions {size:.0f} m apart",
            expected=f"a place of at most {_LONGEST_M:g} m",
            hint=f"{hint} Remove outliers, or restrict the recording to a part of the place.",
        )
