"""Output of simulators: SUMO's FCD, and what PedPy reads of others."""

import textwrap
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from crowdbench.data.recordings.mending import Stamped
from crowdbench.data.recordings.text_rows import numbered
from crowdbench.errors import RecordingError, SettingError, to_install

BY_PEDPY = ("vadere", "hdf5", "viswalk", "pathfinder", "crowdit")
"""The formats that PedPy reads."""
VADERE_FPS = 10.0
"""Vadere writes a row for each step of a foot; PedPy interpolates positions at this rate."""


def parse_fcd(data: bytes, where: object) -> tuple[Stamped, float]:
    """The persons of SUMO's `--fcd-output`, and seconds from one time step to the next.

    Vehicles are left out.

    Raises:
        RecordingError: the file is no such XML, has no person, or only one time step.
    """
    ids, rows, times = [], [], []
    time_s = np.nan
    try:
        for event, each in ElementTree.iterparse(BytesIO(data), events=("start", "end")):
            if event == "start" and each.tag == "timestep":
                time_s = float(each.attrib["time"])
                times.append(time_s)
            elif event == "start" and each.tag == "person":
                ids.append(each.attrib["id"])
                rows.append((time_s, float(each.attrib["x"]), float(each.attrib["y"])))
            elif event == "end":
                each.clear()
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        expected = "SUMO's FCD: <timestep time> with <person id x y>"
        raise RecordingError(where, got=f"{error}", expected=expected) from error
    if not rows or len(times) < 2:
        got = "no person" if times else "no time step"
        raise RecordingError(where, got=got, expected="<timestep time> with <person id x y>")
    of = np.array(rows, dtype=np.float64)
    steps = np.diff(np.unique(np.round(times, 6)))
    step_s = float(np.median(steps)) if len(steps) else 1.0
    origin = float(np.round(of[:, 0].min() / step_s) * step_s)
    return Stamped(numbered(ids), of[:, 0], of[:, 1:], "s", step_s, origin), step_s


def read_by_pedpy(path: Path, layout: str) -> tuple[Stamped, float]:
    """What PedPy reads of a file: its rows, and seconds from row to row.

    Raises:
        SettingError: PedPy is not installed.
        RecordingError: PedPy refuses the file.
    """
    try:
        import pedpy
    except ImportError as error:
        raise SettingError(
            f"format {layout}",
            got="an environment without PedPy, which reads it",
            expected="PedPy",
            hint=to_install("pedpy"),
        ) from error
    readers = {
        "vadere": lambda file: pedpy.load_trajectory_from_vadere(
            trajectory_file=file, frame_rate=VADERE_FPS, ignore_too_short_trajectories=True
        ),
        "hdf5": lambda file: pedpy.load_trajectory_from_ped_data_archive_hdf5(trajectory_file=file),
        "viswalk": lambda file: pedpy.load_trajectory_from_viswalk(trajectory_file=file),
        "pathfinder": lambda file: (
            pedpy.load_trajectory_from_pathfinder_json(trajectory_file=file)
            if path.suffix == ".json"
            else pedpy.load_trajectory_from_pathfinder_csv(trajectory_file=file)
        ),
        "crowdit": lambda file: pedpy.load_trajectory_from_crowdit(trajectory_file=file),
    }
    try:
        found = readers[layout](path)
    except Exception as error:  # PedPy's readers raise errors of pandas, h5py and others, too
        got = textwrap.shorten(str(error), 200, placeholder=" …")
        expected = f"a file that PedPy reads as {layout}"
        raise RecordingError(path, got=got, expected=expected) from error
    table = found.data
    xy = table[["x", "y"]].to_numpy(dtype=np.float64)
    person = numbered(table["id"].tolist())
    rows = Stamped.of_frames(person, table["frame"].to_numpy(dtype=np.int64), xy)
    return rows, rows.step / float(found.frame_rate)
