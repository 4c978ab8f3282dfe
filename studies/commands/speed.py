"""`python -m studies speed`: measure the speed of crowdbench on this machine."""

import argparse
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    speed = commands.add_parser("speed", help="measure the speed of crowdbench on this machine")
    speed.add_argument("--json", type=Path, metavar="FILE", help="also write the results to FILE")
    speed.set_defaults(run=_speed)


def _speed(args: argparse.Namespace) -> None:
    from crowdbench.files import replacing, write_json
    from studies.speed import measure

    # Opened first: a file that cannot be written raises an error before a minute of measuring.
    with replacing(args.json) if args.json else nullcontext() as temporary:
        figures = []
        for figure in measure():
            print(f"{figure.name:<48} {figure.text()}", flush=True)
            figures.append(figure)
        if temporary is not None:
            write_json(temporary, {f.name: {"value": f.value, "unit": f.unit} for f in figures})
