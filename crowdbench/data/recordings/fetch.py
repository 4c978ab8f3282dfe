"""Downloads published recordings into a folder in OpenTraj's layout."""

import io
import lzma
import shlex
import struct
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.data.recordings import catalogue
from crowdbench.errors import FetchError
from crowdbench.files import home, replacing, sha256

if TYPE_CHECKING:
    import requests

MAX_TRACKS_BYTES = 1 << 26
"""Maximum size of an unpacked tracks file; ten times that of the busiest day."""
_HEAD = 1 << 16  # bytes at the beginning of a file in which the first track must begin
TIMEOUT_S = 30.0
"""Time after which a server that sends nothing counts as unreachable."""
TRIES = 3
PAUSE_S = 0.5
"""Pause before the second attempt; it doubles before each further attempt."""
MAX_BYTES = 1 << 28
"""Maximum size of a download; every published recording is smaller."""
_CHUNK = 1 << 16

Progress = Callable[[int, int | None], None]
"""Called with the number of bytes received so far, and the size of the file or None if unknown."""


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
    published = catalogue.source(name)
    known = catalogue.known_sha256(published)
    there = catalogue.sha256_in(published, folder)
    if there is not None and known in (None, there):
        return False
    if published.format == "gc":
        raise _by_git(published, folder)
    path = folder / published.path
    with replacing(path) as temporary:  # before the download: the folder can be written
        data = _download(published.address, progress)
        if published.address.endswith(".zip"):
            data = _tracks(data, published, path)
        hint = "The download was discarded. Run the command again. If that does not help, the "
        hint += "network alters the data, or the publisher has changed them."
        also = " and the day's tracks file, and run the command again"
        catalogue.verify(published, sha256(data), published.address, FetchError, hint, also)
        if known is None:
            # Its hash will be stored and required from now on, so it must be readable.
            catalogue.read_files(published, {path.name: data}, published.address)
        temporary.write_bytes(data)
    return True


def git_commands(
    published: catalogue.Source, folder: Path, repository: str, commit: str
) -> list[str]:
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


def _by_git(published: catalogue.Source, folder: Path) -> FetchError:
    hint = "Choose another folder with --out: this one contains a git repository."
    if not (folder / ".git").exists():
        bring = ["crowdbench", "data", "import", published.name, "--source", str(folder)]
        commands = [
            *git_commands(published, folder, catalogue.REPOSITORY, catalogue.COMMIT),
            shlex.join(bring),
        ]
        hint = "Run\n\n" + "".join(f"  {command}\n" for command in commands)
    got = "thousands of files that cannot be downloaded as one, so nothing was downloaded"
    expected = "a checkout of their folder with git"
    return FetchError(f"recording {published.name}", got=got, expected=expected, hint=hint)


def _tracks(data: bytes, published: catalogue.Source, path: Path) -> bytes:
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


def _download(address: str, progress: Progress) -> bytes:
    """The content of the file at `address`.

    An interrupted transfer begins again, because recordings have a few megabytes only.
    """
    import requests
    from requests.adapters import HTTPAdapter
    from urllib3.util import Retry

    retry = Retry(
        TRIES - 1,
        backoff_factor=PAUSE_S,
        status_forcelist=(502, 503, 504),
        raise_on_status=False,
        respect_retry_after_header=False,  # it may be hours
    )
    with requests.Session() as session:
        for scheme in ("http://", "https://"):
            session.mount(scheme, HTTPAdapter(max_retries=retry))
        for _ in range(TRIES):
            try:
                answer = session.get(address, stream=True, timeout=TIMEOUT_S)
            except requests.RequestException as error:
                got = _reason(error)
                hint = "Check that this machine can reach the address, and run the command again."
                raise FetchError(address, got=got, expected="a response", hint=hint) from error
            with answer, suppress(requests.RequestException):
                return _content(answer, address, progress)
    got = f"a transfer that was interrupted {TRIES} times"
    raise FetchError(address, got=got, expected="the whole file", hint="Run the command again.")


def _content(answer: "requests.Response", address: str, progress: Progress) -> bytes:
    if answer.status_code != 200:
        raise FetchError(
            address,
            got=f"the response {answer.status_code} {answer.reason}".rstrip(),
            expected="a file",
            hint="The file may have moved, or the server may be temporarily unavailable: open the "
            "address in a browser.",
        )
    if answer.headers.get("Content-Type", "").startswith("text/html"):
        hint = "The network may require a login: open the address in a browser."
        raise FetchError(address, got="an HTML page", expected="a data file", hint=hint)
    length = answer.headers.get("Content-Length", "")
    data = bytearray()
    for chunk in answer.iter_content(_CHUNK):
        data += chunk
        if len(data) > MAX_BYTES:
            got = f"more than {MAX_BYTES} bytes"
            raise FetchError(address, got=got, expected="a recording, which is smaller")
        progress(len(data), int(length) if length.isdecimal() else None)
    return bytes(data)


def _reason(error: Exception) -> str:
    """The message of the innermost error; requests wraps it several times."""
    below: object = error
    while isinstance(below, Exception):
        error = below
        below = getattr(error, "reason", None) or next(iter(error.args), None)
    return str(error).rpartition(": ")[2] or type(error).__name__
