"""`python -m studies paper`: check the claims of the founding paper."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import progress_bar
from crowdbench.cli.workers import add_engine

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    paper = commands.add_parser(
        "paper",
        help="check the founding paper's claims (minutes on ETH, hours on Grand Central)",
    )
    paper.add_argument("scene", metavar="SCENE", help="id of a scene, or its folder")
    paper.add_argument(
        "--out",
        type=Path,
        default=Path("docs"),
        metavar="DIR",
        help="output folder of the overview, paper.md, and of the pages and pictures of scenes in "
        "paper/ (default: docs)",
    )
    add_engine(paper)
    paper.set_defaults(run=_paper)


def _paper(args: argparse.Namespace) -> None:
    from studies.paper import write_paper

    with progress_bar("fits and samples") as progress:
        page = write_paper(args.scene, out=args.out, workers=args.workers, progress=progress)
    print(f"written to {page} and {page.with_suffix('')}/")
