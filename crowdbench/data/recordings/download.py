"""Resumable download of a file."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.errors import FetchError
from crowdbench.files import unwritable

if TYPE_CHECKING:
    import requests

TIMEOUT_S = 30.0
"""Time after which a server that sends nothing counts as unreachable."""
TRIES = 3
PAUSE_S = 0.5
"""Pause before the second attempt; it doubles before each further attempt."""
MAX_BYTES = 1 << 28
"""Maximum size of a download; every published recording is smaller."""
_CHUNK = 1 << 13  # bytes that are lost at most when the connection breaks
_OFFLINE = "Check that this machine can reach the address, and run the command again."

Progress = Callable[[int, int | None], None]
"""Called with the number of bytes received so far, and the size of the file or None if unknown."""


def download(address: str, part: Path, progress: Progress) -> None:
    """Download the file at `address` to `part`, and continue from the bytes that it already has.

    A server without support for ranges sends the whole file again. Data received before an error
    or an interrupt stay in `part` for the next call.

    Raises:
        FetchError: the address cannot be reached or sends something else, or the transfer was
            interrupted three times.
        OutputError: `part` cannot be written.
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
        session.mount("http://", HTTPAdapter(max_retries=retry))
        session.mount("https://", HTTPAdapter(max_retries=retry))
        try:
            part.parent.mkdir(parents=True, exist_ok=True)
            for _ in range(TRIES):
                if _whole(session, address, part, progress):
                    return
        except requests.RequestException as error:
            raise FetchError(
                address, got=_reason(error), expected="a response", hint=_OFFLINE
            ) from error
        except OSError as error:
            raise unwritable(part, error) from error
    raise FetchError(
        address,
        got=f"a transfer that was interrupted {TRIES} times, after {_size(part)} bytes",
        expected="the whole file",
        hint="Run the command again: it continues from there if the server supports it.",
    )


def _whole(session: "requests.Session", address: str, part: Path, progress: Progress) -> bool:
    """Transfer the rest of the file to `part` once; returns whether the file is complete."""
    import requests

    have = _size(part)
    headers = {"Accept-Encoding": "identity"}  # ranges refer to the bytes as sent
    if have:
        headers["Range"] = f"bytes={have}-"
    with session.get(address, headers=headers, stream=True, timeout=TIMEOUT_S) as answer:
        span = answer.headers.get("Content-Range", "")
        if answer.status_code == 416 and span == f"bytes */{have}":
            return True
        if answer.status_code == 416 or (
            answer.status_code == 206 and not span.startswith(f"bytes {have}-")
        ):
            part.unlink(missing_ok=True)  # the bytes in it belong to another file
            return False
        _check(answer, address)
        if answer.status_code == 200:
            have = 0
        length = answer.headers.get("Content-Length", "")
        total = have + int(length) if length.isdecimal() else None
        with part.open("ab" if have else "wb") as file:
            try:
                for chunk in answer.iter_content(_CHUNK):
                    file.write(chunk)
                    have += len(chunk)
                    progress(have, total)
                    if have > MAX_BYTES:
                        file.truncate(0)
                        raise _too_large(address)
            except requests.RequestException:
                return False
    return total is None or have == total


def _check(answer: "requests.Response", address: str) -> None:
    if answer.status_code not in (200, 206):
        raise FetchError(
            address,
            got=f"the response {answer.status_code} {answer.reason}".rstrip(),
            expected="a file",
            hint="The file may have moved, or the server may be temporarily unavailable: open the "
            "address in a browser.",
        )
    if answer.headers.get("Content-Type", "").startswith("text/html"):
        raise FetchError(
            address,
            got="an HTML page",
            expected="a data file",
            hint="The network may require a login: open the address in a browser.",
        )


def _too_large(address: str) -> FetchError:
    return FetchError(
        address, got=f"more than {MAX_BYTES} bytes", expected="a recording, which is smaller"
    )


def _size(part: Path) -> int:
    return part.stat().st_size if part.exists() else 0


def _reason(error: Exception) -> str:
    """The message of the innermost error; requests wraps it several times."""
    below: object = error
    while isinstance(below, Exception):
        error = below
        below = getattr(error, "reason", None) or next(iter(error.args), None)
    return str(error).rpartition(": ")[2] or type(error).__name__
