"""The recordings crowdbench knows: where they are published, and the user's imported copies."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

from crowdbench import tables
from crowdbench.errors import RecordingError, SettingError
from crowdbench.files import home, read_bytes, sha256
from crowdbench.recordings.obsmat import read_obsmat
from crowdbench.trajectories import Trajectories

_COMMIT = "97ec1d5e1b579f26febeaa9083705952deac338a"


@dataclass(frozen=True)
class Source:
    """A published recording in the layout of OpenTraj."""

    name: str
    path: str
    """Relative to the layout's root folder."""
    sha256: str
    fps: float
    frame_step: int
    """Video frames from one annotation to the next."""
    cite: str
    """The paper to cite; the recording stays under its owners' terms."""

    @property
    def address(self) -> str:
        """Public address of the file."""
        return f"https://raw.githubusercontent.com/crowdbotp/OpenTraj/{_COMMIT}/{self.path}"


_EWAP = "Pellegrini et al., You'll Never Walk Alone, ICCV 2009"
_UCY = "Lerner et al., Crowds by Example, Eurographics 2007"

SOURCES = {
    source.name: source
    for source in (
        Source(
            "eth",
            "datasets/ETH/seq_eth/obsmat.txt",
            "d452ae2185ecb1164c2fdf31e75f6236f4c2ffc02c751a6b2ae921740cbc60d1",
            fps=15.0,
            frame_step=6,
            cite=_EWAP,
        ),
        Source(
            "hotel",
            "datasets/ETH/seq_hotel/obsmat.txt",
            "2b8577595204a6b780b80258fd50da35adb7293e3e06ad6f8e1b60965e7dde6e",
            fps=25.0,
            frame_step=10,
            cite=_EWAP,
        ),
        Source(
            "zara01",
            "datasets/UCY/zara01/obsmat.txt",
            "bd999ebcfbc506821fa5032a10b9101e150defcff85f1ef037d09ce7c6a8c2aa",
            fps=25.0,
            frame_step=10,
            cite=_UCY,
        ),
    )
}


def cached(name: str) -> Path:
    """Where the imported table of a recording lies (or would lie)."""
    return home() / "recordings" / f"{name}.parquet"


def load_imported(name: str) -> Trajectories:
    """The imported recording `name`.

    Raises:
        SettingError: there is no recording of that name.
        RecordingError: it has not been imported.
    """
    _known(name)
    path = cached(name)
    if not path.exists():
        raise RecordingError(
            f"recording {name}",
            got="none imported",
            expected=f"a table at {path}",
            mend=f"Run `crowdbench data import {name} --source DIR`.",
        )
    return tables.read_own(path)


def import_recording(name: str, folder: Path | None = None) -> Trajectories:
    """Read the recording `name` from a folder in OpenTraj's layout and keep it for later use.

    `folder` is by default the one that the environment variable `CROWDBENCH_DATA` names.

    Raises:
        SettingError: there is no recording of that name, or no folder is named.
        RecordingError: the file is missing, broken, or not the published one.
        OutputError: the imported table cannot be written.
    """
    source = _known(name)
    crowd = read_published(source, _folder(folder))
    tables.write_parquet(crowd, cached(name))
    return crowd


def read_published(source: Source, folder: Path) -> Trajectories:
    """Read a published recording and hold it against the hash of the published file."""
    path = folder / source.path
    data = read_bytes(path, RecordingError, f"Fetch {source.address} into that place.")
    crowd = read_obsmat(
        data, name=source.name, fps=source.fps, frame_step=source.frame_step, where=path
    )
    if sha256(data) != source.sha256:
        raise RecordingError(
            path,
            got=f"a file of SHA-256 {sha256(data)[:12]}… with {len(crowd)} persons",
            expected=f"the published file, SHA-256 {source.sha256[:12]}…",
            mend="It may be cut short, altered, or have its line ends converted; scores would "
            f"not be comparable. Fetch {source.address} again.",
        )
    return replace(crowd, provenance={"source": source.address, "sha256": source.sha256})


def _known(name: str) -> Source:
    if name not in SOURCES:
        raise SettingError(
            "recording", got=f"the name {name!r}", expected=f"one of {', '.join(SOURCES)}"
        )
    return SOURCES[name]


def _folder(folder: Path | None) -> Path:
    if folder is not None:
        return folder
    if named := os.environ.get("CROWDBENCH_DATA"):
        return Path(named)
    raise SettingError(
        "crowdbench data import",
        got="no folder",
        expected="--source DIR or the environment variable CROWDBENCH_DATA",
        mend="Name a folder in the layout of github.com/crowdbotp/OpenTraj.",
    )
