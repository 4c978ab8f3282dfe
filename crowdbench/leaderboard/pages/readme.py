"""`README.md`: the tables in Markdown, for where the page is not at hand."""

from collections.abc import Sequence

from crowdbench.leaderboard.pages.index import JUDGED, LISTED, SUBMIT, rules_of
from crowdbench.leaderboard.pages.standings import Line, Standing, View
from crowdbench.leaderboard.pages.tables import COPIED, OVERALL, copied, correlation, share
from crowdbench.leaderboard.pages.text import in_markdown
from crowdbench.leaderboard.submission.schema import SCENES
from crowdbench.report.text.markdown import flowed, table
from crowdbench.report.text.words import interval, number


def readme(standings: Sequence[Standing]) -> str:
    """The whole file."""
    tracks = "\n\n".join(_track(standing) for standing in standings)
    listed = [line for standing in standings for line in standing.listed]
    preview = "" if standings[0].yours is None else _PREVIEW
    return flowed(f"""# Leaderboard

Crowds that come and go, rolled out by crowdbench itself on what they have not seen, and compared
with recordings of real places. [index.html](index.html) shows the same with intervals drawn, by
scene, kind and family, and has a page for each entry. GitHub shows the source of pages: open
`index.html` of a clone in a browser. [The rules]({rules_of(standings[0])}) say what is ranked,
listed, refused and flagged. This file is made by `crowdbench leaderboard build`, from `entries/`
alone.
{preview}
## How to read the tables

{_HOW}

{tracks}

## Listed

{LISTED}

{_listed(standings) if listed else "No entries yet."}

## Submit

A submission is a folder with `submission.toml` and its artefacts, sent as a pull request that adds
it under `leaderboard/submissions/`:

```sh
{SUBMIT}
```
""")


_PREVIEW = """
This is a preview: entries marked (yours) are those of the folder `entries` here, all others come
with crowdbench.
"""
_HOW = "\n".join(
    (
        "- A score of 0 is the anchor: straight walkers, and where crowds are judged "
        "`poisson-gmm`, which lets them enter at constant rates. 1 is what the process that made "
        "the recording would get on average: for motion and interaction the recording itself. More "
        "is chance, or memory. Brackets are 95 % intervals.",
        "- A rank is 1 + the number of entries that are significantly better; who competes with "
        "nobody has none. Entries marked = share theirs and form a tie group: they cannot be told "
        "apart, whatever their order in it.",
        f"- *Overall* is the mean of {', '.join(SCENES[:-1])} and {SCENES[-1]}; who lacks one of "
        "them has none.",
        "- Names in italics, below the ranked ones, are references: what scores 0 by definition, "
        "the recording itself, blocks of it from memory, chance.",
        "- *Copy* is the correlation of a crowd’s arrivals with recorded ones and the share of "
        "lives that stay within 0.1 m of a recorded one; the highest of all scenes.",
    )
)


def _track(standing: Standing) -> str:
    ranks = standing.ranks[OVERALL]
    ordered = standing.ordered(OVERALL)
    lines = [line for line in ordered if line.entry.status == "ranked"]
    lines.sort(key=lambda line: line.entry.id not in ranks)  # who has no overall score stands last
    lines += [line for line in ordered if line.entry.status == "reference"]
    title = f"## {standing.track.capitalize()}\n\n{JUDGED[standing.track]}\n\n"
    if not lines:
        return f"{title}No entries yet."
    rows = [
        [standing.rank(line, OVERALL), *_cells(line, standing, standing.scenes, copied(standing))]
        for line in lines
    ]
    return title + _table("rank", standing.scenes, copied(standing), rows)


def _listed(standings: Sequence[Standing]) -> str:
    scenes = tuple(dict.fromkeys(name for standing in standings for name in standing.scenes))
    tracks = [(standing, line) for standing in standings for line in standing.listed]
    rows = [[o.entry.declared.track, *_cells(o, each, scenes, COPIED)] for each, o in tracks]
    return _table("track", scenes, COPIED, rows)


def _table(
    first: str, scenes: Sequence[str], copies: Sequence[str], rows: Sequence[Sequence[str]]
) -> str:
    head = [first, "entry", "kind", "flags", "overall", *scenes, *(f"copy of {c}" for c in copies)]
    return table(head, rows, text=4)


def _cells(
    line: Line, standing: Standing, scenes: Sequence[str], copies: Sequence[str]
) -> list[str]:
    """Name, kind, flags, scores and copies."""
    entry = line.entry
    name = f"[{in_markdown(entry.declared.name)}](pages/{entry.id}.html)"
    yours = " (yours)" if entry.id in (standing.yours or ()) else ""
    arrivals, lives = line.copied()
    shown = {"arrivals": correlation(arrivals), "lives": share(lives)}
    return [
        (f"*{name}*" if entry.status == "reference" else name) + yours,
        line.kind,
        ", ".join(dict.fromkeys(flag.what for flag in entry.flags)),
        interval(line.scores.get(OVERALL)),
        *(number(line.scores.get(View(scene=scene))) for scene in scenes),
        *(shown[what] for what in copies),
    ]
