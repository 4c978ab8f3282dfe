"""Options that say by how many processes, and where, parallel work is done."""

import argparse

from crowdbench.run.parallel import LOCAL


def add_workers(parser: argparse.ArgumentParser, default: str = "one per core") -> None:
    """Add the option `--workers`; `default` says what its absence means."""
    parser.add_argument(
        "--workers", type=int, metavar="N", help=f"worker processes (default: {default})"
    )


def add_engine(parser: argparse.ArgumentParser, default: str = "one per core") -> None:
    """Add the options `--workers`, as `add_workers` does, and `--engine`."""
    add_workers(parser, default)
    parser.add_argument(
        "--engine",
        default=LOCAL,
        help="where they run: local, ray, or the address ray://HOST:PORT of a Ray cluster "
        "(default: local)",
    )
