"""Users' own recordings, stored by name."""

from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np

from crowdbench.data import storage
from crowdbench.data.recordings.catalogue import OWN_NAME, SOURCES, cached
from crowdbench.data.recordings.formats import read_recording
from crowdbench.data.recordings.mending import Gaps
from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError


class Reading(TypedDict, total=False):
    """How a file is read: the options of `read_recording`."""

    dt_s: float | None
    gaps: Gaps | None
    offset_s: float | None
    scale: float | None
    homography: Path | None
    resample: float | None


def import_own(name: str, path: Path, layout: str, **how: Unpack[Reading]) -> Trajectories:
    """Read a recording and store it for later use under a name that the user chooses.

    The options are those of `read_recording`. Returns the recording.

    Raises:
        SettingError: the name is taken or invalid, or the format does not exist.
        RecordingError: the file cannot be read; see `read_recording`.
        OutputError: the imported table cannot be written.
    """
    check_name(name)
    crowd = read_recording(path, layout, name=name, **how)
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
