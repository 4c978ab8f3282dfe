"""Groups of commands, and their runner, which the studies share."""

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from inspect import BoundArguments

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError

from crowdbench.errors import CrowdbenchError
from crowdbench.run.processes import LOCAL, Stopped, stopping_in_order


def new_app(
    name: str,
    help: str,  # noqa: A002
    version: Callable[[], str] | None = None,
) -> App:
    """A program (which has a version) or a group of commands.

    Options that are sequences take all words up to the next option, at least one. Of an option that
    is repeated, the last value counts. Flags have no `--no-…`.
    """
    made = App(
        name=name,
        help=help,
        version=version,
        default_parameter=Parameter(
            negative=(), consume_multiple=(1, None), allow_repeating=True, show_default=_shown
        ),
    )
    if version is None:
        made.version_flags = ()
    for flag in (*made.help_flags, *made.version_flags):
        made[flag].group = ("Options",)
    return made


def _shown(default: object) -> str | None:
    """How the help writes a default value: sequences as they are typed, nothing if it is empty."""
    if default is None or default is False or default in ("", ()):
        return None
    return " ".join(map(str, default)) if isinstance(default, tuple) else str(default)


def find_own_code() -> None:
    """Let Python find the modules of the working directory, such as that of `pkg.module:Class`."""
    sys.path.insert(0, os.getcwd())


def run(app: App, arguments: Sequence[str] | None = None) -> int:
    """Run a command of a program and return its exit code, see `crowdbench.cli`.

    A command with a parameter `engine` runs on that engine; by default on this machine.
    """
    try:
        try:
            return _run(app, sys.argv[1:] if arguments is None else arguments)
        finally:
            sys.stdout.flush()  # raises BrokenPipeError here if the reader has closed the pipe
    except BrokenPipeError:
        # The interpreter flushes stdout again when it exits, which must not raise an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _run(app: App, arguments: Sequence[str]) -> int:
    try:
        command, bound, _ = app.parse_args(arguments, print_error=False, exit_on_error=False)
    except CycloptsError as error:
        print(_printable(f"{app.name[0]}: {_usage_error(app, error)}"), file=sys.stderr)
        return 2
    if command == app.help_print and not any(flag in arguments for flag in app.help_flags):
        command(bound.arguments["tokens"], console=app.error_console)  # no command was named
        return 2
    try:
        with stopping_in_order(), _engine_of(bound):
            command(*bound.args, **bound.kwargs)
    except CrowdbenchError as error:
        print(_printable(f"crowdbench: {error}"), file=sys.stderr)
        return 2
    except Stopped as stopped:
        print("crowdbench: stopped", file=sys.stderr)
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        # All files are closed by now. A normal exit would unload libraries for up to a second.
        os._exit(stopped.code)
    except KeyboardInterrupt:
        print("crowdbench: interrupted", file=sys.stderr)
        return 130
    return 0


def _engine_of(bound: BoundArguments) -> AbstractContextManager[None]:
    """The engine that a command line names; to open that of this machine would import numpy."""
    name = bound.arguments.get("engine", LOCAL)
    if name == LOCAL:
        return nullcontext()
    from crowdbench.run.executor import engine

    return engine(name)


def _printable(text: str) -> str:
    """The text with control characters as escapes: names could move the cursor or clear lines."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def _usage_error(app: App, error: CycloptsError) -> str:
    """What is wrong with a command line, and whose help says more."""
    told = str(error)
    if isinstance(error, UnusedCliTokensError):
        told = f"Unexpected argument: {' '.join(error.unused_tokens or ())}."
    called = " ".join((*app.name, *(error.command_chain or ())))
    return f"{told} Run `{called} --help`."
