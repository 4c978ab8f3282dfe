"""`crowdbench score`: compare the trajectories of any simulator with a scene's recording."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import add_json_option, json_written, print_note
from crowdbench.cli.score_tables import missing_notes, print_card, print_results

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.scoring.scorecard import Scorecard


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    score = commands.add_parser(
        "score", help="compare the trajectories of any simulator with a scene's recording"
    )
    score.add_argument("scene", help="id of a scene, or its folder")
    score.add_argument(
        "table",
        type=Path,
        nargs="+",
        help="CSV or Parquet with person_id, frame (or time_s), x, y; several files are rollouts "
        "of one simulator and get scores",
    )
    score.add_argument(
        "--recorded-arrivals",
        action="store_true",
        help="people enter at the recorded times and places: score how they walk (needs the "
        "recording)",
    )
    add_json_option(score)
    score.set_defaults(run=_score)


def _score(args: argparse.Namespace) -> None:
    from crowdbench.scoring.score_json import score_rows

    with json_written(args.json) as write:
        card = _scored(args)
        if card is not None:
            write(score_rows(card))


def _scored(args: argparse.Namespace) -> "Scorecard | None":
    """Print the results; the scorecard, or None if it is not needed."""
    from crowdbench.crowds import score, score_rollouts
    from crowdbench.data.storage import read
    from crowdbench.errors import SettingError
    from crowdbench.scene import load_scene
    from crowdbench.scoring.reference import check_fits

    scene = load_scene(args.scene)
    if len({table.resolve() for table in args.table}) < len(args.table):
        raise SettingError(
            "crowdbench score",
            got="a file that is named twice",
            expected="a file for each rollout",
        )
    crowds = [read(table, scene=scene.id, dt_s=scene.dt_s) for table in args.table]
    for table, crowd in zip(args.table, crowds, strict=True):
        check_fits(crowd, scene, table)
    several = len(crowds) > 1 or args.recorded_arrivals
    card = None
    if several or args.json is not None:  # a scene of one's own may have no anchors yet
        card = score_rollouts(scene, crowds, recorded_arrivals=args.recorded_arrivals)
    if card is not None and several:
        print_card(card, scene)
        return card
    print(f"\n{args.table[0].name} on {scene.id}: {len(crowds[0])} persons")
    print_results(score(scene, crowds[0]))
    for note in missing_notes(scene):
        print_note(note)
    return card
