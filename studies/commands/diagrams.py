"""`python -m studies diagrams`: draw the diagrams of the documentation."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    diagrams = commands.add_parser("diagrams", help="draw the diagrams of the documentation")
    diagrams.add_argument(
        "--out",
        type=Path,
        default=Path("docs/diagrams"),
        metavar="DIR",
        help="output folder (default: docs/diagrams)",
    )
    diagrams.set_defaults(run=_diagrams)


def _diagrams(args: argparse.Namespace) -> None:
    from studies.diagrams import write_diagrams

    print(f"written to {', '.join(str(path) for path in write_diagrams(args.out))}")
