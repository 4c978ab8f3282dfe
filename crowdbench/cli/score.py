"""`crowdbench score`: compare the trajectories of any simulator with a scene's recording."""

from pathlib import Path

import crowdbench
from crowdbench.cli.options import Json, SceneName
from crowdbench.cli.printing import json_written
from crowdbench.errors import SettingError
from crowdbench.report.text.terminal import print_note


def score(
    scene: SceneName, tables: list[Path], /, *, recorded_arrivals: bool = False, json: Json = None
) -> None:
    """Compare the trajectories of any simulator with a scene's recording.

    Args:
        tables: CSV or Parquet with person_id, frame (or time_s), x, y; several files are rollouts
            of one simulator and get scores
        recorded_arrivals: people enter at the recorded times and places: score how they walk
            (needs the recording)
    """
    from crowdbench.report.text.notes import missing_notes
    from crowdbench.report.text.scorecards import print_card, print_results
    from crowdbench.scoring.ranking import score_rows
    from crowdbench.scoring.reference import check_fits

    place = crowdbench.load_scene(scene)
    if len({table.resolve() for table in tables}) < len(tables):
        raise SettingError(
            "crowdbench score", got="a file that is named twice", expected="a file for each rollout"
        )
    read_in = [crowdbench.read(table, place) for table in tables]
    for table, crowd in zip(tables, read_in, strict=True):
        check_fits(crowd, place, table)
    several = len(tables) > 1 or recorded_arrivals
    with json_written(json) as write:
        if several or json is not None:  # a scene of one's own may have no anchors yet
            card = crowdbench.score_rollouts(place, read_in, recorded_arrivals=recorded_arrivals)
            write(score_rows(card))
        if several:
            print_card(card, place)
            return
        print(f"\n{tables[0].name} on {place.id}: {len(read_in[0])} persons")
        print_results(crowdbench.score(place, read_in[0]))
        for note in missing_notes(place):
            print_note(note)
