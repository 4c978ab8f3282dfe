"""`crowdbench convert`: a crowd in a format that other programs read."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.data import add_mending, mended

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands

WRITTEN = ("csv", "trajnet", "jupedsim")


def add(commands: "Commands") -> None:
    """Add it to the command line."""
    converted = commands.add_parser(
        "convert", help="write a crowd in a format that other programs read, or read theirs"
    )
    converted.add_argument("table", type=Path, metavar="FILE", help="what is to be converted")
    converted.add_argument(
        "--format",
        metavar="FORMAT",
        default="csv",
        help="of that file (default: csv, a table in CSV or Parquet)",
    )
    converted.add_argument(
        "--dt-s",
        type=float,
        metavar="SECONDS",
        help="from one row of a person to the next, where the file does not say it",
    )
    add_mending(converted)
    converted.add_argument("--to", choices=WRITTEN, required=True, help="format to write")
    converted.add_argument("--out", type=Path, required=True, metavar="FILE")
    converted.set_defaults(run=_convert)


def _convert(args: argparse.Namespace) -> None:
    from crowdbench.recordings.convert import convert

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
