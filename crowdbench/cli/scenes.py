"""`crowdbench scenes`: list the scenes."""

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    scenes = commands.add_parser("scenes", help="list the shipped scenes")
    scenes.set_defaults(run=_scenes)


def _scenes(args: argparse.Namespace) -> None:
    from crowdbench.scene import list_scenes, load_scene

    for name in list_scenes():
        print(f"{name:<10} {load_scene(name).title}")
