"""The command line: `crowdbench evaluate | score | leaderboard | view | steer | areas | policy |
data | convert | scenes | bench`, and for who makes a scene `scene | fit | spawn | anchors |
power | results | walks | figures | ablation`.

A user's error is one message and exit code 2; an interrupt exits with 130.
"""

import argparse
import sys
from collections.abc import Sequence

from crowdbench import __version__
from crowdbench.cli import (
    authoring,
    data,
    drawing,
    judging,
    leaderboard,
    making,
    policies,
    speed,
    steering,
    viewing,
)
from crowdbench.errors import CrowdbenchError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; the return value is the exit code."""
    asked = _parser().parse_args(arguments)
    try:
        asked.run(asked)
    except CrowdbenchError as error:
        print(f"crowdbench: {error}", file=sys.stderr)
        return 2
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
    rooms = (
        judging, leaderboard, viewing, steering, policies, authoring, making, drawing, data, speed,
    )  # fmt: skip
    for room in rooms:
        room.add(commands)
    return parser
