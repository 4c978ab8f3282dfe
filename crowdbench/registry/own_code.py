"""Classes of users and other packages: `pkg.module:Class`, and registered ones."""

import importlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from crowdbench import plugins
from crowdbench.errors import CrowdbenchError, OwnCodeError, SettingError, did_you_mean
from crowdbench.plugins import told

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,39}")


def code_of(kind: plugins.Kind, name: str) -> list[Path] | bytes:
    """Files that a user's class depends on; its pickle if it was defined in a notebook.

    These are all files in the folder of its module, because weights may be stored there.
    """
    module, colon, _ = name.partition(":")
    if not colon:
        return plugins.code_of(plugins.part(kind, name))
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None:
        return []
    return sorted(path for path in Path(found.origin).parent.iterdir() if path.is_file())


def own_class(path: str, kind: str, known: tuple[str, ...]) -> Callable[..., Any]:
    """The class that `pkg.module:Class` names; `known` are the names that `kind` has instead.

    Raises:
        SettingError: `path` has another form, or cannot be imported.
        OwnCodeError: its module raised an exception.
    """
    module, colon, attribute = path.partition(":")
    if not colon:
        named = f"one of {', '.join(known)}, or " if known else ""
        raise SettingError(
            kind,
            got=repr(path),
            expected=f"{named}pkg.module:Class",
            hint=did_you_mean(path, known),
        )
    try:
        found: Callable[..., Any] = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise SettingError(
            kind,
            got=f"{path!r} ({error})",
            expected="a class that can be imported",
            hint="Install its package, or run the command where Python can import it.",
        ) from error
    except Exception as error:
        raise OwnCodeError(
            f"{kind} {path}", got=f"{told(error)} on import", expected="a module without errors"
        ) from error
    return found


def imported_name(path: str) -> str | None:
    """The attribute `name` of the class `pkg.module:Class`, if it has been imported and has one."""
    module, _, attribute = path.partition(":")
    name = getattr(getattr(sys.modules.get(module), attribute, None), "name", None)
    return name if isinstance(name, str) and _NAME.fullmatch(name) else None


def understood(kind: Callable[..., Any], **offered: object) -> dict[str, object]:
    """The arguments of `offered` that `kind` takes by name."""
    try:
        taken = inspect.signature(kind).parameters
    except (TypeError, ValueError):
        return {}
    return {name: value for name, value in offered.items() if name in taken}


def made(kind: Callable[..., Any], path: str, *arguments: object, **named: object) -> Any:
    """Call a user's class.

    Raises:
        SettingError: it does not take these arguments.
        OwnCodeError: it raised an exception that is not a `CrowdbenchError`.
    """
    try:
        return kind(*arguments, **named)
    except CrowdbenchError:
        raise
    except Exception as error:
        called = error.__traceback__ is not None and error.__traceback__.tb_next is not None
        if isinstance(error, TypeError) and not called:
            raise SettingError(
                path,
                got=str(error),
                expected="a class that is called with the scene (spawn models) or without "
                "arguments (policies)",
            ) from error
        raise OwnCodeError(path, got=told(error), expected="a call without errors") from error


def having(made: Any, path: str, needed: tuple[str, ...]) -> Any:
    """Return `made` if it has the needed attributes.

    Raises:
        SettingError: it lacks some.
    """
    missing = [name for name in needed if not hasattr(made, name)]
    if missing:
        raise SettingError(
            path, got=f"an object without {', '.join(missing)}", expected=f"{', '.join(needed)}"
        )
    return made


def add_metric(path: str) -> None:
    """Register the metric `pkg.module:Class` in this process and its workers.

    Raises:
        SettingError: it cannot be imported or lacks an attribute of a metric.
        OwnCodeError: its module or class raised an exception.
    """
    if path in plugins.names("metrics"):
        return
    kind = own_class(path, "metric", tuple(plugins.names("metrics")))
    metric = having(made(kind, path), path, ("name", "family", "summarise", "embed"))
    plugins.register("metrics", metric.name, metric)
