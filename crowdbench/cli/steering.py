"""`areas` and `steer`: which areas a scene has, and what a scenario changes about its crowd."""

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_note, progress_bar

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.studies.steering import Steering

_LEAST = 0.005  # of the people, to be shown: half a per cent


def add(commands: "Commands") -> None:
    """Add them to the command line."""
    areas = commands.add_parser("areas", help="list a scene's spawn and goal areas by number")
    areas.add_argument("scene", help="id of a scene, or its folder")
    areas.add_argument("--out", type=Path, metavar="FILE.png", help="draw a map of them too")
    areas.set_defaults(run=_areas)

    steer = commands.add_parser(
        "steer", help="show what a scenario changes about a scene's crowd, and what not"
    )
    steer.add_argument("scene", help="id of a scene, or its folder")
    steer.add_argument("scenario", type=Path, metavar="FILE.toml")
    steer.add_argument(
        "--spawn", default="ntpp-gmm", metavar="MODEL", help="spawn model (default: ntpp-gmm)"
    )
    steer.add_argument(
        "--policy", default="straight", metavar="POLICY", help="who walks (default: straight)"
    )
    steer.add_argument("--seeds", type=int, help="episodes (default: the scene's protocol)")
    steer.add_argument(
        "--out",
        type=Path,
        default=Path("results/steering"),
        metavar="DIR",
        help="folder of the pictures (default: results/steering)",
    )
    steer.set_defaults(run=_steer)


def _areas(asked: argparse.Namespace) -> None:
    from crowdbench.files import replacing
    from crowdbench.registry import fitted_models, spawn_model
    from crowdbench.scene import load_scene
    from crowdbench.spawn import PoissonGMM
    from crowdbench.spawn.ntpp import networks
    from crowdbench.studies.steering import areas_picture

    scene = load_scene(asked.scene)
    model = spawn_model("poisson-gmm", scene)
    assert isinstance(model, PoissonGMM)
    areas, per_minute = model.areas, 60 * model.rate
    fits = networks(scene, areas, ["full"]) if "ntpp-gmm" in fitted_models(scene) else None
    spawn = new_table("spawn area", "centre (m)", "persons/min", "networks", "goals (%)")
    spawn.columns[4].justify = "left"
    for k, (x, y) in enumerate(areas.spawn.mean):
        goals = sorted(range(len(areas.goal)), key=lambda g: (-areas.flow[k, g], g))
        likely = [g for g in goals[:4] if areas.flow[k, g] >= _LEAST]
        shown = ", ".join(f"{g} ({100 * areas.flow[k, g]:.0f})" for g in likely)
        trained = "–" if fits is None else f"{fits[:, k].sum()} of {len(fits)}"
        spawn.add_row(f"{k}", f"{x:.1f}, {y:.1f}", f"{per_minute[k]:.2f}", trained, shown)
    goal = new_table("goal area", "centre (m)", "persons/min")
    for g, (x, y) in enumerate(areas.goal.mean):
        goal.add_row(f"{g}", f"{x:.1f}, {y:.1f}", f"{(per_minute @ areas.flow)[g]:.2f}")
    new_console().print(spawn)
    if fits is not None:
        print_note(
            "networks: in how many fits ntpp-gmm has a trained one; without it groups come at a "
            "constant rate."
        )
    new_console().print(goal)
    if asked.out is not None:
        with replacing(asked.out) as temporary:
            temporary.write_bytes(areas_picture(scene, areas))
        print(f"written to {asked.out}")


def _steer(asked: argparse.Namespace) -> None:
    from crowdbench.studies.steering import draw_steering, steering

    sys.path.insert(0, os.getcwd())  # one's own pkg.module:Class may lie beside

    found = steering(asked.scene, asked.scenario, spawn=asked.spawn, seeds=asked.seeds)
    _print_changes(found)
    with progress_bar("rollouts") as progress:
        paths = draw_steering(found, asked.out, policy=asked.policy, progress=progress)
    print(f"written to {asked.out}: {' and '.join(path.name for path in paths)}")


def _print_changes(found: "Steering") -> None:
    from crowdbench.studies.steering import area_changes, goal_changes

    print(
        f"\n{found.steered[0].name} on {found.scene.id}: persons per episode of "
        f"{found.scene.horizon_s:.0f} s, means of {len(found.usual)}"
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
        "same entry: share of the people as fitted who come under the scenario too, at the same "
        "time and place with the same speed, bit for bit; same goal too: and to the same goal."
    )
    console.print(goal)


def _cells(centre_m: tuple[float, float], *numbers: float) -> list[str]:
    return [f"{centre_m[0]:.1f}, {centre_m[1]:.1f}", *(f"{n:.1f}" for n in numbers)]


def _share(value: float | None) -> str:
    """A share that says `all` only of all."""
    if value is None:
        return "–"
    return {0.0: "none", 1.0: "all"}.get(value, f"{100 * value:.1f} %")
