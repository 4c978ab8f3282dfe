"""`index.html`: a table per track, and what one needs to read it."""

from collections.abc import Sequence
from pathlib import Path

from crowdbench.leaderboard.pages.standings import Standing
from crowdbench.leaderboard.pages.tables import listed_table, ranked_table
from crowdbench.leaderboard.pages.text import in_html, short
from crowdbench.leaderboard.submission.schema import SCENES, Track
from crowdbench.leaderboard.verification.entry import Entry
from crowdbench.report.html.shell import html_page
from crowdbench.report.text.words import NOTHING, plainly

JUDGED: dict[Track, str] = {
    "walk": "A policy walks the people of the recording, who enter when and where they did. Judged "
    "by motion and interaction.",
    "spawn": "A spawn model says when, where and with which goal people enter; they walk straight. "
    "Judged by arrivals, presence, lives and space.",
    "crowd": "A spawn model and a policy together. Judged by arrivals, presence, lives and space, "
    "and, under the recorded arrivals, by motion and interaction.",
}
LISTED = (
    "Scored like all others, but not ranked: trajectories that crowdbench did not roll out "
    "itself, and models that have seen what they are held against (full). Trajectories of crowds "
    "are judged without motion and interaction, which are those of people who entered as recorded."
)
SUBMIT = """\
crowdbench submit init my-policy --track walk --policy networks/*
crowdbench submit check my-policy
crowdbench leaderboard verify my-policy --out verified"""
"""The commands of a submission; `networks` holds a folder for each scene."""
_KINDS = ("learned", "model-based", "privileged")


def index_page(standings: Sequence[Standing]) -> str:
    """The page; it needs no script to be complete."""
    entries = [o.entry for s in standings for o in (*s.lines, *s.listed)]
    preview = standings[0].yours is not None
    rules = rules_of(standings[0])
    tracks = "\n".join(_track(standing) for standing in standings)
    links = " ".join(f'<a href="#{s.track}">{s.track.capitalize()}</a>' for s in standings)
    body = f"""<header>
<p class="kicker">crowdbench</p>
<h1>Leaderboard</h1>
<p class="lead">Crowds that come and go, rolled out by crowdbench itself on what they have not seen,
and compared with recordings of real places.</p>
{_PREVIEW * preview}<nav aria-label="Sections">{links} <a href="#guide">How to read</a>
<a href="#scorer">Scorer</a> <a href="#submit">Submit</a> <a href="{rules}">Rules</a></nav>
</header>
<main>
{tracks}
{_GUIDE.replace("RULES.md", rules)}
<section id="scorer">
<h2>Scorer, citing and history</h2>
{_scorer(entries)}
</section>
<section id="submit">
<h2>Submit</h2>
<p>A submission is a folder with <code>submission.toml</code> and its artefacts, sent as a pull
request. <a href="{rules}">The rules</a> say what is ranked, listed, refused and flagged.</p>
<pre tabindex="0"><code>{SUBMIT}</code></pre>
</section>
</main>
"""
    return html_page("crowdbench leaderboard", body, style=own("pages.css"), script=own("index.js"))


def rules_of(standing: Standing) -> str:
    """Where the rules lie, from `index.html` on."""
    return "RULES.md" if standing.yours is None else "pages/RULES.md"


_PREVIEW = """<p class="preview"><b>A preview.</b> Entries marked
<span class="yours">yours</span> are those of the folder
<code>entries</code> here. All others come with crowdbench.</p>
"""


def own(name: str) -> str:
    """A file that lies beside this one."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


_GUIDE = f"""<section id="guide" class="guide">
<h2>How to read the tables</h2>
<ul>
<li>A <b>score of 0</b>, the solid line, is the anchor: straight walkers, and where crowds are
judged poisson-gmm, which lets them enter at constant rates. A <b>score of 1</b>, the dashed line,
is what the process that made the recording would get on average: for motion and interaction the
recording itself. More is chance, or memory. Dots are scores, whiskers and brackets <b>95&nbsp;%
intervals</b>; arrows point to what lies beyond the axis.</li>
<li><b>Families</b> of metrics: <i>arrivals</i> (when people enter), <i>presence</i> (how many are
there), <i>lives</i> (how long they stay, from where to where), <i>space</i> (where they are, how
near to each other), <i>motion</i> (speed, acceleration, turning), <i>interaction</i> (how near
strangers come, overlaps, walls).</li>
<li>A <b>rank</b> is 1 + the number of entries that are significantly better; who competes with
nobody has none. Entries marked = share theirs and form a <b>tie group</b>: they cannot be told
apart, whatever their order in it. Each view (a scene, a family) is ranked by itself.</li>
<li><b>Overall</b> is the mean of {", ".join(SCENES[:-1])} and {SCENES[-1]}; who lacks one of them
has none. Other scenes are shown.</li>
<li><b>Kinds</b>: learned, model-based, or privileged, which sees the simulation’s state in place of
observations.</li>
<li><i>Lines in italics</i> are <b>references</b> and have no rank: what scores 0 by definition, the
recording itself, blocks of it from memory, chance.</li>
<li><b>Copy</b> tells how much of a crowd may be the recording itself: how well its arrivals
correlate with recorded ones, minute by minute, and the share of lives that stay within 0.1 m of a
recorded one; the highest of all scenes.</li>
<li><b>Flags</b> change no score: who copies more than chance would, scores above the true process,
or varies too little, <a href="RULES.md#what-is-flagged">is flagged</a>.</li>
</ul>
</section>"""


def _track(standing: Standing) -> str:
    track = standing.track
    parts = [f'<section id="{track}" class="track">', f"<h2>{track.capitalize()}</h2>"]
    parts.append(f"<p>{JUDGED[track]}</p>")
    if not (standing.lines or standing.listed):
        parts.append("<p>No entries yet.</p>")
    else:
        parts.append(_filters(standing))
    if standing.lines:
        parts.append(ranked_table(standing))
    if standing.listed:
        parts.append(f'<div class="listed"><h3>Listed</h3>\n<p>{LISTED}</p>')
        parts.append(f"{listed_table(standing)}</div>")
    return "\n".join([*parts, "</section>"])


def _filters(standing: Standing) -> str:
    """Shown by the script, which makes them work."""
    choices = {
        "scene": ("overall", [(scene, scene) for scene in standing.scenes]),
        "family": ("all families", [(family, family) for family in standing.families]),
        "kind": ("all kinds", [(kind, kind) for kind in _KINDS]),
    }
    selects = "".join(
        f'<label>{name} <select name="{name}"><option value="">{first}</option>'
        + "".join(f'<option value="{value}">{label}</option>' for value, label in options)
        + "</select></label>"
        for name, (first, options) in choices.items()
    )
    return f'<div class="filters" hidden>{selects}<output aria-live="polite"></output></div>'


def _scorer(entries: Sequence[Entry]) -> str:
    if not entries:
        return "<p>Nothing has been scored yet.</p>"
    versions = ", ".join(sorted({in_html(entry.crowdbench) for entry in entries}))
    said = (
        f"<p>All scores are of <b>scorer {entries[0].scorer}</b> (crowdbench {versions}). A change "
        "by which scores become others makes a new scorer; all entries are then scored anew, and "
        "what they had is kept. So a score needs no date, only its scorer; a rank is among the "
        "entries of a commit. Each entry’s page says how to cite it.</p>"
    )
    rows = "".join(
        f'<tr><th scope="row" class="name"><a href="pages/{entry.id}.html">'
        f"{short(entry.declared.name)}</a></th><td>{earlier.scorer}</td>"
        f"<td>{NOTHING if earlier.overall is None else plainly(earlier.overall)}</td>"
        f'<td class="words">{in_html(earlier.reason, 300)}</td></tr>\n'
        for entry in entries
        for earlier in entry.history
    )
    if not rows:
        return f"{said}\n<p>There are no earlier results.</p>"
    return f"""{said}
<div class="scroll" role="region" aria-label="Earlier results" tabindex="0">
<table class="plain"><caption>Earlier results</caption>
<thead><tr><th scope="col" class="name">entry</th><th scope="col">scorer</th>
<th scope="col">overall</th><th scope="col" class="words">scored anew because</th></tr></thead>
<tbody>{rows}</tbody></table>
</div>"""
