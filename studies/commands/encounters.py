"""`python -m studies encounters`: draw typical encounters, recorded and simulated."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    encounters = commands.add_parser(
        "encounters", help="draw typical encounters of a recording beside simulated ones"
    )
    encounters.add_argument("scene", metavar="SCENE", help="id of a scene, or its folder")
    encounters.add_argument(
        "--policy",
        metavar="POLICY",
        help="policy that moves the people (default: anticipate if it ships with the scene, else "
        "anticipate-any)",
    )
    encounters.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    encounters.add_argument(
        "--out",
        type=Path,
        default=Path("docs/encounters"),
        metavar="DIR",
        help="output folder (default: docs/encounters)",
    )
    encounters.set_defaults(run=_encounters)


def _encounters(args: argparse.Namespace) -> None:
    from studies.encounters import write_encounters

    paths, found = write_encounters(args.scene, policy=args.policy, out=args.out, seed=args.seed)
    for each in found:
        print(
            f"{each['kind']:<10} 1 of {each['chosen_from']:,}; {each['measure']}: "
            f"recorded {each['recorded']}, simulated {each['simulated']}"
        )
    print(f"written to {', '.join(str(path) for path in paths)}")
