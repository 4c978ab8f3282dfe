"""`python -m studies results`: write a scene's results page."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import progress_bar
from crowdbench.cli.workers import add_engine

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    results = commands.add_parser(
        "results", help="write a scene's results page, with pictures (minutes)"
    )
    results.add_argument("scene", help="id of a scene, or its folder")
    results.add_argument(
        "--out",
        type=Path,
        default=Path("docs/results"),
        metavar="DIR",
        help="output folder of the page and its pictures (default: docs/results)",
    )
    add_engine(results)
    results.add_argument(
        "--seeds",
        type=int,
        metavar="N",
        help="rollouts of each crowd (in each fold). Scores need at least two rollouts per fit, "
        "usually 10 (default: as in the scene's protocol)",
    )
    results.set_defaults(run=_results)


def _results(args: argparse.Namespace) -> None:
    from studies.results import write_results

    with progress_bar("rollouts") as progress:
        page = write_results(
            args.scene,
            out=args.out,
            seeds=args.seeds,
            workers=args.workers,
            progress=progress,
        )
    print(f"written to {page} and {page.with_suffix('')}/")
