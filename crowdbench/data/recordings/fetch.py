"""Downloads published recordings into a folder in OpenTraj's layout."""

import io
import lzma
import shlex
import struct
import zipfile
import zlib
from pathlib import Path

from crowdbench.data.recordings.catalogue import (
    COMMIT,
    REPOSITORY,
    Source,
    known_sha256,
    read_files,
    sha256_in,
    source,
)
from crowdbench.data.recordings.download import Progress, download
from crowdbench.data.recordings.first_use import note_of
from crowdbench.errors import FetchError
from crowdbench.files import home, replacing, sha256

MAX_TRACKS_BYTES = 1 << 26
"""Maximum size of an unpacked tracks file; ten times that of the busiest day."""
_HEAD = 1 << 16
"""Bytes at the beginning of a file in which the first track must begin."""


def default_folder() -> Path:
    """The folder that recordings are downloaded to by default."""
    return home() / "OpenTraj"


def fetch(name: str, folder: Path, progress: Progress = lambda *_: None) -> bool:
    """Download a recording's file to its place in `folder`; returns whether a download was needed.

    A correct existing file is kept, any other is replaced by verified data only.

    Raises:
        SettingError: there is no recording of that name.
        FetchError: the file cannot be downloaded, or is not the published one. For `gc`, which
            consists of many files, the error says which commands to run.
        RecordingError: the data are not a recording.
        OutputError: the folder cannot be written.
    """
    published = source(name)
    known = known_sha256(published)
    there = sha256_in(published, folder)
    if there is not None and known in (None, there):
        return False
    if published.format == "gc":
        raise _by_git(published, folder)
    path = folder / published.path
    with replacing(path) as temporary:  # before the download: the folder can be written
        data = download(published.address, progress)
        temporary.write_bytes(_checked(data, published, path, known))
    return True


def git_commands(published: Source, folder: Path, repository: str, commit: str) -> list[str]:
    """Shell commands that check out only a recording's folder at the pinned commit."""
    git = ["git", "-C", str(folder)]
    return [
        shlex.join(command)
        for command in (
            ["git", "init", "--quiet", str(folder)],
            [*git, "remote", "add", "origin", repository],
            [*git, "sparse-checkout", "set", published.path],
            [*git, "fetch", "--depth", "1", "--filter=blob:none", "origin", commit],
            # Converted line endings would change the hash.
            [*git, "-c", "core.autocrlf=false", "checkout", "--detach", commit],
        )
    ]


def _by_git(published: Source, folder: Path) -> FetchError:
    hint = "Choose another folder with --out: this one contains a git repository."
    if not (folder / ".git").exists():
        bring = ["crowdbench", "data", "import", published.name, "--source", str(folder)]
        commands = [*git_commands(published, folder, REPOSITORY, COMMIT), shlex.join(bring)]
        hint = "Run\n\n" + "".join(f"  {command}\n" for command in commands)
    return FetchError(
        f"recording {published.name}",
        got="thousands of files that cannot be downloaded as one, so nothing was downloaded",
        expected="a checkout of their folder with git",
        hint=hint,
    )


def _checked(data: bytes, published: Source, path: Path, known: str | None) -> bytes:
    """Extract the recording's file from the transferred data and verify it."""
    if published.address.endswith(".zip"):
        data = _tracks(data, published, path)
    if known is not None and sha256(data) != known:
        raise _wrong(published, sha256(data), known)
    if known is None:
        # Its hash will be stored and required from now on, so it must be readable.
        read_files(published, {path.name: data}, published.address)
    return data


def _wrong(published: Source, found: str, known: str) -> FetchError:
    if published.sha256 is not None:
        return FetchError(
            published.address,
            got=f"data with SHA-256 {found}",
            expected=f"the published data with SHA-256 {known}",
            hint="The download was discarded. Run the command again. If that does not help, the "
            "network alters the data, or the publisher has changed them.",
        )
    return FetchError(
        published.address,
        got=f"data with SHA-256 {found}",
        expected=f"data with SHA-256 {known}, as stored at first use",
        hint="The download was discarded, because scores would not be comparable. To use the new "
        f"data, delete {note_of(published.name)} and the day's tracks file, and run the command "
        "again.",
    )


def _tracks(data: bytes, published: Source, path: Path) -> bytes:
    """The text of a day's tracks from a zip archive, in which the file may have any name.

    At most 64 kB of other files are unpacked, and no file name from the archive is used on disk.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [m for m in archive.infolist() if b"TRACK.R" in _unpacked(archive, m, _HEAD)]
            if len(members) == 1:
                tracks = _unpacked(archive, members[0], MAX_TRACKS_BYTES + 1)
    except (
        # The last two: an unknown compression or encryption.
        zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError, struct.error,
        NotImplementedError, RuntimeError,
    ) as error:  # fmt: skip
        raise FetchError(
            published.address,
            got=f"a broken zip ({error})",
            expected="a zip with the day's tracks",
            hint="The download was discarded. Run the command again.",
        ) from error
    if len(members) == 1 and len(tracks) <= MAX_TRACKS_BYTES:
        return tracks
    got = f"a zip with {len(members)} files of tracks"
    raise FetchError(
        published.address,
        got=got if len(members) != 1 else f"tracks of more than {MAX_TRACKS_BYTES} bytes",
        expected="one file with the day's tracks",
        hint=f"Some days have no tracks. If you have them, copy them to {path}, and run "
        f"`crowdbench data import {published.name} --source DIR`.",
    )


def _unpacked(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most: int) -> bytes:
    with archive.open(member) as file:
        return file.read(most)
