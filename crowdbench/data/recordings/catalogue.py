"""The catalogue of published recordings, and the user's imported recordings."""

import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec

from crowdbench.data import storage
from crowdbench.data.companions import with_companions
from crowdbench.data.recordings.forum import read_forum
from crowdbench.data.recordings.gc import files_in, read_gc
from crowdbench.data.recordings.obsmat import read_obsmat
from crowdbench.data.table import Trajectories
from crowdbench.errors import CrowdbenchError, RecordingError, SettingError, did_you_mean, hinting
from crowdbench.files import home, read_bytes, read_struct, sha256, unwritable, write_json

REPOSITORY = "https://github.com/crowdbotp/OpenTraj"
COMMIT = "97ec1d5e1b579f26febeaa9083705952deac338a"


@dataclass(frozen=True)
class Source:
    """A published recording in the layout of OpenTraj."""

    name: str
    path: str
    """Path of a file, or of a folder of files, relative to the layout's root folder."""
    format: Literal["obsmat", "gc", "forum"]
    sha256: str | None
    """Hash of the data, see `hash_of`; None if the publisher states none."""
    address: str
    """Address where the data are published."""
    cite: str
    """The paper to cite. The recording remains subject to its owners' terms."""
    fps: float = 0.0
    """Frames per second of the video; for the format `obsmat` only."""
    frame_step: int = 0
    """Video frames from one annotation to the next; for the format `obsmat` only."""


_EWAP = "Pellegrini et al., You'll Never Walk Alone, ICCV 2009"
_UCY = "Lerner et al., Crowds by Example, Eurographics 2007"
_GC = (
    "Zhou et al., Random Field Topic Model for Semantic Region Analysis, CVPR 2011, and "
    "Yi et al., Understanding Pedestrian Behaviors from Stationary Crowd Groups, CVPR 2015"
)
_MAJECKA = (
    "Majecka, Statistical Models of Pedestrian Behaviour in the Forum, MSc dissertation, "
    "University of Edinburgh, 2009"
)
_GC_ADDRESS = f"{REPOSITORY}/tree/{COMMIT}/datasets/GC"
_SHA256 = {
    "eth": "d452ae2185ecb1164c2fdf31e75f6236f4c2ffc02c751a6b2ae921740cbc60d1",
    "hotel": "2b8577595204a6b780b80258fd50da35adb7293e3e06ad6f8e1b60965e7dde6e",
    "zara01": "bd999ebcfbc506821fa5032a10b9101e150defcff85f1ef037d09ce7c6a8c2aa",
    "gc": "8225802df781dcae75d771b5bf78950122f4f2f9ebb8f8734fd5f5d2565ff990",
    "forum": "89646c7d4be4bcbf7d067e77f9dcc9321b3eba7b499ed651050f6b639bfae726",
}
_RAW = f"https://raw.githubusercontent.com/crowdbotp/OpenTraj/{COMMIT}"


def _obsmat(name: str, folder: str, cite: str, fps: float, frame_step: int) -> Source:
    path, known = f"datasets/{folder}/obsmat.txt", _SHA256[name]
    return Source(name, path, "obsmat", known, f"{_RAW}/{path}", cite, fps, frame_step)


def _forum(name: str, day: str, address: str = "") -> Source:
    path = f"datasets/Edinburgh/annotations/tracks.{day}.txt"
    return Source(name, path, "forum", _SHA256.get(name), address or f"{_RAW}/{path}", _MAJECKA)


SOURCES = {
    source.name: source
    for source in (
        _obsmat("eth", "ETH/seq_eth", _EWAP, fps=15.0, frame_step=6),
        _obsmat("hotel", "ETH/seq_hotel", _EWAP, fps=25.0, frame_step=10),
        _obsmat("zara01", "UCY/zara01", _UCY, fps=25.0, frame_step=10),
        Source("gc", "datasets/GC", "gc", _SHA256["gc"], _GC_ADDRESS, _GC),
        _forum("forum", "01Jul"),
    )
}
"""Recordings with known hashes, by name. `source` also accepts other days of the Forum, with names
like `forum-14jul`."""

_FORUM_DAY = re.compile(
    r"forum-(0[1-9]|[12]\d|3[01])(jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec)"
)
OWN_NAME = re.compile(r"[a-z][a-z0-9_]*")
"""Valid names of users' own recordings."""
_FORUM_DAYS = "https://homepages.inf.ed.ac.uk/rbf/FORUMTRACKING/DAYS"


def source(name: str) -> Source:
    """The source of a published recording, by its name.

    Raises:
        SettingError: there is no published recording of that name.
    """
    if name in SOURCES:
        return SOURCES[name]
    if day := _FORUM_DAY.fullmatch(name):
        number, month = day[1], day[2].capitalize()
        return _forum(name, f"{number}{month}", f"{_FORUM_DAYS}/{month}.{number}.zip")
    raise SettingError(
        "recording",
        got=f"the name {name!r}",
        expected=f"one of {', '.join(SOURCES)}, a day of the Forum like forum-14jul, or the name "
        "of an imported recording",
        hint=did_you_mean(
            name,
            SOURCES,
            "Import your own recording with "
            "`crowdbench data import NAME --source FILE --format FORMAT`.",
        ),
    )


def cached(name: str) -> Path:
    """Path of the imported table of a recording, whether it exists or not."""
    return home() / "recordings" / f"{name}.parquet"


def prepared_folder(name: str) -> Path:
    """Folder of the tables that were made from a recording for its scenes."""
    return home() / "prepared" / name


def load_imported(name: str) -> Trajectories:
    """The imported recording `name`, a published one or the user's own (see `own`).

    Raises:
        SettingError: there is no recording of that name.
        RecordingError: it has not been imported, or its file is damaged or that of another one.
    """
    path = cached(name)
    if not (OWN_NAME.fullmatch(name) and path.exists()):
        source(name)
    if not path.exists():
        raise RecordingError(
            f"recording {name}",
            got="no imported table",
            expected=f"a table at {path}",
            hint=f"Run `crowdbench data fetch {name}`, or "
            f"`crowdbench data import {name} --source DIR`.",
        )
    crowd = storage.read_own(path)
    if crowd.scene != name:
        raise RecordingError(
            path,
            got=f"the recording {crowd.scene}",
            expected=f"the recording {name}",
            hint=f"Import it again: `crowdbench data import {name}`.",
        )
    return crowd


def remove_imported(name: str) -> Path:
    """Remove the imported table of a recording and what was made from it; returns its path.

    The files that it was read from are kept, and so is a hash that was stored at the first import.

    Raises:
        SettingError: there is no recording of that name.
        RecordingError: it has not been imported.
        OutputError: it cannot be removed.
    """
    if not OWN_NAME.fullmatch(name):
        source(name)
    path = cached(name)
    try:
        path.unlink()
        shutil.rmtree(prepared_folder(name), ignore_errors=True)
    except FileNotFoundError as error:
        got = "no imported recording of that name"
        expected = "one that `crowdbench data list` shows as imported"
        raise RecordingError(f"recording {name}", got=got, expected=expected) from error
    except OSError as error:
        raise unwritable(path, error) from error
    return path


def import_recording(name: str, folder: Path | None = None) -> Trajectories:
    """Read the recording `name` from a folder in OpenTraj's layout and store it for later use.

    `folder` is by default the value of the environment variable `CROWDBENCH_DATA`. If no hash is
    published, the first import stores the hash of the data, and later imports are verified
    against it.

    Raises:
        SettingError: there is no recording of that name, or no folder is given.
        RecordingError: the file is missing, broken, or not the published one.
        OutputError: the imported table cannot be written.
    """
    published = source(name)
    if folder is None:
        named = os.environ.get("CROWDBENCH_DATA")
        if not named:
            raise SettingError(
                "crowdbench data import",
                got="no folder",
                expected="--source DIR or the environment variable CROWDBENCH_DATA",
                hint="Give a folder in the layout of github.com/crowdbotp/OpenTraj, or run "
                "`crowdbench data fetch NAME`.",
            )
        folder = Path(named)
    crowd = read_published(published, folder)
    storage.write_parquet(crowd, cached(name))
    if known_sha256(published) is None:
        write_json(note_of(name), _Note(crowd.provenance["sha256"], published.address))
    return crowd


class _Note(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    sha256: str
    address: str


def note_of(name: str) -> Path:
    """Path of the file that holds the stored hash of a recording, whether it exists or not."""
    return home() / "recordings" / f"{name}.json"


def known_sha256(source: Source) -> str | None:
    """The hash that a recording's data must have.

    This is the published hash or, if there is none, the hash stored at the first import; None
    before that.

    Raises:
        RecordingError: the file with the stored hash is broken.
    """
    path = note_of(source.name)
    if source.sha256 is not None or not path.exists():
        return source.sha256
    hint = "Delete it, and import the recording again."
    return read_struct(path, _Note, RecordingError, hint).sha256


def sha256_in(source: Source, folder: Path) -> str | None:
    """The hash of a recording's data in a folder, unverified; None if a file is missing."""
    try:
        return hash_of(_files(source, folder / source.path))
    except RecordingError:
        return None


def read_published(source: Source, folder: Path) -> Trajectories:
    """Read a published recording from a folder and verify its hash.

    Raises:
        RecordingError: a file is missing or broken, or the data differ from the published ones.
    """
    path = folder / source.path
    return read_files(source, _files(source, path), path)


def read_files(source: Source, files: Mapping[str, bytes], where: object) -> Trajectories:
    """Convert a recording's files, given by name, and verify their hash.

    Raises:
        RecordingError: a file is broken, or the data differ from the published ones.
    """
    again = f"Run `crowdbench data fetch {source.name}` to get {source.address}."
    with hinting(f"The data may be truncated or altered. {again}"):
        if source.format == "gc":
            crowd = read_gc(files, where)
        else:
            (data,) = files.values()
            if source.format == "forum":
                crowd = read_forum(data, name=source.name, where=where)
            else:
                name, fps, step = source.name, source.fps, source.frame_step
                crowd = read_obsmat(data, name=name, fps=fps, frame_step=step, where=where)
    found = hash_of(files)
    hint = "They may be truncated, altered, or have converted line endings; scores would not be "
    verify(source, found, where, RecordingError, f"{hint}comparable. {again}")
    provenance = {**crowd.provenance, "source": source.address, "sha256": found}
    return with_companions(replace(crowd, provenance=provenance))


def verify(
    source: Source,
    found: str,
    where: object,
    error: type[CrowdbenchError],
    hint: str,
    also: str = "",
) -> None:
    """Raise `error` if a recording's data with the SHA-256 `found` are not the known ones.

    `also` names what to delete besides the stored hash in order to use new data.
    """
    known = known_sha256(source)
    if known in (None, found):
        return
    expected = f"the published data with SHA-256 {known}"
    if source.sha256 is None:
        expected = f"data with SHA-256 {known}, as stored at first use"
        hint += f" To use the new data, delete {note_of(source.name)}{also}."
    raise error(where, got=f"data with SHA-256 {found}", expected=expected, hint=hint)


def _files(source: Source, path: Path) -> dict[str, bytes]:
    hint = f"Run `crowdbench data fetch {source.name}`, or copy {source.address} to that path."
    if source.format != "gc":
        return {path.name: read_bytes(path, RecordingError, hint)}
    return files_in(path, hint)


def hash_of(files: Mapping[str, bytes]) -> str:
    """SHA-256 of a single file; for several files, of the lines `HASH  NAME` sorted by name."""
    if len(files) == 1:
        return sha256(*files.values())
    return sha256("".join(f"{sha256(files[name])}  {name}\n" for name in sorted(files)).encode())
