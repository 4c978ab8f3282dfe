"""Atomic writing of files, temporary folders, and strict readers for JSON and TOML.

A process that is killed cannot remove its temporary files. It holds a lock on each of them, which
ends with it. So whoever next needs a folder, or writes the same file, removes those of the dead.
"""

import gzip
import hashlib
import os
import re
import secrets
import shutil
import stat
import subprocess
import tempfile
import time
import tomllib
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import platformdirs

from crowdbench.errors import CrowdbenchError, OutputError, did_you_mean

T = TypeVar("T")
_PREFIX = "crowdbench-tmp-"
_YOUNG_S = 1.0  # what was made less than this time ago may not be locked yet
LARGEST_UNPACKED = 2**26  # bytes of a compressed file's content; the largest has 4 million


def home() -> Path:
    """Folder of the imported recordings: `CROWDBENCH_HOME`, else the platform's data folder."""
    named = os.environ.get("CROWDBENCH_HOME")
    return Path(named) if named else Path(platformdirs.user_data_dir("crowdbench"))


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`; rename it to `path` if the block succeeds.

    If the block fails, folders that were created for `path` are removed if they are empty. A link
    stays, and the file that it leads to is replaced.

    Raises:
        OutputError: the folder or the file cannot be written, or `path` is a device, a pipe or a
            folder, which a file would replace.
    """
    path = path.resolve() if path.is_symlink() else path
    if path.exists() and not path.is_file():
        raise OutputError(
            path, got=_kind(path), expected="a file, or no such path", hint="Choose another name."
        )
    temporary = path.parent / f".{path.stem}-{secrets.token_hex(4)}{path.suffix}"
    made: list[Path] = []
    try:
        made = [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        names = f"{re.escape(f'.{path.stem}-')}[0-9a-f]{{8}}{re.escape(path.suffix)}"
        _remove_abandoned(path.parent, names)
        temporary.touch(exist_ok=False)
        try:
            with _held(temporary):
                yield temporary
                temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        with suppress(OSError):  # stops at the first folder that is not empty
            for folder in made:
                folder.rmdir()


@contextmanager
def temporary_folder(what: str, parent: Path | None = None) -> Iterator[Path]:
    """Yield an empty folder, removed at the end of the block.

    It is hidden in `parent`, or in the system's folder for temporary files. What killed processes
    have left there is removed; in `parent`, what has the same name `what`.
    """
    place = parent or Path(tempfile.gettempdir())
    prefix = f".{what}-" if parent else f"{_PREFIX}{what}-"
    _remove_abandoned(place, re.escape(prefix if parent else _PREFIX) + ".*")
    with (
        tempfile.TemporaryDirectory(dir=place, prefix=prefix, ignore_cleanup_errors=True) as name,
        _held(Path(name)),
    ):
        yield Path(name)


def _remove_abandoned(place: Path, names: str) -> None:
    """Remove the temporary files and folders of killed processes, by a pattern of their names."""
    found: list[str] = []
    with suppress(OSError):
        found = [name for name in os.listdir(place) if re.fullmatch(names, name)]
    for path in (place / name for name in found):
        with suppress(OSError):
            if time.time() - path.lstat().st_mtime >= _YOUNG_S:
                with _held(path) as abandoned:
                    if abandoned:
                        shutil.rmtree(path) if path.is_dir() else path.unlink()


@contextmanager
def _held(path: Path) -> Iterator[bool]:
    """Lock a file or folder until the block or this process ends; False if another one does."""
    descriptor = -1
    try:
        import fcntl

        descriptor = os.open(path, os.O_RDONLY)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        held = True
    except (ImportError, OSError):  # on Windows, what a killed process leaves stays
        held = False
    try:
        yield held
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def _kind(path: Path) -> str:
    """What a path is that is no file, in words."""
    kinds = {
        stat.S_IFDIR: "a folder",
        stat.S_IFIFO: "a pipe",
        stat.S_IFSOCK: "a socket",
        stat.S_IFCHR: "a device",
        stat.S_IFBLK: "a device",
    }
    return kinds.get(stat.S_IFMT(path.stat().st_mode), "no file")


def unwritable(path: Path, error: OSError) -> OutputError:
    """Error that states why `path` cannot be written."""
    got = error.strerror or str(error)
    if isinstance(error, FileExistsError | NotADirectoryError):
        got = "a file in place of a folder"
    return OutputError(path, got=got, expected="a writable location", hint="Choose another folder.")


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8) to `path` atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode())


def write_json(path: Path, value: Any, *, compact: bool = False) -> None:
    """Write `value` as JSON, indented or on one line. Equal values give identical bytes.

    A file whose name ends in .gz is compressed, and has one line.
    """
    encoded = msgspec.json.encode(value, order="deterministic")
    packs = path.suffix == ".gz"
    if not (compact or packs):
        encoded = msgspec.json.format(encoded, indent=1)
    with replacing(path) as temporary:
        data = encoded + b"\n"
        temporary.write_bytes(gzip.compress(data, 9, mtime=0) if packs else data)


def read_bytes(path: Path, error: type[CrowdbenchError], hint: str) -> bytes:
    """Content of the file `path`, unpacked if its name ends in .gz; raises `error` without one.

    Pipes and devices are errors: they may never end.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # `hint` tells how to mend a file
            got, what = _kind(path), "Name a file in it." if path.is_dir() else "Name a file."
            raise error(path, got=got, expected="a file", hint=what)
        data = path.read_bytes()
    except OSError as cause:
        got = "no such file" if isinstance(cause, FileNotFoundError) else str(cause.strerror)
        raise error(path, got=got, expected="a readable file", hint=hint) from cause
    return _unpacked(data, path, error, hint) if path.suffix == ".gz" else data


def _unpacked(data: bytes, path: Path, error: type[CrowdbenchError], hint: str) -> bytes:
    """The content of a gzip file, which may come from strangers: no more is unpacked than fits."""
    reader = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        content = reader.decompress(data, LARGEST_UNPACKED)
    except zlib.error as cause:
        raise error(path, got=str(cause), expected="a gzip file", hint=hint) from cause
    if not reader.eof or reader.unused_data:
        got = "a gzip file that is cut, too large, or followed by other bytes"
        expected = f"one gzip stream of at most {LARGEST_UNPACKED / 1e6:.0f} MB, unpacked"
        raise error(path, got=got, expected=expected, hint=hint)
    return content


def read_struct(path: Path, kind: type[T], error: type[CrowdbenchError], hint: str) -> T:
    """Read a JSON (also .json.gz) or TOML file as an object of type `kind`.

    Raises:
        error: the file is missing, is not valid JSON or TOML, or has unknown, missing or mistyped
            fields.
    """
    data = read_bytes(path, error, hint)
    try:
        raw = tomllib.loads(data.decode()) if path.suffix == ".toml" else msgspec.json.decode(data)
    except (ValueError, RecursionError) as cause:  # not UTF-8, not JSON or TOML, or nested deeply
        kind_of_file = "TOML" if path.suffix == ".toml" else "JSON"
        raise error(path, got=str(cause), expected=f"valid {kind_of_file}", hint=hint) from cause
    try:
        # Three conversions are allowed: integers to floats (TOML files often state 1 for 1.0),
        # lists to tuples, and text keys to other types.
        return msgspec.convert(raw, kind, strict=True, str_keys=True)
    except (msgspec.ValidationError, OverflowError) as cause:
        expected = "the fields that its format defines"
        raise error(
            path, got=str(cause), expected=expected, hint=_nearest_field(str(cause), kind, hint)
        ) from cause


def _nearest_field(message: str, kind: Any, hint: str) -> str:
    """The hint, after the field most like an unknown one that msgspec's message names."""
    found = re.search(r"unknown field `(.*?)`", message)
    if found is None:
        return hint
    _, tables = msgspec.json.schema_components([kind])
    known = {name for table in tables.values() for name in table.get("properties", {})}
    return did_you_mean(found[1], sorted(known - {found[1]}), hint)


def sha256(data: bytes) -> str:
    """Hexadecimal SHA-256 of `data`."""
    return hashlib.sha256(data).hexdigest()


def revision(folder: Path) -> str:
    """Git revision of a folder, with `-dirty` if files were changed; empty outside git."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--abbrev=12", "--dirty"],
            capture_output=True,
            text=True,
            check=False,
        )
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
