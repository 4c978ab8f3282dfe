"""`crowdbench anchors`: roll out the crowds that define a scene's score scale."""

import argparse
from typing import TYPE_CHECKING

from crowdbench.cli.printing import progress_bar
from crowdbench.cli.workers import add_engine

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    anchors = commands.add_parser(
        "anchors", help="roll out the crowds that define a scene's score scale (minutes)"
    )
    anchors.add_argument("scene", help="id of a scene, or its folder")
    add_engine(anchors)
    anchors.set_defaults(run=_anchors)


def _anchors(args: argparse.Namespace) -> None:
    from crowdbench.leftovers import temporary_folder
    from crowdbench.scene import load_scene
    from crowdbench.scene_building.anchors import make_anchors
    from crowdbench.scoring.scorecard import write_anchors

    scene = load_scene(args.scene)
    with temporary_folder("anchors") as folder, progress_bar("rollouts") as progress:
        anchors = make_anchors(args.scene, folder, workers=args.workers, progress=progress)
    print(f"written to {write_anchors(anchors, scene.folder)}")
