"""`crowdbench ablation`: study of training windows and strides."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import progress_bar

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    ablation = commands.add_parser(
        "ablation",
        help="study how training windows and strides affect ntpp-gmm (minutes to hours)",
    )
    ablation.add_argument("scene", help="id of a scene, or its folder")
    ablation.add_argument(
        "--out",
        type=Path,
        default=Path("docs/ablation"),
        metavar="DIR",
        help="output folder of the page and its picture (default: docs/ablation)",
    )
    ablation.add_argument("--workers", type=int, help="worker processes (default: one per core)")
    ablation.set_defaults(run=_ablation)


def _ablation(args: argparse.Namespace) -> None:
    from crowdbench.studies.ablation import write_ablation

    with progress_bar("fits") as progress:
        page = write_ablation(args.scene, out=args.out, workers=args.workers, progress=progress)
    print(f"written to {page} and {page.with_suffix('')}/")
