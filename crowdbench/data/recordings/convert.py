"""Conversion of crowds between file formats."""

from collections.abc import Callable
from pathlib import Path

from crowdbench.data.recordings.jupedsim import write_jupedsim
from crowdbench.data.recordings.mending import Gaps
from crowdbench.data.recordings.own import read_rows
from crowdbench.data.recordings.trajnet import write_trajnet
from crowdbench.data.storage import write_csv
from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError

WRITERS: dict[str, Callable[[Trajectories, Path], None]] = {
    "csv": write_csv,
    "trajnet": write_trajnet,
    "jupedsim": write_jupedsim,
}


def convert(
    path: Path,
    out: Path,
    *,
    to: str,
    layout: str = "csv",
    dt_s: float | None = None,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
) -> Trajectories:
    """Read a crowd in one of `own.FORMATS` and write it to `out` in one of `WRITERS`.

    All rows and frames are kept; information that the other format cannot represent is lost.
    `dt_s` is the time between consecutive rows of a person in seconds, if the file does not state
    it. `gaps` and `offset_s` repair small faults; see `own.read_rows`. Returns the crowd.

    Raises:
        SettingError: the format does not exist.
        RecordingError: the file cannot be read.
        OutputError: `out` cannot be written.
    """
    if to not in WRITERS:
        raise SettingError("--to", got=repr(to), expected=f"one of {', '.join(WRITERS)}")
    crowd = read_rows(path, layout, name=path.stem, dt_s=dt_s, gaps=gaps, offset_s=offset_s)
    WRITERS[to](crowd, out)
    return crowd
