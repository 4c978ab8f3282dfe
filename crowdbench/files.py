"""Files that are either whole or absent, and strict readers of JSON and TOML."""

import hashlib
import os
import secrets
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import platformdirs

from crowdbench import leftovers
from crowdbench.errors import CrowdbenchError, OutputError

T = TypeVar("T")


def home() -> Path:
    """The user's folder of imported recordings: `CROWDBENCH_HOME` or the platform's own."""
    named = os.environ.get("CROWDBENCH_HOME")
    return Path(named) if named else Path(platformdirs.user_data_dir("crowdbench"))


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` when the block succeeds.

    Where it does not, folders that were made for `path` go too, if nothing else is in them.

    Raises:
        OutputError: the folder or the file cannot be written.
    """
    temporary = path.parent / f".{path.stem}-{secrets.token_hex(4)}{path.suffix}"
    made: list[Path] = []
    try:
        made = [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        with leftovers.temporary(temporary):
            try:
                temporary.touch(exist_ok=False)
                yield temporary
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        with suppress(OSError):  # the first that holds something ends it
            for folder in made:
                folder.rmdir()


def unwritable(path: Path, error: OSError) -> OutputError:
    """The error of a place that cannot be written to."""
    got = error.strerror or str(error)
    if isinstance(error, FileExistsError | NotADirectoryError):
        got = "a file where a folder should be"
    return OutputError(
        path, got=got, expected="a place that can be written", hint="Name another folder."
    )


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8) to `path`, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode())


def write_json(path: Path, value: Any, *, compact: bool = False) -> None:
    """Write `value` as JSON, indented or on one line: the same value gives the same bytes."""
    encoded = msgspec.json.encode(value, order="deterministic")
    if not compact:
        encoded = msgspec.json.format(encoded, indent=1)
    write_text(path, encoded.decode() + "\n")


def read_bytes(path: Path, error: type[CrowdbenchError], hint: str) -> bytes:
    """The bytes of `path`; raises `error` where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as cause:
        got = "no such file" if isinstance(cause, FileNotFoundError) else str(cause.strerror)
        raise error(path, got=got, expected="a readable file", hint=hint) from cause


def read_struct(path: Path, kind: type[T], error: type[CrowdbenchError], hint: str) -> T:
    """Read a JSON or TOML file strictly into `kind`: unknown, missing and mistyped fields raise.

    Raises:
        error: the file is missing, is no JSON or TOML, or does not have the fields of `kind`.
    """
    data = read_bytes(path, error, hint)
    try:
        raw = tomllib.loads(data.decode()) if path.suffix == ".toml" else msgspec.json.decode(data)
    except (ValueError, RecursionError) as cause:  # no text, no JSON or TOML, or nested deeply
        kind_of_file = path.suffix.lstrip(".").upper()
        raise error(path, got=str(cause), expected=f"valid {kind_of_file}", hint=hint) from cause
    try:
        # TOML writes 1 for 1.0, JSON has no tuples, and keys of both are text: the conversions of
        # these are wanted.
        return msgspec.convert(raw, kind, strict=True, str_keys=True)
    except (msgspec.ValidationError, OverflowError) as cause:
        raise error(
            path, got=str(cause), expected="the fields that its format defines", hint=hint
        ) from cause


def sha256(data: bytes) -> str:
    """Hexadecimal SHA-256 of `data`."""
    return hashlib.sha256(data).hexdigest()
