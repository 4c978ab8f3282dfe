"""`python -m studies cheats`: what crowds get that only seem to walk, or that walk as recorded."""

from crowdbench.cli.options import SceneName
from crowdbench.cli.printing import progress_bar
from crowdbench.report.text.terminal import print_note, print_table


def cheats(scene: SceneName, /) -> None:
    """Score crowds that show what the walking metrics can and cannot tell."""
    from crowdbench.metrics import METRICS, WALK
    from crowdbench.report.text.words import interval, number, share, speed
    from crowdbench.scoring.ranking import metric_scores, rows, scale_of
    from studies.cheats import cheat

    with progress_bar("crowds") as progress:
        card, what = cheat(scene, progress=progress)
    by_policy = {row.policy: row for row in rows(card) if row.kind == "entry"}
    scale = scale_of(card)
    scores = {name: metric_scores(scale, row.entry) for name, row in by_policy.items()}
    walking = [m.name for m in METRICS if m.family in WALK and m.name in card.scored]
    rows_of_cheats = [
        (
            f"{name}: {what[name]}",
            number(row.families.get("motion")),
            number(row.families.get("interaction")),
            interval(row.walk),
            speed(row.entry.speed_mps) + " !" * ("speed" in row.fails),
            share(row.entry.at_goal) + " !" * ("arrivals" in row.fails),
        )
        for name, row in by_policy.items()
    ]
    heads = ("motion", "interaction", "walk", "speed", "at goal")
    print_table("cheat", *heads, rows=rows_of_cheats)
    singly = [(name, *(number(found.get(m)) for m in walking)) for name, found in scores.items()]
    print_table("cheat", *(m.replace("_", " ") for m in walking), rows=singly)
    print_note(
        "Scores under the recorded arrivals, protocol full: 0 straight walkers, 1 the recording. "
        "walk is the lesser of motion and interaction, and at most 0 where speed or arrivals are "
        "marked with !. The page docs/cheats.md of the repository explains what the metrics can "
        "and cannot tell."
    )
