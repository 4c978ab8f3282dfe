"""`python -m studies cheats`: what crowds get that only seem to walk, or that walk as recorded."""

import argparse
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_note, progress_bar

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    cheats = commands.add_parser(
        "cheats", help="score crowds that show what the walking metrics can and cannot tell"
    )
    cheats.add_argument("scene", help="id of a scene, or its folder")
    cheats.set_defaults(run=_cheats)


def _cheats(args: argparse.Namespace) -> None:
    from crowdbench.metrics import METRICS, WALK
    from crowdbench.report.text.words import interval, number, share, speed
    from crowdbench.scoring.scorecard import metric_scores, rows, scale_of
    from studies.cheats import cheat

    with progress_bar("crowds") as progress:
        card, what = cheat(args.scene, progress=progress)
    by_policy = {row.policy: row for row in rows(card) if row.kind == "entry"}
    scale = scale_of(card)
    scores = {name: metric_scores(scale, row.entry) for name, row in by_policy.items()}
    walking = [m.name for m in METRICS if m.family in WALK and m.name in card.scored]
    table = new_table("cheat", "motion", "interaction", "walk", "speed", "at goal")
    for name, row in by_policy.items():
        fails = {limit: " !" * (limit in row.fails) for limit in ("speed", "arrivals")}
        table.add_row(
            f"{name}: {what[name]}",
            number(row.families.get("motion")),
            number(row.families.get("interaction")),
            interval(row.walk),
            speed(row.entry.speed_mps) + fails["speed"],
            share(row.entry.at_goal) + fails["arrivals"],
        )
    new_console().print(table)
    single = new_table("cheat", *(m.replace("_", " ") for m in walking))
    for name, each in scores.items():
        single.add_row(name, *(number(each.get(m)) for m in walking))
    new_console().print(single)
    print_note(
        "Scores under the recorded arrivals, protocol full: 0 straight walkers, 1 the recording. "
        "walk is the lesser of motion and interaction, and at most 0 where speed or arrivals are "
        "marked with !. The page docs/cheats.md of the repository explains what the metrics can "
        "and cannot tell."
    )
