"""`python -m studies figures`: draw the figures of scenes and write their data."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import progress_bar
from crowdbench.cli.workers import add_engine

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    figures = commands.add_parser(
        "figures", help="draw figures of trajectories and arrivals, with their data (minutes)"
    )
    figures.add_argument("scenes", nargs="+", metavar="SCENE", help="id of a scene, or its folder")
    figures.add_argument(
        "--figure",
        nargs="+",
        metavar="FIGURE",
        help="policies (simulated next to recorded paths), flows (density and mean paths per "
        "spawn area), situations (recorded windows and the most similar simulated ones), sheet "
        "(curves of all scenes in one figure); default: all four",
    )
    figures.add_argument(
        "--spawn",
        default="cox-plans",
        metavar="MODEL",
        help="spawn model, shown with poisson-gmm (default: cox-plans)",
    )
    figures.add_argument(
        "--policy",
        metavar="POLICY",
        help="policy that moves the people (default: anticipate if it ships with the scene, else "
        "social-force)",
    )
    figures.add_argument(
        "--seeds", type=int, default=5, help="rollouts of each spawn model (default: 5)"
    )
    add_engine(figures)
    figures.add_argument(
        "--out",
        type=Path,
        default=Path("docs/figures"),
        metavar="DIR",
        help="output folder (default: docs/figures)",
    )
    figures.set_defaults(run=_figures)


def _figures(args: argparse.Namespace) -> None:
    from studies.gallery import FIGURES, write_figures

    with progress_bar("rollouts") as progress:
        made = write_figures(
            args.scenes,
            figures=args.figure or FIGURES,
            spawn=args.spawn,
            policy=args.policy,
            out=args.out,
            seeds=args.seeds,
            workers=args.workers,
            progress=progress,
        )
    for path in made:
        print(f"written to {path} and {path.with_suffix('.json').name}")
