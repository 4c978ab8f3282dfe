"""A file from an address, in a transfer that goes on where an earlier one broke off."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.errors import FetchError
from crowdbench.files import unwritable

if TYPE_CHECKING:
    import requests

TIMEOUT_S = 30.0
"""How long a server may say nothing."""
TRIES = 3
PAUSE_S = 0.5
"""Before the second try; twice as long before each further one."""
MAX_BYTES = 1 << 28
"""More than any recording: whatever sends more sends something else."""
_CHUNK = 1 << 13  # what is lost at most when a line breaks
_OFFLINE = "See whether this machine can reach the address, and run the command again."

Progress = Callable[[int, int | None], None]
"""Called with the bytes that are there, and with those of the whole file where they are known."""


def download(address: str, part: Path, progress: Progress) -> None:
    """Bring the file at `address` into `part`, and go on from the bytes that are already in it.

    A server that knows no ranges sends all of it anew. What came before an error or an interrupt
    stays in `part` for the next call.

    Raises:
        FetchError: the address cannot be reached or answers with something else, or the transfer
            broke off three times.
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
        respect_retry_after_header=False,  # it may ask for hours
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
                address, got=_reason(error), expected="an answer", hint=_OFFLINE
            ) from error
        except OSError as error:
            raise unwritable(part, error) from error
    raise FetchError(
        address,
        got=f"a transfer that broke off {TRIES} times, {_size(part)} bytes so far",
        expected="the whole file",
        hint="Run the command again: it goes on from there, if the server can.",
    )


def _whole(session: "requests.Session", address: str, part: Path, progress: Progress) -> bool:
    """One transfer into `part`; whether it is whole then."""
    import requests

    have = _size(part)
    headers = {"Accept-Encoding": "identity"}  # ranges count the bytes of what is sent
    if have:
        headers["Range"] = f"bytes={have}-"
    with session.get(address, headers=headers, stream=True, timeout=TIMEOUT_S) as answer:
        span = answer.headers.get("Content-Range", "")
        if answer.status_code == 416 and span == f"bytes */{have}":
            return True
        if answer.status_code == 416 or (
            answer.status_code == 206 and not span.startswith(f"bytes {have}-")
        ):
            part.unlink(missing_ok=True)  # of another file than the one that is there now
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
            got=f"the answer {answer.status_code} {answer.reason}".rstrip(),
            expected="a file",
            hint="It may have moved, or the server may be out of order for a while: look at the "
            "address in a browser.",
        )
    if answer.headers.get("Content-Type", "").startswith("text/html"):
        raise FetchError(
            address,
            got="an HTML page",
            expected="a file of data",
            hint="A network that asks to log in answers like that: look at the address in a "
            "browser.",
        )


def _too_large(address: str) -> FetchError:
    return FetchError(
        address, got=f"more than {MAX_BYTES} bytes", expected="a recording, which is smaller"
    )


def _size(part: Path) -> int:
    return part.stat().st_size if part.exists() else 0


def _reason(error: Exception) -> str:
    """What lies at the bottom: requests wraps it several times."""
    below: object = error
    while isinstance(below, Exception):
        error = below
        below = getattr(error, "reason", None) or next(iter(error.args), None)
    return str(error).rpartition(": ")[2] or type(error).__name__
