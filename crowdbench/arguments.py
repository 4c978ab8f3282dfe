"""Arguments of wrong types are refused where a user passes them, with the words of an error.

Without this, a wrong type fails somewhere inside (`'NoneType' object has no attribute 'start'`).
Only what users call is checked, not what is called in each step.
"""

import functools
import importlib
import inspect
import operator
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

from crowdbench.errors import SettingError

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
    def checks() -> dict[str, tuple[Any, Callable[[object], bool]]]:
        return {of: (hint, _check_of(hint)) for of, hint in _hints(function, undefined)}

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(*args, **kwargs).arguments
        for of, (hint, fits) in checks().items():
            if of in given and not fits(given[of]):
                raise SettingError(
                    f"{name}({of}=…)", got=in_words(given[of]), expected=" or ".join(_names(hint))
                )
        return function(*args, **kwargs)

    return call


def _hints(function: Callable[..., Any], undefined: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """The types of a function's arguments; none if it has another one than these."""
    known = dict(vars(sys.modules[function.__module__]))
    for path in undefined:
        module, _, name = path.partition(":")
        known[name] = getattr(importlib.import_module(module), name)
    for parameter in inspect.signature(function).parameters.values():
        hint = parameter.annotation
        several = parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
        if hint is not parameter.empty and not several:
            yield parameter.name, eval(hint, known) if isinstance(hint, str) else hint


def _check_of(hint: Any) -> Callable[[object], bool]:
    from beartype import BeartypeConf, FrozenDict, door

    conf = BeartypeConf(hint_overrides=FrozenDict(_numbers()))
    return lambda value: door.is_bearable(value, hint, conf=conf)


@functools.cache
def _numbers() -> dict[Any, Any]:
    from typing import Annotated

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
