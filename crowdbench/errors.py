"""Errors caused by user input.

Each message states where the error occurred, what was found, what was expected and how to fix it.
The command line prints the message and exits with code 2.

Without `checked`, an argument of a wrong type fails somewhere inside (`'NoneType' object has no
attribute 'start'`). Only what users call is checked, not what is called in each step.
"""

import difflib
import functools
import importlib
import inspect
import operator
import sys
import types
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

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


F = TypeVar("F", bound=Callable[..., Any])
LONGEST = 60
"""Longest representation of a value in a message."""


def checked(*undefined: str) -> Callable[[F], F]:
    """Decorate a function, or a class with fields, so that its arguments are checked.

    `undefined` names types that the function's module imports for type checkers only, each as
    `module:name`. Integers of numpy are integers, and its numbers are numbers; booleans are
    neither. Arguments without an annotation, and those in `**settings`, are not checked.

    The decorated function raises a SettingError that names the argument, its value and its type.
    """

    def decorate(what: F) -> F:
        if isinstance(what, type):
            what.__init__ = _checked(what.__init__, what.__name__, undefined)  # type: ignore[misc]
            return what
        name = what.__qualname__.removesuffix(".__init__")
        return _checked(what, name, undefined)  # type: ignore[return-value]

    return decorate


def _checked(
    function: Callable[..., Any], name: str, undefined: tuple[str, ...]
) -> Callable[..., Any]:
    signature = inspect.signature(function)

    @functools.cache
    def check(of: str) -> tuple[Any, Callable[[object], bool]]:
        hint = _hint(function, signature.parameters[of], undefined)
        return hint, _check_of(hint)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        for of, value in signature.bind(*args, **kwargs).arguments.items():
            hint, fits = check(of)
            if not fits(value):
                known = _names(hint)
                raise SettingError(
                    f"{name}({of}=…)",
                    got=in_words(value),
                    expected=" or ".join(known),
                    hint=did_you_mean(value, [k.strip("'") for k in known if k.startswith("'")]),
                )
        return function(*args, **kwargs)

    return call


def _hint(
    function: Callable[..., Any], parameter: inspect.Parameter, undefined: tuple[str, ...]
) -> Any:
    """The type of a parameter; Any if it has none, or takes several arguments."""
    hint = parameter.annotation
    several = parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    if hint is parameter.empty or several:
        return Any
    if not isinstance(hint, str):
        return hint
    known = dict(vars(sys.modules[function.__module__]))
    for path in undefined:
        module, _, name = path.partition(":")
        if name in hint:
            known[name] = getattr(importlib.import_module(module), name)
    return eval(hint, known)


def _check_of(hint: Any) -> Callable[[object], bool]:
    from beartype import BeartypeConf, FrozenDict, door

    conf = BeartypeConf(hint_overrides=FrozenDict(_numbers()))
    return lambda value: door.is_bearable(value, hint, conf=conf)


@functools.cache
def _numbers() -> dict[Any, Any]:
    import numpy as np
    from beartype.vale import Is

    def is_number(value: object) -> bool:
        return not isinstance(value, bool)

    return {
        bool: bool | np.bool_,
        int: Annotated[int | np.integer, Is[is_number]],
        float: Annotated[float | int | np.floating | np.integer, Is[is_number]],
    }


def check_seed(seed: object, where: str = "seed") -> int:
    """The seed of random numbers.

    Raises:
        SettingError: it is no integer from 0 to 2⁶³ − 1.
    """
    try:
        number = operator.index(seed)  # type: ignore[arg-type]
    except TypeError:
        number = -1
    if not 0 <= number < 2**63:
        raise SettingError(where, got=in_words(seed), expected="an integer from 0 to 2⁶³ − 1")
    return number


def in_words(value: object) -> str:
    """A value, shortened, with its type."""
    if value is None:
        return "None"
    shown = f"{' '.join(repr(value).split()):.{LONGEST + 1}}"
    if len(shown) > LONGEST:
        shown = f"{shown[:LONGEST]}…"
    return f"{shown} ({type(value).__name__})"


def _names(hint: Any) -> list[str]:
    """The alternatives of a type, as a message calls them."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return [name for each in inner for name in _names(each)]
    if hint is None or hint is type(None):
        return ["None"]
    if origin is Literal:
        return [repr(each) for each in inner]
    if origin is None:
        words = {str: "a string", float: "a number", int: "an integer", bool: "True or False"}
        return [words.get(hint, getattr(hint, "__name__", str(hint)))]
    if issubclass(origin, Callable):  # type: ignore[arg-type]
        return ["a function"]
    of = ", ".join(" or ".join(_names(each)) for each in inner if each is not ...)
    return [f"{origin.__name__.lower()} of {of}"]
