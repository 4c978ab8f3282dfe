"""Parts that others add: metrics, spawn models, policies, recording formats, observations, and
controllers of robots.

An installed package names them as entry points of the groups `crowdbench.metrics`,
`crowdbench.spawn_models`, `crowdbench.policies`, `crowdbench.recordings`,
`crowdbench.observations` and `crowdbench.controllers`; `register` adds one in a program or a
notebook. Either way the part is known by its name wherever a part of crowdbench is, in worker
processes too. All but observations can also be named as `pkg.module:NAME`, without registration.
`told` describes an error in code of others in one line.
"""

import functools
import importlib
import inspect
import re
import sys
import sysconfig
import traceback
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal

from crowdbench.errors import CrowdbenchError, OwnCodeError, SettingError, checked, did_you_mean

Kind = Literal[
    "metrics", "spawn_models", "policies", "recordings", "observations", "controllers"
]  # fmt: skip
KINDS: tuple[Kind, ...] = (
    "metrics", "spawn_models", "policies", "recordings", "observations", "controllers",
)  # fmt: skip
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
_SHOWN = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,39}")
_registered: dict[str, dict[str, Any]] = {kind: {} for kind in KINDS}

_OURS = Path(__file__).parent
_LIBRARIES = tuple(
    Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib", "platlib")
)


@checked()
def register(kind: Kind, name: str, part: Any) -> None:
    """Add a part under a name, in this process and in the workers that it starts from now on.

    Args:
        kind: `metrics`, `spawn_models`, `policies`, `recordings`, `observations` or
            `controllers`.
        name: letters, digits, `_`, `.` and `-`; not that of a part of crowdbench.
        part: a `Metric` or its class; the class of a spawn model or policy, or a function that
            makes one; a function that reads a recording; an `Observation` or its class; the class
            of a controller of robots.

    Raises:
        SettingError: there is no such kind, or the name has other letters.
    """
    if kind not in KINDS:
        raise SettingError(
            "register", got=f"the kind {kind!r}", expected=f"one of {', '.join(KINDS)}"
        )
    if not _NAME.fullmatch(name):
        raise SettingError(
            "register", got=f"the name {name!r}", expected="letters, digits, '_', '.' and '-'"
        )
    _registered[kind][name] = part


def part(kind: Kind, name: str) -> Any:
    """The part that somebody registered under a name, None if nobody has.

    Raises:
        OwnCodeError: its package raised something on import.
    """
    if name in _registered[kind]:
        return _registered[kind][name]
    entry = _installed(kind).get(name)
    return None if entry is None else _load(entry)


def names(kind: Kind, ours: Collection[str] = ()) -> list[str]:
    """Names of the parts that somebody registered; no package is imported for this.

    Raises:
        SettingError: somebody has taken one of `ours`, crowdbench's own names.
    """
    found = dict.fromkeys((*_installed(kind), *_registered[kind]))
    if taken := sorted(found.keys() & set(ours)):
        got = f"{', '.join(taken)}, registered by another package or program"
        expected = "names that crowdbench does not have"
        raise SettingError(f"crowdbench.{kind}", got=got, expected=expected)
    return list(found)


def instance_of(part: Any) -> Any:
    """An instance of a part that may be a class."""
    return part() if inspect.isclass(part) else part


def find(kind: Kind, name: str, known: Iterable[str] = ()) -> Any:
    """The part that somebody registered under a name, or the class `pkg.module:Class`.

    `known` are crowdbench's own names, for the error.

    Raises:
        SettingError: there is no such part, or it cannot be imported.
        OwnCodeError: its module raised an exception.
    """
    words = {"policies": "policy", "recordings": "format"}
    word = words.get(kind, kind.removesuffix("s").replace("_", " "))
    module, colon, attribute = name.partition(":")
    if not colon:
        found = part(kind, name)
        if found is None:
            known = (*known, *names(kind))
            got = repr(name)
            expected = "one of " * bool(known) + ", ".join([*known, "or pkg.module:Class"])
            raise SettingError(word, got=got, expected=expected, hint=did_you_mean(name, known))
        return found
    with blaming(f"{word} {name}, on import"):
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError, ValueError, TypeError) as error:
            got = f"{name!r} ({error})"
            expected = "a class or function that can be imported"
            hint = "Install its package, or run the command where Python can import it."
            raise SettingError(word, got=got, expected=expected, hint=hint) from error


def takes(kind: Any, name: str) -> bool:
    """Whether a class or function has a parameter of this name."""
    try:
        return name in inspect.signature(kind).parameters
    except (TypeError, ValueError):
        return False


def create(
    kind: Any, where: str, *arguments: object, needed: tuple[str, ...], **offered: object
) -> Any:
    """Call a user's class with `arguments`, and with those of `offered` that it takes.

    Raises:
        SettingError: it does not take the arguments, or what it makes lacks a `needed` attribute.
        OwnCodeError: it raised an exception that is not a `CrowdbenchError`.
    """
    offered = {name: value for name, value in offered.items() if takes(kind, name)}
    with blaming(where):
        try:
            found = kind(*arguments, **offered)
        except TypeError as error:
            if len(traceback.extract_tb(error.__traceback__)) > 1:  # it was called
                raise
            raise SettingError(
                where,
                got=str(error),
                expected="a class that is called with the scene (spawn models) or without "
                "arguments (policies)",
            ) from error
    if missing := [name for name in needed if not hasattr(found, name)]:
        raise SettingError(
            where, got=f"an object without {', '.join(missing)}", expected=", ".join(needed)
        )
    return found


def add_metric(name: str) -> None:
    """Register the metric `pkg.module:Class` in this process and its workers.

    Raises:
        SettingError: it cannot be imported or lacks an attribute of a metric.
        OwnCodeError: its module or class raised an exception.
    """
    if name not in names("metrics"):
        needed = ("name", "family", "summarise", "embed")
        metric = create(find("metrics", name), name, needed=needed)
        register("metrics", metric.name, metric)


def imported_name(path: str) -> str | None:
    """The attribute `name` of the class `pkg.module:Class`, if it has been imported and has one."""
    module, _, attribute = path.partition(":")
    name = getattr(getattr(sys.modules.get(module), attribute, None), "name", None)
    return name if isinstance(name, str) and _SHOWN.fullmatch(name) else None


def shared() -> bytes:
    """What was registered in this process, for workers.

    Raises:
        OwnCodeError: something of it cannot be pickled.
    """
    import cloudpickle

    if not any(_registered.values()):
        return b""
    with blaming("what was registered, on its way to worker processes"):
        return bytes(cloudpickle.dumps(_registered))


def restore(data: bytes) -> None:
    """Register in a worker what its parent has."""
    import pickle

    for kind, known in (pickle.loads(data) if data else {}).items():
        _registered[kind].update(known)


@functools.cache
def _installed(kind: Kind) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=f"crowdbench.{kind}")}


@functools.cache
def _load(entry: EntryPoint) -> Any:
    package = entry.dist.name if entry.dist else "a package"
    with blaming(f"{entry.group} {entry.name} of {package}, on import of {entry.value}"):
        return entry.load()


@contextmanager
def blaming(what: str) -> Iterator[None]:
    """Report an error in code of others as one message about `what`.

    Raises:
        OwnCodeError: it raised something that is no error of crowdbench's.
    """
    try:
        yield
    except CrowdbenchError:
        raise
    except Exception as error:
        raise OwnCodeError(what, got=told(error), expected="no error") from error


def told(error: BaseException) -> str:
    """An error's type and message, and the line of the user's code that led to it."""
    message = " ".join(str(error).split())[:300]
    named = f"{type(error).__name__}: {message}" if message else type(error).__name__
    frame = _frame(traceback.extract_tb(error.__traceback__))
    if isinstance(error, SyntaxError) and error.filename:
        return f"{type(error).__name__}: {error.msg} ({_short(error.filename)}:{error.lineno})"
    return f"{named} ({_short(frame.filename)}:{frame.lineno}, {frame.name})" if frame else named


def _frame(frames: traceback.StackSummary) -> traceback.FrameSummary | None:
    """The innermost frame of the user's code, or what is nearest to that."""
    known = [(f, Path(f.filename)) for f in frames]
    foreign = [(f, p) for f, p in known if p.is_absolute() and not p.is_relative_to(_OURS)]
    theirs = [f for f, p in foreign if not any(map(p.is_relative_to, _LIBRARIES))]
    return next(reversed(theirs or [f for f, _ in foreign] or list(frames)), None)


def _short(file: str) -> str:
    path, here = Path(file), Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else file
