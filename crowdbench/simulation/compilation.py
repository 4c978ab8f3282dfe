"""Compilation of kernels for one and for several threads."""

import functools
import importlib
import os
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numba

from crowdbench.files import sha256

THREADS = "NUMBA_NUM_THREADS"
"""Environment variable that enables several threads; without it, kernels run on one thread.

Threads wait for each other at the end of each kernel. On an idle machine, two threads gain at most
a factor of two. On a busy machine, each wait lasts until the operating system runs the other
thread, and steps take ten times as long or more. The waiting cannot be configured here: OpenMP
reads `OMP_WAIT_POLICY` when it is loaded, and another package may have loaded it before.
"""
PARALLEL_FROM = 64
"""Number of people from which several threads are faster than one on an idle machine."""

OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy"}


@dataclass
class Kernel:
    """A function over many persons, compiled for one thread and for several.

    The machine code is called directly, because numba's look-up of the types of array bundles
    takes as long as a step of ten people. All calls of a `Kernel` object must therefore have
    arguments of the same types; `fresh` returns an object for other types.
    """

    function: Callable[..., None]
    _code: dict[bool, Callable[..., None]] = field(default_factory=dict)

    def fresh(self) -> "Kernel":
        """A new object for the same function, which may be called with other types."""
        return Kernel(self.function)

    def __reduce__(self) -> tuple[object, ...]:
        # Machine code cannot be pickled, so the kernel is pickled by name.
        return _named, (self.function.__module__, self.function.__name__)

    def __call__(self, persons: int, *arguments: object) -> None:
        """Run on several threads if they are enabled and `persons` is large enough, else on one."""
        parallel = persons >= PARALLEL_FROM and several_threads()
        code = self._code.get(parallel)
        if code is None:
            code = self._code[parallel] = self._compiled(parallel, arguments)
        code(*arguments)

    def _compiled(self, parallel: bool, arguments: tuple[object, ...]) -> Callable[..., None]:
        if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
            return self.function
        dispatcher = _dispatcher(self.function, parallel)
        signature = tuple(numba.typeof(a) for a in arguments)  # type: ignore[no-untyped-call]
        dispatcher.compile(signature)
        code: Callable[..., None] = dispatcher.overloads[signature].entry_point
        return code


def several_threads() -> bool:
    """Whether several threads are enabled by `THREADS` and available to this process."""
    return THREADS in os.environ and numba.get_num_threads() > 1


def _named(module: str, name: str) -> Kernel:
    found: Kernel = getattr(importlib.import_module(module), name)
    return found.fresh()


_dispatchers: dict[tuple[Callable[..., None], bool], Any] = {}


def _dispatcher(function: Any, parallel: bool) -> Any:
    if (function, parallel) not in _dispatchers:
        # numba caches machine code on disk by function name and detects changes only in the file
        # of the kernel itself, not in the functions that it calls. The name therefore contains the
        # kind of compilation and a hash of all sources.
        name = f"{function.__name__}_{'parallel' if parallel else 'alone'}_{_sources()}"
        named = types.FunctionType(function.__code__, function.__globals__, name)
        named.__qualname__ = name
        named.__module__ = function.__module__
        _dispatchers[function, parallel] = numba.njit(parallel=parallel, **OPTIONS)(named)
    return _dispatchers[function, parallel]


@functools.cache
def _sources() -> str:
    """Hash of all source files from which kernels are compiled."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return sha256(b"".join(file.read_bytes() for file in files))[:8]


def kernel(function: Callable[..., None]) -> Kernel:
    """Decorator for functions whose loops over worlds and persons are written with `prange`."""
    return Kernel(function)
