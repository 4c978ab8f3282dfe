"""Kernels compiled for one thread and for several."""

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
"""Environment variable that asks for several threads; without it, kernels run on one.

Threads wait for each other at the end of each kernel. On an idle machine two of them gain at most
a factor of two; on a busy one each wait lasts until the operating system lets the other thread
run, and steps take ten times as long or more. How threads wait cannot be set from here:
OpenMP reads `OMP_WAIT_POLICY` when it is loaded, which other packages may have done before.
"""
PARALLEL_FROM = 64
"""Persons from which on several threads are faster than one on an idle machine."""

OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy"}


@dataclass
class Kernel:
    """A function over many persons in its two compilations.

    The machine code is called directly: numba's own look-up of the arguments' types takes, for
    bundles of arrays, as long as stepping ten people. So all calls of one `Kernel` object must
    have arguments of the same types; `fresh` makes another one.
    """

    function: Callable[..., None]
    _code: dict[bool, Callable[..., None]] = field(default_factory=dict)

    def fresh(self) -> "Kernel":
        """The same kernel, for arguments of types of its own."""
        return Kernel(self.function)

    def __reduce__(self) -> tuple[object, ...]:
        # Machine code does not travel between processes; the name of the kernel does.
        return _named, (self.function.__module__, self.function.__name__)

    def __call__(self, persons: int, *arguments: object) -> None:
        """Run on one thread, or on several where they are asked for and worth it."""
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
    """Whether several threads are asked for, by `THREADS`, and this process may have them."""
    return THREADS in os.environ and numba.get_num_threads() > 1


def _named(module: str, name: str) -> Kernel:
    found: Kernel = getattr(importlib.import_module(module), name)
    return found.fresh()


_dispatchers: dict[tuple[Callable[..., None], bool], Any] = {}


def _dispatcher(function: Any, parallel: bool) -> Any:
    if (function, parallel) not in _dispatchers:
        # numba keeps machine code on disk by name, and looks for changes only in the file that
        # the kernel itself stands in: so each compilation has a name of its own, and each state
        # of the sources, and the functions that kernels call are not kept on their own.
        name = f"{function.__name__}_{'parallel' if parallel else 'alone'}_{_sources()}"
        named = types.FunctionType(function.__code__, function.__globals__, name)
        named.__qualname__ = name
        named.__module__ = function.__module__
        _dispatchers[function, parallel] = numba.njit(parallel=parallel, **OPTIONS)(named)
    return _dispatchers[function, parallel]


@functools.cache
def _sources() -> str:
    """Hash of all sources that kernels are compiled from."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    return sha256(b"".join(file.read_bytes() for file in files))[:8]


def kernel(function: Callable[..., None]) -> Kernel:
    """Make a kernel of a function whose loops over worlds and persons are `prange`."""
    return Kernel(function)
