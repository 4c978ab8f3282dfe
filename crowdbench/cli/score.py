"""`crowdbench score`: distances of trajectories that any simulator made."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import print_note
from crowdbench.cli.score_tables import missing_notes, print_results

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add it to the command line."""
    score = commands.add_parser("score", help="score trajectories that any simulator made")
    score.add_argument("scene", help="id of a scene, or its folder")
    score.add_argument(
        "table", type=Path, help="CSV or Parquet with person_id, frame (or time_s), x, y"
    )
    score.set_defaults(run=_score)


def _score(args: argparse.Namespace) -> None:
    from crowdbench.crowds import score
    from crowdbench.scene import load_scene
    from crowdbench.trajectories.storage import read

    scene = load_scene(args.scene)
    crowd = read(args.table, scene=scene.id, dt_s=scene.dt_s)
    results = score(scene, crowd)
    print(f"\n{args.table.name} on {scene.id}: {len(crowd)} persons")
    print_results(results)
    for note in missing_notes(scene):
        print_note(note)
