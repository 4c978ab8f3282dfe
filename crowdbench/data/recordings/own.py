"""Users' own recordings: read from files in several formats, stored by name."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from crowdbench.data import storage
from crowdbench.data.companions import with_companions
from crowdbench.data.recordings import gc
from crowdbench.data.recordings.catalogue import OWN_NAME, SOURCES, cached, hash_of
from crowdbench.data.recordings.forum import FPS as FORUM_FPS
from crowdbench.data.recordings.forum import PIXEL_M, read_forum
from crowdbench.data.recordings.jupedsim import read_jupedsim
from crowdbench.data.recordings.mending import FEW, Gaps, Stamps, on_frames
from crowdbench.data.recordings.obsmat import read_obsmat, step_of
from crowdbench.data.recordings.timing import at_scene_frames, checked_dt_s
from crowdbench.data.recordings.trajnet import read_trajnet
from crowdbench.data.table import Trajectories
from crowdbench.errors import OwnCodeError, RecordingError, SettingError, did_you_mean
from crowdbench.files import read_bytes
from crowdbench.plugins import blaming, names, part

FORMATS = {
    "obsmat": "rows `frame person x z y vx vz vy`, in metres, each person in every n-th frame",
    "gc": "a folder with H.json and Annotation/NUMBER.txt for each person (six digits), in pixels",
    "forum": "Matlab code, `TRACK.Rn=[[x y t];…];`, in pixels of a camera of 640 × 480",
    "csv": "a table (.csv or .parquet): person_id, frame (from 0, one per --dt-s) or time_s, x, y",
    "trajnet": 'TrajNet++, lines like {"track": {"f": 10, "p": 3, "x": 1.25, "y": 4.5}}',
    "jupedsim": "`# framerate: 16.00` and rows `id frame x y z`, or JuPedSim's SQLite",
}
"""The formats of recordings, each with a short description."""

_OPTIONS = ("--dt-s", "--gaps", "--offset-s")
_SPEEDS_MPS = (0.2, 3.0)
"""Plausible range of the median of people's mean speeds; outside it the units are wrong."""
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
    """Read a recording in one of `FORMATS` and convert it to the frames of a scene.

    `dt_s` is the time between consecutive rows of a person in seconds; if the file states it, the
    two must agree. `gaps` and `offset_s` repair small faults; see `read_rows`. A table that
    crowdbench wrote is not resampled.

    Raises:
        SettingError: the format does not exist, or does not support `gaps` or `offset_s`.
        RecordingError: the file is missing or broken, states another time step, or contains
            implausible speeds or distances.
    """
    crowd, as_it_is = _read(path, layout, _Asked(name, dt_s, gaps, offset_s))
    if not as_it_is:
        # Only human annotators pause. Automatic tracking does not, but it often loses people
        # mid-scene, which would look like a pause.
        crowd = at_scene_frames(crowd, pauses=layout not in ("gc", "forum"), where=path)
    _check_motion(crowd, path)
    crowd = replace(crowd, scene=name)
    return crowd if (crowd.group >= 0).any() else with_companions(crowd)


def read_rows(
    path: Path,
    layout: str,
    *,
    name: str,
    dt_s: float | None = None,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
) -> Trajectories:
    """Read a crowd in one of `FORMATS` without resampling; see `read_recording`.

    `gaps` says how missing rows, and rows between two frames, are repaired (see `mending`).
    `offset_s` is the time of the first frame for tables with a column `time_s`. The repairs are
    listed in the notes of the provenance.

    Raises:
        SettingError: the format does not exist, or does not support `gaps` or `offset_s`.
        RecordingError: the file is missing or broken, states another time step, or needs repairs
            while `gaps` is None.
    """
    return _read(path, layout, _Asked(name, dt_s, gaps, offset_s))[0]


@dataclass(frozen=True)
class _Asked:
    """The arguments of `read_rows`."""

    name: str
    dt_s: float | None
    gaps: Gaps | None
    offset_s: float | None


def _read(path: Path, layout: str, asked: _Asked) -> tuple[Trajectories, bool]:
    """The crowd in a file, and whether crowdbench wrote it, for a scene."""
    if layout not in FORMATS:
        return _read_by_others(path, layout, asked), False
    _check_mendable(layout, asked)
    hint = f"The format {layout}: {FORMATS[layout]}."
    as_it_is = False
    if layout == "gc":
        files: Mapping[str, bytes] = gc.files_in(path, hint)
    else:
        files = {path.name: read_bytes(path, RecordingError, hint)}
    try:
        if layout == "csv":
            crowd, as_it_is = _table(path, asked)
        else:
            crowd = _rows(files, path, layout, asked)
    except RecordingError as error:
        asks = any(option in error.hint or option in error.expected for option in _OPTIONS)
        if layout in ("csv", "trajnet", "jupedsim") or asks:
            raise
        # The hint of these readers is to fetch the published recording again.
        raise RecordingError(
            error.where, got=error.got, expected=error.expected, hint=hint
        ) from error
    return _with_source(crowd, path, files, _transform(layout)), as_it_is


def _with_source(
    crowd: Trajectories, path: Path, files: Mapping[str, bytes], notes: Mapping[str, str]
) -> Trajectories:
    notes = {**crowd.provenance.get("notes", {}), **notes}
    provenance = {"source": path.name, "sha256": hash_of(files), "notes": notes}
    return replace(crowd, provenance=provenance)


def _read_by_others(path: Path, layout: str, asked: _Asked) -> Trajectories:
    """Read a format that another package registered, by its function `read(path, name=, dt_s=)`."""
    read = part("recordings", layout)
    if read is None:
        known = (*FORMATS, *names("recordings", FORMATS))
        raise SettingError(
            "--format",
            got=repr(layout),
            expected=f"one of {', '.join(known)}",
            hint=did_you_mean(layout, known),
        )
    if asked.gaps is not None or asked.offset_s is not None:
        raise SettingError(
            "--gaps" if asked.gaps is not None else "--offset-s",
            got=f"the format {layout} of another package",
            expected=f"one of crowdbench's formats: {', '.join(FORMATS)}",
        )
    with blaming(f"format {layout}, {path}"):
        crowd = read(path, name=asked.name, dt_s=asked.dt_s)
    if not isinstance(crowd, Trajectories):
        raise OwnCodeError(f"format {layout}", got=repr(crowd)[:200], expected="Trajectories")
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    hashed = {
        str(file.relative_to(path.parent)): file.read_bytes() for file in files if file.is_file()
    }
    return _with_source(crowd, path, hashed, {})


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


def _check_mendable(layout: str, asked: _Asked) -> None:
    """Raise if the format does not support an option that is given."""
    gaps, offset_s = asked.gaps, asked.offset_s
    if gaps is not None and layout in ("gc", "forum"):
        raise SettingError(
            "--gaps",
            got=f"{gaps} with the format {layout}",
            expected="another format",
            hint="In this format missing rows are always interpolated linearly.",
        )
    if offset_s is not None and layout != "csv":
        raise SettingError(
            "--offset-s",
            got=f"the format {layout}, whose frames are numbered",
            expected="the format csv with a column time_s",
        )
    if offset_s is not None and not np.isfinite(offset_s):
        raise SettingError("--offset-s", got=f"{offset_s}", expected="a finite number of seconds")


def _rows(files: Mapping[str, bytes], path: Path, layout: str, asked: _Asked) -> Trajectories:
    name, dt_s = asked.name, asked.dt_s
    if layout == "gc":
        checked_dt_s(path, gc.STEP / gc.FPS, dt_s)
        return gc.read_gc(files, path, name=name, video_frames=None)
    (data,) = files.values()
    if layout == "forum":
        checked_dt_s(path, 1 / FORUM_FPS, dt_s)
        return read_forum(data, name=name, where=path)
    if layout == "obsmat":
        return _obsmat(data, path, asked)
    read = {"trajnet": read_trajnet, "jupedsim": read_jupedsim}[layout]
    return read(data, name=name, dt_s=dt_s, where=path, gaps=asked.gaps)


def _table(path: Path, asked: _Asked) -> tuple[Trajectories, bool]:
    """The crowd in a table, and whether crowdbench wrote it."""
    table, offset_s = storage.read_table(path), asked.offset_s
    if storage.own_metadata(table, path) is not None:
        if offset_s is not None:
            raise SettingError(
                "--offset-s",
                got=f"{path.name}, which crowdbench wrote",
                expected="a table of another program",
            )
        crowd = storage.own_table(table, path)
        checked_dt_s(path, crowd.dt_s, asked.dt_s)
        return crowd, True
    columns = storage.columns_of(table, path)
    dt_s = checked_dt_s(path, None, asked.dt_s)
    rows = on_frames(
        columns["person_id"],
        _stamps(columns, path, dt_s, offset_s),
        np.stack([columns["x"], columns["y"]], axis=1).astype(np.float64),
        gaps=asked.gaps,
        where=path,
    )
    if offset_s:
        rows.notes["times"] = f"reduced by {offset_s:g} s"
        for column in {"spawn_s", "requested_s"} & set(columns):
            columns[column] = columns[column] - offset_s
    return rows.crowd(scene=asked.name, dt_s=dt_s, where=path, columns=columns), False


def _stamps(
    columns: Mapping[str, np.ndarray], path: Path, dt_s: float, offset_s: float | None
) -> Stamps:
    """Time stamps from `frame` or `time_s`; if both columns exist, they must agree."""
    person, frame = columns["person_id"], columns.get("frame")
    if "time_s" not in columns:
        if offset_s is not None:
            raise SettingError(
                "--offset-s",
                got=f"{path.name} without a column time_s",
                expected="a table with that column",
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
            expected=f"times of at least {offset_s:g} s, as set by --offset-s",
            hint="--offset-s must not be later than the first row.",
        )
    return stamps


def _check_agree(person: np.ndarray, frame: np.ndarray, stamps: Stamps, path: Path) -> None:
    """Raise if the columns `frame` and `time_s` of a table contradict each other."""
    late = stamps.ticks() - frame
    wrong = ~(np.abs(late) < 0.05)
    if not wrong.any():
        return
    row = int(np.flatnonzero(wrong)[0])
    usual = float(np.median(late))
    constant = (np.abs(late - usual) < 0.05).mean() > 0.5 and abs(usual) >= 0.05
    raise RecordingError(
        path,
        got=f"person {person[row]} in frame {frame[row]} at {stamps.of(row)} ({wrong.sum()} of "
        f"{len(wrong)} rows whose time does not match their frame)",
        expected=f"time_s equal to frame × {stamps.step:g} s",
        hint=f"Use --offset-s {usual * stamps.step + stamps.origin:.4g} to start frame 0 at that "
        "time."
        if constant
        else "Remove the wrong column; the other one is sufficient.",
    )


def _obsmat(data: bytes, path: Path, asked: _Asked) -> Trajectories:
    step, by_speed_s = step_of(data, path)
    dt_s = checked_dt_s(path, None, asked.dt_s)
    if by_speed_s is not None and not np.isclose(by_speed_s, dt_s, rtol=0.1):
        raise RecordingError(
            path,
            got=f"rows {by_speed_s:.2f} s apart according to their positions and velocities",
            expected=f"rows {dt_s:g} s apart, as set by --dt-s",
            hint="Correct --dt-s, or set the velocities to zero if they are wrong.",
        )
    fps = round(step / dt_s, 9)  # rounded, because otherwise 6 / (6 / 0.4) would not be 0.4
    return read_obsmat(
        data, name=asked.name, fps=fps, frame_step=step, where=path, gaps=asked.gaps, hint=FEW
    )


def _transform(layout: str) -> dict[str, str]:
    """How pixels were converted to metres, as a note that the user can check."""
    return {
        "gc": {"metres": f"by H.json × {gc.UNIT_M} m, as for Grand Central"},
        "forum": {"metres": f"{1000 * PIXEL_M:.1f} mm per pixel, as for the Edinburgh Forum"},
    }.get(layout, {})


def _check_motion(crowd: Trajectories, path: Path) -> None:
    speeds = crowd.mean_speeds()
    size = float(np.ptp(crowd.xy.astype(np.float64), axis=0).max())
    hint = "Positions must be in metres, not in pixels or centimetres, and --dt-s must be the time "
    hint += "between consecutive rows of a person."
    if np.isnan(speeds).all():
        raise RecordingError(
            path,
            got="no person with more than one row",
            expected="people with two rows or more",
            hint=hint,
        )
    median = float(np.nanmedian(speeds))
    if not _SPEEDS_MPS[0] <= median <= _SPEEDS_MPS[1]:
        raise RecordingError(
            path,
            got=f"a median walking speed of {median:.3g} m/s",
            expected=f"{_SPEEDS_MPS[0]:g} to {_SPEEDS_MPS[1]:g} m/s",
            hint=hint,
        )
    if size > _LONGEST_M:
        raise RecordingError(
            path,
            got=f"positions {size:.0f} m apart",
            expected=f"a place of at most {_LONGEST_M:g} m",
            hint=f"{hint} Remove outliers, or restrict the recording to a part of the place.",
        )
