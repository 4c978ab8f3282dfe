"""Recordings of places that nobody here has seen: read from the user's files, kept by name."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from crowdbench.errors import OwnCodeError, RecordingError, SettingError
from crowdbench.files import read_bytes
from crowdbench.plugins import blaming, names, part
from crowdbench.recordings import gc
from crowdbench.recordings.catalogue import OWN_NAME, SOURCES, cached, hash_of
from crowdbench.recordings.forum import FPS as FORUM_FPS
from crowdbench.recordings.forum import PIXEL_M, read_forum
from crowdbench.recordings.jupedsim import read_jupedsim
from crowdbench.recordings.mending import FEW, Gaps, Stamps, on_frames
from crowdbench.recordings.obsmat import read_obsmat, step_of
from crowdbench.recordings.timing import at_scene_frames, checked_dt_s
from crowdbench.recordings.trajnet import read_trajnet
from crowdbench.trajectories import storage
from crowdbench.trajectories.table import Trajectories

FORMATS = {
    "obsmat": "rows `frame person x z y vx vz vy`, metres, each person in every n-th frame",
    "gc": "a folder with H.json and Annotation/NUMBER.txt of each person (six digits), in pixels",
    "forum": "Matlab code, `TRACK.Rn=[[x y t];…];`, in pixels of a camera of 640 × 480",
    "csv": "a table (.csv or .parquet): person_id, frame (rows of --dt-s, from 0) or time_s, x, y",
    "trajnet": 'TrajNet++, lines like {"track": {"f": 10, "p": 3, "x": 1.25, "y": 4.5}}',
    "jupedsim": "`# framerate: 16.00` and rows `id frame x y z`, or JuPedSim's SQLite",
}
"""What a recording can be read from, and what it looks like."""

_OPTIONS = ("--dt-s", "--gaps", "--offset-s")
_SPEEDS_MPS = (0.2, 3.0)
"""Between these lies the median of people's mean speeds, or numbers are no metres or seconds."""
_LONGEST_M = 300.0


def read_recording(
    path: Path,
    layout: str,
    *,
    name: str,
    dt_s: float | None = None,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
) -> Trajectories:
    """Read a recording in one of `FORMATS` and put it on a scene's frames.

    `dt_s` are the seconds from one row of a person to the next; what the file says of it must
    agree. `gaps` and `offset_s` mend small faults, see `read_rows`. A table that crowdbench wrote
    is taken as it is.

    Raises:
        SettingError: there is no such format, or nothing in it that could be mended so.
        RecordingError: the file is missing or broken, states another time step, or its people
            move as no people do.
    """
    crowd = read_rows(path, layout, name=name, dt_s=dt_s, gaps=gaps, offset_s=offset_s)
    if not (layout == "csv" and storage.is_own(path)):
        # Pauses are a habit of annotators; a camera that tracks people by itself makes none, and
        # loses people mid-scene all the time.
        crowd = at_scene_frames(crowd, pauses=layout not in ("gc", "forum"), where=path)
    _check_motion(crowd, path)
    return replace(crowd, scene=name)


def read_rows(
    path: Path,
    layout: str,
    *,
    name: str,
    dt_s: float | None = None,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
) -> Trajectories:
    """Read a crowd in one of `FORMATS` at the rate of its rows; see `read_recording`.

    Where a person lacks rows, or has rows beside the frames, `gaps` says how that is mended (see
    `mending`); `offset_s` is the time of the first frame where a table has `time_s`. What was
    mended stands in the provenance's notes.

    Raises:
        SettingError: there is no such format, or nothing in it that could be mended so.
        RecordingError: the file is missing or broken, states another time step, or has gaps or
            rows beside the frames and `gaps` is None.
    """
    if layout not in FORMATS:
        return _read_by_others(path, layout, name, dt_s, gaps, offset_s)
    _check_mendable(layout, gaps, offset_s)
    hint = f"The format {layout}: {FORMATS[layout]}."
    if layout == "gc":
        files: Mapping[str, bytes] = gc.files_in(path, hint)
    else:
        files = {path.name: read_bytes(path, RecordingError, hint)}
    try:
        crowd = _rows(files, path, layout, name, dt_s, gaps, offset_s)
    except RecordingError as error:
        asks = any(option in error.hint or option in error.expected for option in _OPTIONS)
        if layout in ("csv", "trajnet", "jupedsim") or asks:
            raise
        # The readers of published recordings would tell to fetch them anew.
        raise RecordingError(
            error.where, got=error.got, expected=error.expected, hint=hint
        ) from error
    notes = {**crowd.provenance.get("notes", {}), **_transform(layout)}
    provenance = {"source": path.name, "sha256": hash_of(files), "notes": notes}
    return replace(crowd, provenance=provenance)


def _read_by_others(
    path: Path,
    layout: str,
    name: str,
    dt_s: float | None,
    gaps: Gaps | None,
    offset_s: float | None,
) -> Trajectories:
    """Read a format that another package registered, `read(path, name=, dt_s=)`."""
    read = part("recordings", layout)
    if read is None:
        known = ", ".join((*FORMATS, *names("recordings", FORMATS)))
        raise SettingError("--format", got=repr(layout), expected=f"one of {known}")
    if gaps is not None or offset_s is not None:
        raise SettingError(
            "--gaps" if gaps is not None else "--offset-s",
            got=f"the format {layout}, of another package",
            expected=f"one of crowdbench's: {', '.join(FORMATS)}",
        )
    with blaming(f"format {layout}, {path}"):
        crowd = read(path, name=name, dt_s=dt_s)
    if not isinstance(crowd, Trajectories):
        raise OwnCodeError(f"format {layout}", got=repr(crowd)[:200], expected="Trajectories")
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    hashed = {
        str(file.relative_to(path.parent)): file.read_bytes() for file in files if file.is_file()
    }
    notes = crowd.provenance.get("notes", {})
    return replace(
        crowd, provenance={"source": path.name, "sha256": hash_of(hashed), "notes": notes}
    )


def import_own(
    name: str,
    path: Path,
    layout: str,
    dt_s: float | None = None,
    *,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
) -> Trajectories:
    """Read a recording and keep it for later use under a name of the user's choice.

    The options are those of `read_recording`.

    Raises:
        SettingError: the name is taken or no name, or there is no such format.
        RecordingError: the file cannot be read; see `read_recording`.
        OutputError: the imported table cannot be written.
    """
    check_name(name)
    crowd = read_recording(path, layout, name=name, dt_s=dt_s, gaps=gaps, offset_s=offset_s)
    keep(crowd)
    return crowd


def check_name(name: str) -> None:
    """Refuse a name that is not the user's to give.

    Raises:
        SettingError: it is a published recording's, or no name.
    """
    if name in (*SOURCES, "plaza") or not OWN_NAME.fullmatch(name):
        raise SettingError(
            "recording",
            got=f"the name {name!r}",
            expected="a name of your own: small letters, digits and _, a letter first, and none of "
            f"{', '.join((*SOURCES, 'plaza'))}",
        )


def keep(crowd: Trajectories) -> bool:
    """Keep a recording by its name; False where that very table is kept already.

    Raises:
        SettingError: another recording is kept by that name.
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
        got="another one that is imported by that name",
        expected="a name that is free",
        hint=f"Choose another one; or `crowdbench data remove {crowd.scene}` if you need it no "
        "more.",
    )


def _check_mendable(layout: str, gaps: Gaps | None, offset_s: float | None) -> None:
    """Refuse options that nothing in the format answers to."""
    if gaps is not None and layout in ("gc", "forum"):
        raise SettingError(
            "--gaps",
            got=f"{gaps} with the format {layout}",
            expected="one of the other formats",
            hint="In this one people walk on straight wherever rows are missing.",
        )
    if offset_s is not None and layout != "csv":
        raise SettingError(
            "--offset-s",
            got=f"the format {layout}, whose frames are numbered",
            expected="csv with a column time_s",
        )
    if offset_s is not None and not np.isfinite(offset_s):
        raise SettingError("--offset-s", got=f"{offset_s}", expected="seconds")


def _rows(
    files: Mapping[str, bytes],
    path: Path,
    layout: str,
    name: str,
    dt_s: float | None,
    gaps: Gaps | None,
    offset_s: float | None,
) -> Trajectories:
    if layout == "gc":
        checked_dt_s(path, gc.STEP / gc.FPS, dt_s)
        return gc.read_gc(files, path, name=name, video_frames=None)
    if layout == "csv":
        return _table(path, name, dt_s, gaps, offset_s)
    (data,) = files.values()
    if layout == "forum":
        checked_dt_s(path, 1 / FORUM_FPS, dt_s)
        return read_forum(data, name=name, where=path)
    if layout == "obsmat":
        return _obsmat(data, path, name, dt_s, gaps)
    read = {"trajnet": read_trajnet, "jupedsim": read_jupedsim}[layout]
    return read(data, name=name, dt_s=dt_s, where=path, gaps=gaps)


def _table(
    path: Path, name: str, dt_s: float | None, gaps: Gaps | None, offset_s: float | None
) -> Trajectories:
    if storage.is_own(path):
        if offset_s is not None:
            raise SettingError(
                "--offset-s", got=f"{path.name}, which crowdbench wrote", expected="other tables"
            )
        crowd = storage.read_own(path)
        checked_dt_s(path, crowd.dt_s, dt_s)
        return crowd
    columns = storage.read_columns(path)
    dt_s = checked_dt_s(path, None, dt_s)
    rows = on_frames(
        columns["person_id"],
        _stamps(columns, path, dt_s, offset_s),
        np.stack([columns["x"], columns["y"]], axis=1).astype(np.float64),
        gaps=gaps,
        where=path,
    )
    if offset_s:
        rows.notes["times"] = f"{offset_s:g} s earlier than in the file"
        for column in {"spawn_s", "requested_s"} & set(columns):
            columns[column] = columns[column] - offset_s
    return rows.crowd(scene=name, dt_s=dt_s, where=path, columns=columns)


def _stamps(
    columns: Mapping[str, np.ndarray], path: Path, dt_s: float, offset_s: float | None
) -> Stamps:
    """By `frame` or by `time_s`; where there are both, they must agree."""
    person, frame = columns["person_id"], columns.get("frame")
    if "time_s" not in columns:
        if offset_s is not None:
            raise SettingError(
                "--offset-s", got=f"{path.name} without a column time_s", expected="one"
            )
        return Stamps(columns["frame"], "frame", step=1.0)
    stamps = Stamps(columns["time_s"], "s", step=dt_s, origin=offset_s or 0.0)
    ticks = stamps.ticks()
    if frame is not None:
        _check_agree(person, frame, stamps, path)
    if offset_s is not None and ticks.min() < -0.05:
        row = int(ticks.argmin())
        raise RecordingError(
            path,
            got=f"person {person[row]} at {stamps.of(row)}",
            expected=f"times from {offset_s:g} s on, as asked by --offset-s",
            hint="It is the time of a frame no later than the first row.",
        )
    return stamps


def _check_agree(person: np.ndarray, frame: np.ndarray, stamps: Stamps, path: Path) -> None:
    """Refuse a table whose frames and times are not the same."""
    late = stamps.ticks() - frame
    wrong = ~(np.abs(late) < 0.05)
    if not wrong.any():
        return
    row = int(np.flatnonzero(wrong)[0])
    usual = float(np.median(late))
    constant = (np.abs(late - usual) < 0.05).mean() > 0.5 and abs(usual) >= 0.05
    raise RecordingError(
        path,
        got=f"person {person[row]} in frame {frame[row]} at {stamps.of(row)}, and {wrong.sum()} "
        f"of {len(wrong)} rows whose times are not those of their frames",
        expected=f"time_s in multiples of {stamps.step:g} s, frame × that",
        hint=f"--offset-s {usual * stamps.step + stamps.origin:.4g} lets frame 0 begin then."
        if constant
        else "Remove the column that is wrong; the other one does.",
    )


def _obsmat(
    data: bytes, path: Path, name: str, dt_s: float | None, gaps: Gaps | None
) -> Trajectories:
    step, by_speed_s = step_of(data, path)
    dt_s = checked_dt_s(path, None, dt_s)
    if by_speed_s is not None and not np.isclose(by_speed_s, dt_s, rtol=0.1):
        raise RecordingError(
            path,
            got=f"rows {by_speed_s:.2f} s apart, by the positions and velocities in them",
            expected=f"{dt_s:g} s, as asked by --dt-s",
            hint="Correct --dt-s; or make the velocities zero if it is they that are wrong.",
        )
    fps = round(step / dt_s, 9)  # or 6 / (6 / 0.4) would not be 0.4
    return read_obsmat(data, name=name, fps=fps, frame_step=step, where=path, gaps=gaps, hint=FEW)


def _transform(layout: str) -> dict[str, str]:
    """How pixels became metres, to be looked at by who knows the place."""
    return {
        "gc": {"metres": f"by H.json × {gc.UNIT_M} m, as in Grand Central"},
        "forum": {"metres": f"{1000 * PIXEL_M:.1f} mm per pixel, as in the Edinburgh Forum"},
    }.get(layout, {})


def _check_motion(crowd: Trajectories, path: Path) -> None:
    speeds = crowd.mean_speeds()
    size = float(np.ptp(crowd.xy.astype(np.float64), axis=0).max())
    hint = "Positions must be metres, no pixels or centimetres, and --dt-s the seconds from one "
    hint += "row of a person to the next."
    if np.isnan(speeds).all():
        raise RecordingError(
            path, got="nobody with more than one row", expected="people who walk", hint=hint
        )
    median = float(np.nanmedian(speeds))
    if not _SPEEDS_MPS[0] <= median <= _SPEEDS_MPS[1]:
        raise RecordingError(
            path,
            got=f"people half of whom are faster than {median:.3g} m/s",
            expected=f"{_SPEEDS_MPS[0]:g} to {_SPEEDS_MPS[1]:g} m/s",
            hint=hint,
        )
    if size > _LONGEST_M:
        raise RecordingError(
            path,
            got=f"positions {size:.0f} m apart",
            expected=f"a place of {_LONGEST_M:g} m at most",
            hint=f"{hint} Remove strays, and cut out the part where people come and go.",
        )
