"""`README.md`: the tables in Markdown, for readers on GitHub."""

from collections.abc import Sequence

from crowdbench.leaderboard.scores import View
from crowdbench.leaderboard.submission.schema import SCENES
from crowdbench.report.text.words import interval, number
from studies.markdown import flowed, table
from studies.site.index import LEAD, LISTED, SUBMIT, judged, rules_of
from studies.site.render import markdown
from studies.site.standings import Line, Standing
from studies.site.tables import COPIED, GATE, OVERALL, any_examined, copied, examined, gated
from studies.site.text import copied_share, decimals, in_markdown


def readme(standings: Sequence[Standing]) -> str:
    """The text of the file."""
    text = markdown(
        "readme.md.j2",
        tracks=[(standing, _ranked(standing)) for standing in standings],
        listed=_listed(standings),
        preview=standings[0].yours is not None,
        rules=rules_of(standings[0]),
        scenes=SCENES,
        lead=LEAD,
        judged=judged(),
        listing=LISTED,
        submit=SUBMIT,
    )
    return flowed(text.replace("\n  ", " "))  # `flowed` expects every list item on one line


def _ranked(standing: Standing) -> str:
    """The table of a track; empty without entries."""
    ranks = standing.ranks[OVERALL]
    ordered = standing.ordered(OVERALL)
    lines = [line for line in ordered if line.entry.status == "ranked"]
    lines.sort(key=lambda line: line.entry.id not in ranks)  # without an overall score: last
    for status in ("external", "reference"):
        lines += [line for line in ordered if line.entry.status == status]
    exams, scenes, copies = any_examined(lines), standing.scenes, copied(standing)
    rows = [
        [
            standing.rank(line, OVERALL),
            *_cells(line, standing, scenes, copies, exams=exams, walks=standing.track != "spawn"),
        ]
        for line in lines
    ]
    return _table("rank", scenes, copies, rows, exams=exams, walks=standing.track != "spawn")


def _listed(standings: Sequence[Standing]) -> str:
    """The table of the listed entries of all tracks; empty without entries."""
    scenes = tuple(dict.fromkeys(name for standing in standings for name in standing.scenes))
    tracks = [(standing, line) for standing in standings for line in standing.listed]
    exams = any_examined([line for _, line in tracks])
    rows = [
        [o.entry.declared.track, *_cells(o, each, scenes, COPIED, exams=exams)]
        for each, o in tracks
    ]
    return _table("track", scenes, COPIED, rows, exams=exams)


def _table(
    first: str,
    scenes: Sequence[str],
    copies: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    exams: bool,
    walks: bool = True,
) -> str:
    head = [first, "entry", "kind", "flags", "overall", *["as recorded"] * walks, *GATE, *scenes]
    head += ["exam"] * exams
    head += [f"copy of {c}" for c in copies]
    return table(head, rows, text=4) if rows else ""


def _cells(
    line: Line,
    standing: Standing,
    scenes: Sequence[str],
    copies: Sequence[str],
    *,
    exams: bool,
    walks: bool = True,
) -> list[str]:
    """The cells of an entry's row: name, kind, flags, scores and copy index."""
    entry = line.entry
    name = f"[{in_markdown(entry.declared.name)}]({standing.address(line)})"
    yours = " (yours)" if entry.id in (standing.yours or ()) else ""
    copy = line.copied()
    trips = copied_share(copy.trips, copy.trip_limit)
    shown = {"arrivals": decimals(copy.arrivals), "trips": trips}
    return [
        (f"*{name}*" if entry.status in ("external", "reference") else name) + yours,
        line.kind,
        ", ".join(dict.fromkeys(flag.what for flag in entry.flags)),
        interval(line.scores.get(OVERALL)),
        *[number(line.recorded)] * walks,
        *gated(line),
        *(number(line.scores.get(View(scene=scene))) for scene in scenes),
        *[examined(line)] * exams,
        *(shown[what] for what in copies),
    ]
