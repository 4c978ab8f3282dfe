"""`crowdbench steer`: show how a scenario changes a scene's arrivals and crowd."""

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_note, progress_bar

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.report.steering import Steering


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    steer = commands.add_parser(
        "steer", help="show what a scenario changes in a scene's crowd, and what it does not"
    )
    steer.add_argument("scene", help="id of a scene, or its folder")
    steer.add_argument("scenario", type=Path, metavar="FILE.toml", help="the scenario")
    steer.add_argument(
        "--spawn", default="ntpp-gmm", metavar="MODEL", help="spawn model (default: ntpp-gmm)"
    )
    steer.add_argument(
        "--policy",
        default="straight",
        metavar="POLICY",
        help="policy that moves the people (default: straight)",
    )
    steer.add_argument(
        "--seeds", type=int, help="number of episodes (default: as in the scene's protocol)"
    )
    steer.add_argument(
        "--out",
        type=Path,
        default=Path("results/steering"),
        metavar="DIR",
        help="output folder of the pictures (default: results/steering)",
    )
    steer.set_defaults(run=_steer)


def _steer(args: argparse.Namespace) -> None:
    from crowdbench.report.steering import draw_steering, steering

    sys.path.insert(0, os.getcwd())  # so that pkg.module:Class is found in the working directory

    found = steering(args.scene, args.scenario, spawn=args.spawn, seeds=args.seeds)
    _print_changes(found)
    with progress_bar("rollouts") as progress:
        paths = draw_steering(found, args.out, policy=args.policy, progress=progress)
    print(f"written to {args.out}: {' and '.join(path.name for path in paths)}")


def _print_changes(found: "Steering") -> None:
    from crowdbench.report.steering import area_changes, goal_changes

    episodes = len(found.usual)
    print(
        f"\n{found.steered[0].name} on {found.scene.id}: persons per episode of "
        f"{found.scene.horizon_s:.0f} s, mean of {episodes} episode{'s' * (episodes != 1)}"
    )
    heads = ("centre (m)", "as fitted", "asked for", "steered")
    spawn = new_table("spawn area", *heads, "same entry", "same goal too")
    for a in area_changes(found):
        same = map(_share, (a.same_entry, a.same_goal))
        spawn.add_row(f"{a.area}", *_cells(a.centre_m, a.usual, a.asked, a.steered), *same)
    goal = new_table("goal area", *heads)
    for g in goal_changes(found):
        goal.add_row(f"{g.area}", *_cells(g.centre_m, g.usual, g.asked, g.steered))
    console = new_console()
    console.print(spawn)
    print_note(
        "same entry: share of the people of the fitted model who also enter under the scenario, "
        "at exactly the same time and place and with the same speed. same goal too: those who "
        "also have the same goal."
    )
    console.print(goal)


def _cells(centre_m: tuple[float, float], *numbers: float) -> list[str]:
    return [f"{centre_m[0]:.1f}, {centre_m[1]:.1f}", *(f"{n:.1f}" for n in numbers)]


def _share(value: float | None) -> str:
    """Share as a percentage; `none` and `all` for exactly 0 and 1, `–` for None."""
    if value is None:
        return "–"
    return {0.0: "none", 1.0: "all"}.get(value, f"{100 * value:.1f} %")
