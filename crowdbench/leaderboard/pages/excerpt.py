"""The table in the repository's README: the ranked entries by track and scene."""

from collections.abc import Sequence

from crowdbench.leaderboard.pages.standings import Line, Standing, View
from crowdbench.leaderboard.pages.tables import GATE, OVERALL, gated
from crowdbench.leaderboard.pages.text import in_markdown
from crowdbench.leaderboard.submission.schema import SCENES
from crowdbench.report.text.markdown import table
from crowdbench.report.text.words import interval, number

BEGIN = "<!-- The table is made by `crowdbench leaderboard build`. -->\n"
END = "<!-- End of the table. -->"
MEMORY = "block-replay"
"""The reference that is shown beside the ranked entries."""


def with_excerpt(page: str, standings: Sequence[Standing]) -> str:
    """The page with a new table between its two comments; unchanged if it has none."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    return f"{before}{begin}\n{excerpt(standings)}\n\n{end}{after}" if begin and end else page


def excerpt(standings: Sequence[Standing]) -> str:
    """The table in Markdown: the ranked entries of all tracks, and the memorisation baseline."""
    head = ["track", "entry", "rank", "overall", *GATE, *SCENES]
    return table(head, [row for each in standings for row in _rows(each)], text=3)


def _rows(standing: Standing) -> list[list[str]]:
    shown = [
        line
        for line in standing.ordered(OVERALL)
        if line.entry.status == "ranked" or line.entry.id == MEMORY
    ]
    # Entries without an overall score follow the others; the unranked baseline is last.
    shown.sort(key=lambda line: (line.entry.id == MEMORY, OVERALL not in line.scores))
    return [[standing.track, *_cells(line, standing)] for line in shown]


def _cells(line: Line, standing: Standing) -> list[str]:
    name = f"[{in_markdown(line.entry.declared.name)}](leaderboard/pages/{line.entry.id}.html)"
    return [
        name if line.entry.status == "ranked" else f"*{name}*",
        standing.rank(line, OVERALL),
        interval(line.scores.get(OVERALL)),
        *gated(line),
        *(number(line.scores.get(View(scene=scene))) for scene in SCENES),
    ]
