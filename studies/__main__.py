"""`python -m studies NAME`: run a study, or write its page."""

import argparse
import sys
from collections.abc import Sequence

from crowdbench.cli import run
from studies.commands import (
    cheats,
    diagrams,
    encounters,
    figures,
    growth,
    paper,
    results,
    speed,
    walks,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a study and return its exit code, which has the meaning of `crowdbench`'s."""
    parser = argparse.ArgumentParser(prog="python -m studies", description="Studies of crowdbench.")
    studies = parser.add_subparsers(required=True, metavar="STUDY")
    for study in (results, walks, cheats, paper, figures, encounters, speed, growth, diagrams):
        study.add(studies)
    return run(parser, arguments)


if __name__ == "__main__":
    sys.exit(main())
