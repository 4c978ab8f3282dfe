"""Hashes of recordings whose publisher states none, stored when a recording is first imported.

From then on, other data under the same name are rejected.
"""

from pathlib import Path

import msgspec

from crowdbench.errors import RecordingError
from crowdbench.files import home, read_struct, write_json


class _Note(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    sha256: str
    address: str


def note_of(name: str) -> Path:
    """Path of the file that holds the stored hash of a recording, whether it exists or not."""
    return home() / "recordings" / f"{name}.json"


def noted(name: str) -> str | None:
    """The stored SHA-256 of a recording's data; None before the first import.

    Raises:
        RecordingError: the file with the stored hash is broken.
    """
    path = note_of(name)
    if not path.exists():
        return None
    hint = "Delete it, and import the recording again."
    return read_struct(path, _Note, RecordingError, hint).sha256


def note(name: str, sha256: str, address: str) -> None:
    """Store the hash of a recording's data and the address where they were published.

    Raises:
        OutputError: the file cannot be written.
    """
    write_json(note_of(name), _Note(sha256, address))
