"""Hashes of recordings whose publisher states none: noted when one is first imported.

From then on other data under the same name are refused.
"""

from pathlib import Path

import msgspec

from crowdbench.errors import RecordingError
from crowdbench.files import home, read_struct, write_json


class _Note(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    sha256: str
    address: str


def note_of(name: str) -> Path:
    """Where the note of a recording lies (or would lie)."""
    return home() / "recordings" / f"{name}.json"


def noted(name: str) -> str | None:
    """The SHA-256 that was noted of a recording's data; None before the first use.

    Raises:
        RecordingError: the note is broken.
    """
    path = note_of(name)
    if not path.exists():
        return None
    hint = "Delete it, and import the recording again."
    return read_struct(path, _Note, RecordingError, hint).sha256


def note(name: str, sha256: str, address: str) -> None:
    """Note the hash of a recording's data and where they were published.

    Raises:
        OutputError: the note cannot be written.
    """
    write_json(note_of(name), _Note(sha256, address))
