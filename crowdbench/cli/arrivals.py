"""`crowdbench arrivals`: write the recorded arrivals of a scene, for other simulators."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.spawn import write_sample

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    arrivals = commands.add_parser(
        "arrivals",
        help="write who entered a scene's recording: when, where, by which way and with whom",
    )
    arrivals.add_argument("scene", help="id of a scene, or its folder")
    arrivals.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="CSV or Parquet file to write, with the same columns as `crowdbench spawn --sample`",
    )
    arrivals.set_defaults(run=_arrivals)


def _arrivals(args: argparse.Namespace) -> None:
    from crowdbench.scene import load_scene

    write_sample(load_scene(args.scene), "replay", args.out)
