"""The command line: `crowdbench evaluate | score | view | steer | areas | policy | submit |
leaderboard | data | convert | scenes | metrics | bench`, and for who makes a scene `scene | fit |
spawn | anchors | power | results | walks | figures | ablation`.

A user's error is one message and exit code 2; an interrupt exits with 130, SIGTERM with 143. Output
that nobody reads on, as of `crowdbench … | head`, ends quietly with 1.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from crowdbench import __version__
from crowdbench.cli import (
    ablation,
    anchors,
    areas,
    bench,
    convert,
    data,
    evaluate,
    figures,
    fit,
    leaderboard,
    metrics,
    policy,
    power,
    results,
    scene,
    scenes,
    score,
    spawn,
    steer,
    submit,
    view,
    walks,
)
from crowdbench.errors import CrowdbenchError
from crowdbench.evaluation.parallel import Stopped, stopping_in_order


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; the return value is the exit code."""
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()  # where a pipe that nobody reads from any more is found out in time
    except BrokenPipeError:
        # The interpreter flushes once more when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _run(arguments: Sequence[str] | None) -> int:
    args = _parser().parse_args(arguments)
    try:
        with stopping_in_order():
            args.run(args)
    except CrowdbenchError as error:
        print(f"crowdbench: {error}", file=sys.stderr)
        return 2
    except Stopped as stopped:
        print("crowdbench: stopped", file=sys.stderr)
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        # All that is open is closed. Unloading libraries takes a second on a busy machine.
        os._exit(stopped.number)
    except KeyboardInterrupt:
        print("crowdbench: interrupted", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="crowdbench", description="A benchmark of crowds that come and go."
    )
    parser.add_argument("--version", action="version", version=f"crowdbench {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in (
        evaluate, score, view, areas, steer, policy, scene, fit, spawn, anchors, power, results,
        walks, ablation, figures, submit, leaderboard, data, convert, scenes, metrics, bench,
    ):  # fmt: skip
        command.add(commands)
    return parser
