"""`leaderboard`: entries, and the pages that show them."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add it to the command line."""
    leaderboard = commands.add_parser("leaderboard", help="verify submissions, build the pages")
    of_leaderboard = leaderboard.add_subparsers(required=True, metavar="COMMAND")
    _add_build(of_leaderboard)


def _add_build(commands: "Commands") -> None:
    build = commands.add_parser("build", help="write the table and the pages from the entries")
    build.add_argument(
        "--root",
        type=Path,
        default=Path("leaderboard"),
        metavar="DIR",
        help="folder of the leaderboard, with entries/ in it (default: leaderboard)",
    )
    build.set_defaults(run=_build)


def _build(asked: argparse.Namespace) -> None:
    from crowdbench.leaderboard.pages import build

    written = build(asked.root)
    entries = len(written) - 2
    number = f"{entries} {'entry' if entries == 1 else 'entries'}"
    print(f"{number}: written to {asked.root}: README.md, index.html and pages/")
