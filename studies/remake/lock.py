"""`results.lock`: what the results in the repository were made from, one result a line."""

from collections.abc import Mapping
from pathlib import Path

import msgspec

from crowdbench.errors import SettingError
from crowdbench.files import read_bytes, sha256, write_text

LOCK = Path("results.lock")


class Line(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What the lock knows of a result."""

    name: str
    inputs: dict[str, str]
    """Hashes by name."""
    outputs: str
    """Hash of all outputs."""
    cpu_s: float | None = None
    """CPU time of making it, seconds; None if it was not made by the graph."""
    kept: str = ""
    """Why it was not made again when an input changed."""
    numbers: dict[str, float] = {}
    """Its headline numbers."""


def read_lock(path: Path) -> dict[str, Line]:
    """The lines of a lock by name of result; none if there is no file.

    Raises:
        SettingError: it is broken.
    """
    if not path.exists():
        return {}
    lines = read_bytes(path, SettingError, "").splitlines()
    try:
        found = [msgspec.json.decode(line, type=Line) for line in lines]
    except msgspec.DecodeError as error:
        raise SettingError(
            path, got=str(error), expected="one result per line", hint="Take it from git again."
        ) from error
    return {line.name: line for line in found}


def write_lock(lines: Mapping[str, Line], path: Path) -> None:
    """Write a lock, in the order of names."""
    encoded = (msgspec.json.encode(lines[name], order="deterministic") for name in sorted(lines))
    write_text(path, "".join(f"{line.decode()}\n" for line in encoded))


def file_hash(path: Path, tables_only: bool = False) -> str:
    """Hash of a file, or of the tables in a Markdown page."""
    data = path.read_bytes() if path.exists() else b"missing"
    if tables_only and path.suffix == ".md":
        data = b"\n".join(line for line in data.splitlines() if line.startswith(b"|"))
    return sha256(data)
