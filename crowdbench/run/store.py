"""The store of rollouts and their summaries, which all evaluations of a user share.

It is the folder `rollouts` of `CROWDBENCH_HOME`. A rollout's key is the hash of everything that it
depends on (`Resolved.fingerprint`), its fit and its seed, never its name. That of its summary adds
the blocks of time, the metrics and their code (`code_of_summaries`). A file's name holds the key
and the hash of its content, so that a damaged file is not used. Files whose keys begin alike share
a folder, because searching a folder takes as long as it has files. The store may be deleted at any
time. Several processes may use it at once: files are renamed when they are complete.

With `CROWDBENCH_STORE=read` nothing is added to it: what runs in a sandbox must not. Then, and if
it cannot be written, files are kept beside the results.
"""

import os
from contextlib import suppress
from pathlib import Path

from crowdbench.errors import OutputError
from crowdbench.files import home, replacing, sha256

LIMIT_BYTES = 4 * 2**30
"""Size of all files; a rollout of Grand Central has 7.5 MB."""


def folder() -> Path:
    """The folder of the store."""
    return home() / "rollouts"


def find(key: str, suffix: str, beside: Path | None = None) -> Path | None:
    """The file of a key, in the store or in the folder `beside`; None if there is none.

    A damaged file is removed.
    """
    name = f"{key}-*{suffix}"
    for path in (*_place(key).glob(name), *(beside.glob(name) if beside else ())):
        with suppress(OSError):
            if path.stem == f"{key}-{sha256(path.read_bytes())[:32]}":
                with suppress(OSError):  # a sandbox may only read
                    path.touch()
                return path
        with suppress(OSError):
            path.unlink()
    return None


def keep(key: str, suffix: str, data: bytes, beside: Path | None = None) -> None:
    """Keep the content of a file under its key, if that is possible; see `find`."""
    places = [*([_place(key)] if _writable() else []), *([beside] if beside else [])]
    for place in places:
        with suppress(OutputError, OSError):
            with replacing(place / f"{key}-{sha256(data)[:32]}{suffix}") as temporary:
                temporary.write_bytes(data)
            return


def clean() -> None:
    """Remove the files that were used least recently if all have more than `LIMIT_BYTES`.

    It looks at all files, so it is called once for many rollouts.
    """
    if not _writable():
        return
    files = []
    for path in folder().rglob("*"):  # also what killed processes have left
        with suppress(OSError):  # another process removes files too
            if path.is_file():
                stat = path.stat()
                files.append((stat.st_mtime_ns, stat.st_size, path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= LIMIT_BYTES:
            return
        with suppress(OSError):
            path.unlink()
        total -= size


def _place(key: str) -> Path:
    return folder() / key[:2]


def _writable() -> bool:
    return os.environ.get("CROWDBENCH_STORE") != "read"
