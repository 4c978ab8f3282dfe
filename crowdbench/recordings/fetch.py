"""Published recordings, fetched into a folder in OpenTraj's layout."""

import io
import lzma
import shlex
import struct
import zipfile
import zlib
from pathlib import Path

from crowdbench.errors import FetchError, RecordingError
from crowdbench.files import home, replacing, sha256
from crowdbench.recordings.catalogue import (
    COMMIT,
    REPOSITORY,
    Source,
    known_sha256,
    read_files,
    sha256_in,
    source,
)
from crowdbench.recordings.download import Progress, download
from crowdbench.recordings.first_use import note_of

MAX_TRACKS_BYTES = 1 << 26
"""Ten times the tracks of the busiest day."""
_HEAD = 1 << 16
"""Bytes of a file in which its first track begins."""


def default_folder() -> Path:
    """Where recordings are fetched to if no folder is named."""
    return home() / "OpenTraj"


def fetch(name: str, folder: Path, progress: Progress = lambda *_: None) -> bool:
    """Bring a recording's file to its place in `folder`; whether anything had to be transferred.

    A file that is there and right is left alone, one that is not right is replaced. What is
    transferred comes to a file beside it, ending in .part, which stays when a transfer breaks off
    and goes when it was whole; nothing wrong comes under the name of the file.

    Raises:
        SettingError: there is no recording of that name.
        FetchError: the file cannot be had, or is not the one that was published; of `gc`, which
            has no file of its own to fetch, the error says what to run.
        RecordingError: the data are no recording.
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
    part = path.with_name(f"{path.name}.part")
    download(published.address, part, progress)
    try:
        data = _checked(part.read_bytes(), published, path, known)
    except (FetchError, RecordingError):
        part.unlink()
        raise
    with replacing(path) as temporary:
        temporary.write_bytes(data)
    part.unlink()
    return True


def git_commands(published: Source, folder: Path, repository: str, commit: str) -> list[str]:
    """Shell commands that check out only a recording's folder, only as of the pinned commit."""
    git = ["git", "-C", str(folder)]
    return [
        shlex.join(command)
        for command in (
            ["git", "init", "--quiet", str(folder)],
            [*git, "remote", "add", "origin", repository],
            [*git, "sparse-checkout", "set", published.path],
            [*git, "fetch", "--depth", "1", "--filter=blob:none", "origin", commit],
            # Converted line ends would change the hash.
            [*git, "-c", "core.autocrlf=false", "checkout", "--detach", commit],
        )
    ]


def _by_git(published: Source, folder: Path) -> FetchError:
    hint = "Name another folder with --out: this one has a repository in it."
    if not (folder / ".git").exists():
        bring = ["crowdbench", "data", "import", published.name, "--source", str(folder)]
        commands = [*git_commands(published, folder, REPOSITORY, COMMIT), shlex.join(bring)]
        hint = "Run\n\n" + "".join(f"  {command}\n" for command in commands)
    return FetchError(
        f"recording {published.name}",
        got="thousands of files without an address for all, so nothing was fetched",
        expected="a checkout of their folder with git",
        hint=hint,
    )


def _checked(data: bytes, published: Source, path: Path, known: str | None) -> bytes:
    """The recording's file out of what was transferred, if it is the right one."""
    if published.address.endswith(".zip"):
        data = _tracks(data, published, path)
    if known is not None and sha256(data) != known:
        raise _wrong(published, sha256(data), known)
    if known is None:
        # It will be known by this hash from now on: what cannot be read must not be.
        read_files(published, {path.name: data}, published.address)
    return data


def _wrong(published: Source, found: str, known: str) -> FetchError:
    if published.sha256 is not None:
        return FetchError(
            published.address,
            got=f"data of SHA-256 {found}",
            expected=f"the published ones, SHA-256 {known}",
            hint="They are dropped. Run the command again; if that does not help, something on "
            "the way alters them, or they are no longer what they were.",
        )
    return FetchError(
        published.address,
        got=f"data of SHA-256 {found}",
        expected=f"SHA-256 {known}, as noted at first use",
        hint="They are dropped: scores would not be comparable. If you want the new ones, delete "
        f"{note_of(published.name)} and the day's tracks file, and run the command again.",
    )


def _tracks(data: bytes, published: Source, path: Path) -> bytes:
    """The text of a day's tracks out of a zip, whatever its name there is.

    Of other files no more than 64 kB are unpacked, and nothing goes to the disk by its own name.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [m for m in archive.infolist() if b"TRACK.R" in _unpacked(archive, m, _HEAD)]
            if len(members) == 1:
                tracks = _unpacked(archive, members[0], MAX_TRACKS_BYTES + 1)
    except (
        # The last two: compressed or encrypted in a way that is not known.
        zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError, struct.error,
        NotImplementedError, RuntimeError,
    ) as error:  # fmt: skip
        raise FetchError(
            published.address,
            got=f"a broken zip ({error})",
            expected="a zip with the day's tracks",
            hint="It is dropped. Run the command again.",
        ) from error
    if len(members) == 1 and len(tracks) <= MAX_TRACKS_BYTES:
        return tracks
    got = f"a zip with {len(members)} files of tracks"
    raise FetchError(
        published.address,
        got=got if len(members) != 1 else f"tracks of more than {MAX_TRACKS_BYTES} bytes",
        expected="one file with the day's tracks",
        hint=f"Some days have none. If you have the tracks, bring them to {path}, and run "
        f"`crowdbench data import {published.name} --source DIR`.",
    )


def _unpacked(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most: int) -> bytes:
    with archive.open(member) as file:
        return file.read(most)
