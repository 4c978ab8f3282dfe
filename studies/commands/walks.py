"""`python -m studies walks`: write the page that compares how policies walk."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import progress_bar
from crowdbench.cli.workers import add_engine

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    walks = commands.add_parser(
        "walks", help="write the page that compares how policies walk, with pictures (minutes)"
    )
    walks.add_argument("scenes", nargs="+", metavar="SCENE", help="id of a scene, or its folder")
    walks.add_argument(
        "--policy",
        nargs="+",
        default=[],
        metavar="POLICY",
        help="policies in addition to random, straight, social-force and those of each scene",
    )
    walks.add_argument(
        "--out",
        type=Path,
        default=Path("docs"),
        metavar="DIR",
        help="output folder of walks.md and its pictures (default: docs)",
    )
    add_engine(walks)
    walks.add_argument(
        "--seeds",
        type=int,
        metavar="N",
        help="rollouts of each policy (in each fold). Scores of stochastic policies need at least "
        "two rollouts per fit (default: two per fit)",
    )
    walks.set_defaults(run=_walks)


def _walks(args: argparse.Namespace) -> None:
    from studies.walks import write_walks

    with progress_bar("rollouts") as progress:
        page = write_walks(
            args.scenes,
            more=args.policy,
            out=args.out,
            seeds=args.seeds,
            workers=args.workers,
            progress=progress,
        )
    print(f"written to {page} and {page.with_suffix('')}/")
