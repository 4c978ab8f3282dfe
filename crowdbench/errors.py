"""Errors caused by user input.

Each message states where the error occurred, what was found, what was expected and how to fix it.
The command line prints the message and exits with code 2.
"""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

_CONSTRAINTS = Path(__file__).parents[1] / "constraints.txt"  # in a clone; a wheel has none


def to_install(extras: str, venv: str = "") -> str:
    """Hint that says how to install extras of crowdbench, in a clone or from a wheel.

    Args:
        extras: such as `fit,onnx`.
        venv: folder of a new virtual environment for them; by default, the present one.
    """
    pip = f"python -m venv {venv} && {venv}/bin/pip install" if venv else "pip install"
    if _CONSTRAINTS.is_file():
        return f'Run in the clone: {pip} -c constraints.txt -e ".[{extras}]".'
    if venv:
        return f'Run {pip} "WHEEL[{extras}]", where WHEEL is the file of crowdbench\'s wheel.'
    return f'Run {pip} "crowdbench[{extras}]".'


class CrowdbenchError(Exception):
    """Base class of all errors caused by invalid input or settings."""

    def __init__(self, where: object, *, got: str, expected: str, hint: str = "") -> None:
        self.where = str(where)
        self.got = got
        self.expected = expected
        self.hint = hint
        message = f"{self.where}: got {got}; expected {expected}."
        super().__init__(f"{message} {hint}".rstrip())

    def __reduce__(self) -> tuple[object, ...]:
        # Worker processes send errors to their parent, and exceptions with keyword-only arguments
        # cannot be pickled by default.
        told = {"got": self.got, "expected": self.expected, "hint": self.hint}
        return partial(type(self), **told), (self.where,)


def did_you_mean(name: object, known: Iterable[str], hint: str = "") -> str:
    """A hint that suggests the known name most like `name`, if one is, followed by `hint`."""
    found = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.6)
    return " ".join([*(f"Did you mean `{near}`?" for near in found), hint]).rstrip()


@contextmanager
def hinting(hint: str) -> Iterator[None]:
    """Add a hint to errors that have none: what reads a file need not know where it is from."""
    try:
        yield
    except CrowdbenchError as error:
        if error.hint:
            raise
        kind = type(error)
        raise kind(error.where, got=error.got, expected=error.expected, hint=hint) from error


class RecordingError(CrowdbenchError):
    """A recording or table of trajectories cannot be read or does not fit."""


class FetchError(CrowdbenchError):
    """A published recording cannot be downloaded."""


class SceneError(CrowdbenchError):
    """A scene does not exist or its files are invalid."""


class WeightsError(CrowdbenchError):
    """Fitted weights are missing or invalid, or belong to another scene or model."""


class OutputError(CrowdbenchError):
    """A file or folder cannot be written."""


class SettingError(CrowdbenchError):
    """A name or option does not exist, or a value is out of range."""


class WorkerError(CrowdbenchError):
    """A worker process ended before its work was complete."""


class OwnCodeError(CrowdbenchError):
    """A user-supplied class or function raised an exception."""


class ActionError(CrowdbenchError):
    """Actions do not match the agents present."""


class CapacityError(CrowdbenchError):
    """There are more people than slots or ids."""
