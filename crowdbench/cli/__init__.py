"""The command line.

Main commands: `crowdbench evaluate | score | view | steer | areas | policy | submit | leaderboard |
data | convert | arrivals | scenes | metrics`. Commands for making a scene: `scene | fit | spawn |
anchors | power`.

Exit codes: 2 after an error of the user (one message), 130 after an interrupt, 143 after SIGTERM,
and 1, without a message, if the reader of the output closes it (`crowdbench … | head`).
"""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from crowdbench import __version__
from crowdbench.cli import (
    anchors,
    areas,
    arrivals,
    convert,
    data,
    evaluate,
    fit,
    leaderboard,
    metrics,
    policy,
    power,
    scene,
    scenes,
    score,
    spawn,
    steer,
    submit,
    view,
)
from crowdbench.errors import CrowdbenchError
from crowdbench.run.parallel import LOCAL, Stopped, engine, stopping_in_order


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    return run(_parser(), arguments)


def run(parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None) -> int:
    """Run a command of a parser, whose `run` is a function of its arguments; its exit code."""
    try:
        try:
            return _run(parser, arguments)
        finally:
            sys.stdout.flush()  # raises BrokenPipeError here if the reader has closed the pipe
    except BrokenPipeError:
        # The interpreter flushes stdout again when it exits, which must not raise an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _run(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> int:
    args = parser.parse_args(arguments)
    try:
        with stopping_in_order(), engine(getattr(args, "engine", LOCAL)):
            args.run(args)
    except CrowdbenchError as error:
        print(f"crowdbench: {error}", file=sys.stderr)
        return 2
    except Stopped as stopped:
        print("crowdbench: stopped", file=sys.stderr)
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        # All files are closed by now. A normal exit would unload libraries for up to a second.
        os._exit(stopped.number)
    except KeyboardInterrupt:
        print("crowdbench: interrupted", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="crowdbench",
        description="A benchmark for crowd simulation with realistic arrivals.",
    )
    parser.add_argument("--version", action="version", version=f"crowdbench {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in (
        evaluate, score, view, areas, steer, policy, scene, fit, spawn, anchors, power, submit,
        leaderboard, data, convert, arrivals, scenes, metrics,
    ):  # fmt: skip
        command.add(commands)
    return parser
