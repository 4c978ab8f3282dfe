"""`python -m studies growth`: measure how cost grows with people, worlds and threads."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    growth = commands.add_parser(
        "growth", help="measure how the cost of a simulation grows with its size (minutes)"
    )
    growth.add_argument(
        "--out", type=Path, metavar="FILE", help="also write the page to FILE (docs/growth.md)"
    )
    growth.set_defaults(run=_growth)


def _growth(args: argparse.Namespace) -> None:
    from contextlib import nullcontext

    from crowdbench.files import replacing
    from studies.growth_page import page

    # Opened first: a file that cannot be written raises an error before minutes of measuring.
    with replacing(args.out) if args.out else nullcontext() as temporary:
        parts = []
        for part in page():
            print(part, flush=True)
            parts.append(part)
        if temporary is not None:
            temporary.write_text("\n".join(parts))
