"""`crowdbench power`: find the metrics that distinguish a scene's anchor from its recording."""

import argparse
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_note, progress_bar

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    power = commands.add_parser(
        "power", help="find the metrics that distinguish a scene's anchor from its recording"
    )
    power.add_argument("scene", help="id of a scene, or its folder")
    power.add_argument(
        "--write", action="store_true", help="write them to scene.toml as the scored metrics"
    )
    power.set_defaults(run=_power)


def _power(args: argparse.Namespace) -> None:
    from crowdbench.leftovers import temporary_folder
    from crowdbench.scene import load_scene
    from crowdbench.scene_building.anchors import power_study
    from crowdbench.scene_building.toml import write_scored

    scene = load_scene(args.scene)
    with temporary_folder("power") as folder, progress_bar("rollouts") as progress:
        studies = power_study(args.scene, folder, progress=progress)
    table = new_table("metric", "floor", "95 %", "anchor", "power", "")
    for s in studies:
        table.add_row(
            s.metric.replace("_", " "),
            f"{s.floor:.3f}",
            f"{s.threshold:.3f}",
            f"{s.anchor:.3f}",
            f"{s.power:.2f}",
            "scored" if s.counts else "",
        )
    new_console().print(table)
    print_note(
        "Energy scores on synthetic recordings. floor and 95 %: mean and 95th percentile for the "
        "true process. anchor: mean for the anchor. power: share of synthetic recordings on which "
        "the anchor's score exceeds the 95th percentile. A metric is scored if its power is at "
        "least 0.8, unless the recording has only one value of it."
    )
    scored = [s.metric for s in studies if s.counts]
    print(f"scored = {scored}".replace("'", '"'))
    if args.write:
        print(f"written to {write_scored(scene, scored)}")
        print(f"Next, if they changed: crowdbench anchors {args.scene}")
