"""Crowds for other programs, and theirs for crowdbench: the same rows in another format."""

from collections.abc import Callable
from pathlib import Path

from crowdbench.errors import SettingError
from crowdbench.recordings.jupedsim import write_jupedsim
from crowdbench.recordings.mending import Gaps
from crowdbench.recordings.own import read_rows
from crowdbench.recordings.trajnet import write_trajnet
from crowdbench.trajectories.storage import write_csv
from crowdbench.trajectories.table import Trajectories

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

    Every row and frame stays; what the other format has no place for is lost. `dt_s` are the
    seconds between the rows of a person, where the file does not say it; `gaps` and `offset_s`
    mend small faults, see `own.read_rows`.

    Raises:
        SettingError: there is no such format.
        RecordingError: the file cannot be read.
        OutputError: `out` cannot be written.
    """
    if to not in WRITERS:
        raise SettingError("--to", got=repr(to), expected=f"one of {', '.join(WRITERS)}")
    crowd = read_rows(path, layout, name=path.stem, dt_s=dt_s, gaps=gaps, offset_s=offset_s)
    WRITERS[to](crowd, out)
    return crowd
