"""Some sentences per track: who leads, by how much, and how far from a perfect model."""

from markupsafe import Markup

from crowdbench.leaderboard.submission.schema import Track
from crowdbench.scoring.score import Score
from studies.site.render import html
from studies.site.standings import Line, Standing
from studies.site.tables import OVERALL

PERFECT: dict[Track, str] = {
    "walk": "The recording itself has a score of",
    "spawn": "A perfect model is expected to have a score of",
    "crowd": "A perfect model is expected to have a score of",
}
"""The beginning of a sentence on the score of 1."""


def headline(standing: Standing) -> Markup:
    """The sentences as HTML; nothing where no entry has a rank."""
    ranks = standing.ranks[OVERALL]
    competing = [line for line in standing.ordered(OVERALL) if line.entry.id in ranks]
    if not competing:
        return Markup()
    leaders = [line for line in competing if ranks[line.entry.id] == 1]
    second = min((rank for rank in ranks.values() if rank > 1), default=None)
    following = [line for line in competing if ranks[line.entry.id] == second]
    return html(
        "headline.html.j2",
        leaders=leaders,
        following=following,
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
