"""Type and shape checks of the first calls of each function in each test.

A rollout calls the same functions in each of thousands of frames. Checks of all of these calls
would take several times as long as the rollout.
"""

import functools
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from beartype import BeartypeConf, FrozenDict, beartype

CALLS = 100
"""Number of calls of a function that are checked in a test."""
_NO_CHECK = "__no_type_check__"  # jaxtyping calls functions with this attribute without checks
_NUMBERS = FrozenDict({int: int | np.integer, float: float | int | np.floating | np.integer})
"""Numbers of any kind are as good as Python's."""
_made: dict[str, int] = {}
_unchecked: list[Any] = []


def check_first_calls(function: Callable[..., object]) -> Callable[..., object]:
    """Check the arguments of a function with beartype, until it has been called often."""
    checked = beartype(conf=BeartypeConf(hint_overrides=_NUMBERS))(function)
    name = f"{function.__module__}:{function.__qualname__}"

    @functools.wraps(function)
    def counted(*args: object, **kwargs: object) -> object:
        _made[name] = _made.get(name, 0) + 1
        if _made[name] == CALLS and (found := _found(function)) is not None:
            setattr(found, _NO_CHECK, True)
            _unchecked.append(found)
        return checked(*args, **kwargs)

    return counted


def check_again() -> None:
    """Check the next calls of all functions."""
    _made.clear()
    while _unchecked:
        delattr(_unchecked.pop(), _NO_CHECK)


def _found(function: Callable[..., object]) -> Any:
    """What jaxtyping made of a function in its module or class; None for local functions."""
    found: Any = sys.modules.get(function.__module__)
    for name in function.__qualname__.split("."):
        found = getattr(found, "__dict__", {}).get(name)
    found = getattr(found, "fget", found)  # of a property
    found = getattr(found, "func", found)  # of a cached property
    found = getattr(found, "__func__", found)  # of a class method or static method
    return found if hasattr(found, "__wrapped__") else None
