"""Tables outside the leaderboard: the ranked entries, and the metrics of the founding paper."""

from collections.abc import Sequence

from crowdbench.leaderboard.scores import View
from crowdbench.leaderboard.submission.schema import SCENES
from crowdbench.metrics import METRICS, PAPER
from crowdbench.report.text.words import NOTHING, digits, interval, number
from studies.markdown import table
from studies.site.standings import Line, Standing
from studies.site.tables import GATE, OVERALL, gated
from studies.site.text import decimals, in_markdown

BEGIN = "<!-- The table is made by `python -m studies leaderboard`. -->\n"
PAPER_BEGIN = (
    "<!-- The table of the paper's metrics is made by `python -m studies leaderboard`. -->\n"
)
END = "<!-- End of the table. -->"
MEMORY = "block-replay"
"""The reference that is shown beside the ranked entries."""


def with_excerpt(page: str, standings: Sequence[Standing]) -> str:
    """The page with new tables between their comments; unchanged if it has none."""
    for begin, made in ((BEGIN, excerpt), (PAPER_BEGIN, paper_metrics)):
        before, begins, rest = page.partition(begin)
        _, end, after = rest.partition(END)
        if begins and end:
            page = f"{before}{begin}\n{made(standings)}\n\n{end}{after}"
    return page


def excerpt(standings: Sequence[Standing]) -> str:
    """The table in Markdown: the ranked entries of all tracks, and the memorisation baseline."""
    head = ["track", "entry", "rank", "overall", *GATE, *SCENES]
    return table(head, [row for each in standings for row in _rows(each)], text=3)


def paper_metrics(standings: Sequence[Standing]) -> str:
    """The three metrics of the founding paper in Markdown, for all scenes and spawn models."""
    (standing,) = (each for each in standings if each.track == "spawn")
    by_name = {metric.name: metric for metric in METRICS}
    head = ["scene", "spawn model"]
    for name in PAPER:
        head += [f"`{name}` ({by_name[name].unit})", "distance"]
    rows = []
    for scene in standing.scenes:
        lines = [line for line in standing.ordered(OVERALL) if scene in line.entry.scenes]
        for k, line in enumerate(lines):
            known = [line.entry.scenes[scene].metrics[name] for name in PAPER]
            if k == 0:
                recorded = (cell for m in known for cell in (_digits(m.recorded), ""))
                rows.append([scene, "*recorded*", *recorded])
            simulated = (c for m in known for c in (_digits(m.simulated), decimals(m.distance)))
            rows.append(["", in_markdown(line.entry.declared.name), *simulated])
    return table(head, rows, text=2)


def _digits(value: float | None) -> str:
    return NOTHING if value is None else digits(value)


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
    name = f"[{in_markdown(line.entry.declared.name)}](leaderboard/{standing.address(line)})"
    return [
        name if line.entry.status == "ranked" else f"*{name}*",
        standing.rank(line, OVERALL),
        interval(line.scores.get(OVERALL)),
        *gated(line),
        *(number(line.scores.get(View(scene=scene))) for scene in SCENES),
    ]
