"""A sentence per track: who leads, by how much, and how far from a perfect model."""

from markupsafe import Markup

from crowdbench.leaderboard.submission.schema import Track
from crowdbench.scoring.score import Score
from studies.site.render import html
from studies.site.standings import Line, Standing
from studies.site.tables import OVERALL

PERFECT: dict[Track, str] = {
    "walk": "the score of the recording itself",
    "spawn": "the expected score of a perfect model",
    "crowd": "the expected score of a perfect model",
}
"""What a score of 1 is on each track."""


def headline(standing: Standing) -> Markup:
    """The sentence as HTML; nothing where fewer than two entries compete."""
    ranks = standing.ranks[OVERALL]
    competing = [line for line in standing.ordered(OVERALL) if line.entry.id in ranks]
    if not competing:
        return Markup()
    leaders = [line for line in competing if ranks[line.entry.id] == 1]
    following = [line for line in competing if ranks[line.entry.id] > 1]
    return html(
        "headline.html.j2",
        leaders=leaders,
        next=following[0] if following else None,
        lead=_difference(leaders[0], following[0]) if following else None,
        missing=1 - leaders[0].scores[OVERALL].value,
        perfect=PERFECT[standing.track],
        standing=standing,
        overall=OVERALL,
    )


def _difference(better: Line, worse: Line) -> Score:
    """By how much one overall score is higher, on the resamples that entries share."""
    a, b = better.scores[OVERALL], worse.scores[OVERALL]
    return Score(a.value - b.value, a.resampled - b.resampled)
