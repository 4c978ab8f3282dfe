"""Download of a file."""

from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from crowdbench.errors import FetchError

if TYPE_CHECKING:
    import requests

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


def download(address: str, progress: Progress) -> bytes:
    """The content of the file at `address`.

    An interrupted transfer begins again, because recordings have a few megabytes only.

    Raises:
        FetchError: the address cannot be reached or sends something else, or the transfer was
            interrupted three times.
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
        for _ in range(TRIES):
            try:
                answer = session.get(address, stream=True, timeout=TIMEOUT_S)
            except requests.RequestException as error:
                raise FetchError(
                    address,
                    got=_reason(error),
                    expected="a response",
                    hint="Check that this machine can reach the address, and run the command "
                    "again.",
                ) from error
            with answer, suppress(requests.RequestException):
                return _content(answer, address, progress)
    raise FetchError(
        address,
        got=f"a transfer that was interrupted {TRIES} times",
        expected="the whole file",
        hint="Run the command again.",
    )


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
        raise FetchError(
            address,
            got="an HTML page",
            expected="a data file",
            hint="The network may require a login: open the address in a browser.",
        )
    length = answer.headers.get("Content-Length", "")
    data = bytearray()
    for chunk in answer.iter_content(_CHUNK):
        data += chunk
        if len(data) > MAX_BYTES:
            raise FetchError(
                address,
                got=f"more than {MAX_BYTES} bytes",
                expected="a recording, which is smaller",
            )
        progress(len(data), int(length) if length.isdecimal() else None)
    return bytes(data)


def _reason(error: Exception) -> str:
    """The message of the innermost error; requests wraps it several times."""
    below: object = error
    while isinstance(below, Exception):
        error = below
        below = getattr(error, "reason", None) or next(iter(error.args), None)
    return str(error).rpartition(": ")[2] or type(error).__name__
