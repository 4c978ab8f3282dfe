"""Compilation by numba, and the store of machine code.

`compiled` compiles a function when it is called first and stores its machine code for later
processes. `Kernel` does so for functions over many persons, for one thread and for several, and
`subroutine` compiles what they call.

numba stores machine code by the file of a function and does not notice when a function or a
constant of another file changes. Here, stored code is used only if the code of the function's
module, and of all modules that it imports, is unchanged (`crowdbench.code`), and so are the fields
of the named tuples that it is called with. Functions of other packages are not stored.
"""

import atexit
import importlib
import multiprocessing
import os
import shutil
import sys
import tempfile
import types
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from typing import Any

import filelock
import numba
from numba.core import caching
from numba.core.dispatcher import Dispatcher
from numba.core.types import BaseNamedTuple, BaseTuple

from crowdbench.code import code_hash

THREADS = "NUMBA_NUM_THREADS"
"""Environment variable that enables several threads; without it, kernels run on one thread.

Threads wait for each other at the end of each kernel. On an idle machine, two threads gain at most
a factor of two. On a busy machine, steps take ten times as long or more, because each wait lasts
until the operating system runs the other thread.
"""
PARALLEL_FROM = 64
"""Number of people from which several threads are faster than one on an idle machine."""
PATIENCE_S = 120.0
"""Seconds for which a process waits for another one that compiles the same function."""

STORE = "NUMBA_CACHE_DIR"
"""Environment variable of numba: a folder for machine code."""
_PREFIX = "crowdbench-machine-code-"


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator: compile a function when it is called, and store its machine code.

    `options` are those of `numba.njit`. By default, divisions by zero give infinity or NaN, as in
    numpy.
    """
    if function is None:
        return lambda function: compiled(function, **options)
    dispatcher = numba.njit(**{"error_model": "numpy", **options})(function)
    ours = function.__module__.startswith("crowdbench.")
    if ours and isinstance(dispatcher, Dispatcher):  # not if compilation is switched off
        with suppress(RuntimeError):  # there is no folder for it
            dispatcher._cache = _Store(function, dispatcher.targetoptions)  # type: ignore[attr-defined]
    return dispatcher


def subroutine(function: Callable[..., Any]) -> Any:
    """Decorator: a function that kernels call, for one person or a few.

    It must not create arrays. numba counts references to all arrays that a function is given, which
    would cost more than what such a function does; here it does not. CUDA kernels call the same
    functions (`crowdbench.simulation.cuda`).
    """
    options: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
    return numba.njit(**options)(function)


class Kernel:
    """Decorator: a function over many persons, compiled for one thread and for several.

    Its loops over worlds and persons are written with `prange`. The machine code is called
    directly, because numba's look-up of the types of array bundles takes as long as a step of ten
    people. All calls of a `Kernel` object must therefore have arguments of the same types; `fresh`
    returns an object for other types.
    """

    def __init__(self, function: Callable[..., None]) -> None:
        self.function = function
        self._code: dict[bool, Callable[..., None]] = {}

    def fresh(self) -> "Kernel":
        """A new object for the same function, which may be called with other types."""
        return Kernel(self.function)

    def __reduce__(self) -> tuple[object, ...]:
        # Machine code cannot be pickled, so the kernel is pickled by name.
        return _named, (self.function.__module__, self.function.__name__)

    def __call__(self, persons: int, *arguments: object) -> None:
        """Run on several threads if they are enabled and `persons` is large enough, else on one."""
        several = THREADS in os.environ and numba.get_num_threads() > 1
        parallel = several and persons >= PARALLEL_FROM
        if parallel not in self._code:
            self._code[parallel] = self._compiled(parallel, arguments)
        self._code[parallel](*arguments)

    def _compiled(self, parallel: bool, arguments: tuple[object, ...]) -> Callable[..., None]:
        if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
            return self.function
        dispatcher = _dispatcher(self.function, parallel)
        signature = tuple(numba.typeof(a) for a in arguments)  # type: ignore[no-untyped-call]
        dispatcher.compile(signature)
        code: Callable[..., None] = dispatcher.overloads[signature].entry_point
        return code


def _named(module: str, name: str) -> Kernel:
    found: Kernel = getattr(importlib.import_module(module), name)
    return found.fresh()


@cache
def _dispatcher(function: Any, parallel: bool) -> Any:
    # Stored code is found by the name of its function, so each kind has a name of its own.
    name = f"{function.__name__}_{'parallel' if parallel else 'alone'}"
    named = types.FunctionType(function.__code__, function.__globals__, name)
    named.__qualname__ = name
    named.__module__ = function.__module__
    return compiled(named, parallel=parallel)


class _Store(caching.FunctionCache):
    """The stored machine code of a function, for each signature."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        _ensure_place()
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._options = repr(sorted(options.items()))
        self._lock: filelock.FileLock | None = None

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        self._cache_file._source_stamp = code_hash(self._py_func.__module__) + self._options
        try:
            found = super()._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError):  # a named tuple has been renamed or moved since
            self.flush()  # type: ignore[no-untyped-call]
            found = None
        if found is not None:
            return found
        # One process compiles; others that need the same code meanwhile wait for it.
        self._impl.locator.ensure_cache_path()
        self._lock = filelock.FileLock(f"{self._cache_file._index_path}.lock", PATIENCE_S)
        with suppress(filelock.Timeout):
            self._lock.acquire()
        found = super()._load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if found is None:
            _announce()
        else:
            self._lock.release(force=True)
        return found

    def _save_overload(self, sig: Any, data: Any) -> None:
        try:
            super()._save_overload(sig, data)  # type: ignore[no-untyped-call]
        finally:
            if self._lock is not None:
                self._lock.release(force=True)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        # numba compares the types of the fields of named tuples, but not their order or names.
        key = super()._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        return (*key, tuple(_fields(sig)))


def _fields(signature: Any) -> Iterator[tuple[str, ...]]:
    for kind in signature:
        if isinstance(kind, BaseNamedTuple):
            yield kind.fields  # type: ignore[attr-defined]
        if isinstance(kind, BaseTuple):
            yield from _fields(kind)


@cache
def _ensure_place() -> None:
    """Let numba store machine code in a temporary folder if it finds no other one.

    Usually it lies beside the modules, or in the user's cache if that folder is read-only.
    """

    def probe() -> None:
        pass

    with suppress(RuntimeError):
        caching.FunctionCache(probe)  # type: ignore[no-untyped-call]
        return
    try:
        place = tempfile.mkdtemp(prefix=_PREFIX)
    except OSError:
        return  # it is compiled in each process
    os.environ[STORE] = place  # worker processes use it, too
    numba.config.CACHE_DIR = place  # type: ignore[attr-defined]
    atexit.register(shutil.rmtree, place, ignore_errors=True)


@cache
def _announce() -> None:
    """Say once that the wait is for the compiler.

    Nothing is said in logs, unless the code cannot be kept, and only one worker process says it.
    """
    lost = _PREFIX in os.environ.get(STORE, "")
    worker = multiprocessing.parent_process() is not None
    if (worker and (lost or multiprocessing.current_process().name[-2:] != "-1")) or not (
        lost or sys.stderr.isatty()
    ):
        return
    when = (
        f"at each start, because no folder for machine code can be written (name one in {STORE})."
        if lost
        else "only the first time."
    )
    print(f"Compiling for this machine: about 20 s, {when}", file=sys.stderr, flush=True)
