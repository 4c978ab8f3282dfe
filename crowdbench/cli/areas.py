"""`crowdbench areas`: list a scene's spawn and goal areas by number."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_note

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands

_LEAST = 0.005  # smallest share of people for which a goal is listed


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    areas = commands.add_parser("areas", help="list a scene's spawn and goal areas by number")
    areas.add_argument("scene", help="id of a scene, or its folder")
    areas.add_argument("--out", type=Path, metavar="FILE.png", help="also draw a map of the areas")
    areas.set_defaults(run=_areas)


def _areas(args: argparse.Namespace) -> None:
    from crowdbench.files import replacing
    from crowdbench.registry import fitted_models, spawn_model
    from crowdbench.report.steering import areas_picture
    from crowdbench.scene import load_scene
    from crowdbench.spawn import PoissonGMM
    from crowdbench.spawn.ntpp.model import networks

    scene = load_scene(args.scene)
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
            "networks: number of ntpp-gmm fits that have a trained network for this area; without "
            "one, groups enter at a constant rate."
        )
    new_console().print(goal)
    if args.out is not None:
        with replacing(args.out) as temporary:
            temporary.write_bytes(areas_picture(scene, areas))
        print(f"written to {args.out}")
