"""`crowdbench convert`: convert trajectories between file formats."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.data import add_mending, mended

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands

WRITTEN = ("csv", "trajnet", "jupedsim")


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    converted = commands.add_parser(
        "convert", help="convert trajectories between the formats of crowdbench and other programs"
    )
    converted.add_argument("table", type=Path, metavar="FILE", help="file to convert")
    converted.add_argument(
        "--format",
        metavar="FORMAT",
        default="csv",
        help="format of FILE (default: csv, a table in CSV or Parquet)",
    )
    converted.add_argument(
        "--dt-s",
        type=float,
        metavar="SECONDS",
        help="time between two rows of a person, if the file does not state it",
    )
    add_mending(converted)
    converted.add_argument("--to", choices=WRITTEN, required=True, help="format to write")
    converted.add_argument("--out", type=Path, required=True, metavar="FILE", help="file to write")
    converted.set_defaults(run=_convert)


def _convert(args: argparse.Namespace) -> None:
    from crowdbench.data.recordings.convert import convert

    crowd = convert(
        args.table,
        args.out,
        to=args.to,
        layout=args.format,
        dt_s=args.dt_s,
        gaps=args.gaps,
        offset_s=args.offset_s,
    )
    for name, fact in mended(crowd, args).items():
        print(f"{name}: {fact}")
    print(f"{len(crowd)} persons, {crowd.frames} frames of {crowd.dt_s:.4g} s")
    print(f"written to {args.out}")
