"""`pages/ID.html`: all that is known of one entry."""

from collections.abc import Sequence

from crowdbench.leaderboard.pages import axis
from crowdbench.leaderboard.pages.index import own
from crowdbench.leaderboard.pages.scene_results import scene_results
from crowdbench.leaderboard.pages.standings import Line, Standing, View
from crowdbench.leaderboard.pages.text import in_html, link, plain
from crowdbench.leaderboard.verification.entry import Entry
from crowdbench.report.html.shell import html_page
from crowdbench.report.text.words import NOTHING, plainly, with_interval

_STATUS = {
    "ranked": "Ranked: crowdbench rolled it out itself, on what it has not seen.",
    "listed": "Listed, not ranked: crowdbench did not roll it out itself, or it has seen what it "
    "is held against.",
    "reference": "A reference that others are seen against; it has no rank.",
}


def entry_page(line: Line, standing: Standing) -> str:
    """The page of an entry of this track."""
    entry = line.entry
    scenes = "\n".join(scene_results(name, entry) for name in _scenes(line, standing))
    body = f"""<header>
<p class="kicker"><a href="../index.html">crowdbench leaderboard</a> · track
<a href="../index.html#{standing.track}">{standing.track}</a></p>
<h1>{in_html(entry.declared.name, 200)}</h1>
<p class="lead">{_STATUS[entry.status]}</p>
<nav aria-label="Sections"><a href="#scores">Scores</a> <a href="#declared">Declared</a>
<a href="#results">Metrics</a> <a href="#verify">Verify</a> <a href="#cite">Cite</a>
<a href="#history">History</a></nav>
</header>
<main>
{_flags(entry)}
<section id="scores">
<h2>Scores</h2>
{_scores(line, standing)}
</section>
<section id="declared">
<h2>Declared</h2>
{_declared(entry)}
</section>
<section id="results">
<h2>Metric by metric</h2>
<p>A <b>distance</b> of 0 is equal to the recording. <b>Scores</b> are of the metrics that count on
the scene, on the axis from 0, the anchor, to 1, the true process on average; arrows point to what
lies beyond it. Beside them stands a dot for each fit of the model, a line for each fold, at the
ends of the axis what lies beyond. Metrics in grey are shown and do not count.</p>
{scenes}
</section>
<section id="verify">
<h2>Verify it</h2>
{_verify(entry, standing)}
</section>
<section id="cite">
<h2>Cite it</h2>
{_cite(line, standing)}
</section>
<section id="history">
<h2>History</h2>
{_history(entry)}
</section>
</main>
"""
    title = f"{plain(entry.declared.name, 80)}: crowdbench leaderboard"
    return html_page(title, body, style=own("pages.css"))


def _scenes(line: Line, standing: Standing) -> list[str]:
    """The entry's, in the order of all tables."""
    return [scene for scene in standing.scenes if scene in line.entry.scenes]


def _flags(entry: Entry) -> str:
    if not entry.flags:
        return ""
    items = "".join(
        f"<li><b>{flag.what}</b> ({in_html(flag.scene, 60)}). {in_html(flag.text, 500)}</li>\n"
        for flag in entry.flags
    )
    return f'<section id="flags">\n<h2>Flags</h2>\n<ul class="flags">{items}</ul>\n</section>'


def _scores(line: Line, standing: Standing) -> str:
    families = standing.families
    heads = "".join(
        f'<th scope="col"><span>{name}</span>{axis.ticks(axis.NARROW)}</th>'
        for name in ("all families", *families)
    )
    rows = ""
    for scene in ("", *_scenes(line, standing)):
        cells = "".join(
            f"<td>{axis.with_bar(line.scores.get(View(family, scene)))}</td>"
            for family in ("", *families)
        )
        rank = standing.rank(line, View(scene=scene)) or NOTHING
        rows += (
            f'<tr class="edge"><th scope="row" class="name">{scene or "overall"}</th>'
            f'<td class="rank">{rank}</td>{cells}</tr>\n'
        )
    return f"""<div class="scroll" role="region" aria-label="Scores" tabindex="0">
<table class="families {line.entry.status}">
<caption>Scores with 95&nbsp;% intervals; ranks are among the entries of track {standing.track},
those marked = are shared.</caption>
<thead><tr><th scope="col" class="name">scene</th>
<th scope="col" class="rank">rank</th>{heads}</tr></thead>
<tbody>
{rows}</tbody>
</table>
</div>"""


def _declared(entry: Entry) -> str:
    declared, training = entry.declared, entry.declared.training
    facts = {
        "Authors": ", ".join(in_html(author) for author in declared.authors),
        "Contact": in_html(declared.contact),
        "Link": link(declared.link),
        "Licence": in_html(declared.licence),
        "Track and kind": f"{declared.track}, {_KIND[declared.kind]}",
        "Trained on": in_html(training.data),
        "Training protocol": _TRAINING[training.protocol],
        "Parameters": f"{training.parameters:,}",
        "Policy": in_html(declared.shipped_policy),
        "Spawn model": in_html(declared.shipped_spawn),
    }
    return facts_list({name: what for name, what in facts.items() if what != in_html("")})


_KIND = {
    "learned": "learned",
    "model-based": "model-based",
    "privileged": "privileged: it sees the simulation’s state, not observations",
}
_TRAINING = {
    "heldout": "heldout: each fold’s artefact has seen that fold’s training blocks only",
    "none": "none: it has seen no recording of these scenes",
    "full": "full: it has seen whole recordings",
}


def facts_list(facts: dict[str, str]) -> str:
    """Names with what is known, as HTML."""
    items = "".join(f"<div><dt>{name}</dt><dd>{what}</dd></div>" for name, what in facts.items())
    return f'<dl class="facts">{items}</dl>'


def _verify(entry: Entry, standing: Standing) -> str:
    rows = "".join(
        f'<tr><th scope="row">{in_html(path, 200)}</th>'
        f'<td><code class="hash">{in_html(digest, 64)}</code></td></tr>\n'
        for path, digest in sorted(entry.artefacts.items())
    )
    submission = f"leaderboard/submissions/{entry.id}"
    data = f"entries/{entry.id}.json"
    if standing.yours is None or entry.id in standing.yours:  # a preview holds no others
        data = f'<a href="../{data}">{data}</a>'
    hashes = {
        f"Scene {name}": f"<code>{in_html(scene.made_from)}</code>"
        for name, scene in entry.scenes.items()
    }
    return f"""<p>With the recordings imported, the same artefacts give {data}
again, byte for byte where processor and libraries are the same, else but for rounding:</p>
<pre tabindex="0"><code>crowdbench leaderboard verify {submission} --out verified</code></pre>
{facts_list({"Scorer": f"{entry.scorer}", "crowdbench": in_html(entry.crowdbench)} | hashes)}
<div class="scroll" role="region" aria-label="Artefacts" tabindex="0">
<table class="plain artefacts"><caption>Artefacts</caption>
<thead><tr><th scope="col">file</th><th scope="col">SHA-256</th></tr></thead>
<tbody>
{rows}</tbody></table>
</div>"""


def _cite(line: Line, standing: Standing) -> str:
    entry, declared = line.entry, line.entry.declared
    scores = "; ".join(
        f"{scene or 'overall'} {with_interval(line.scores[View(scene=scene)])}"
        for scene in ("", *_scenes(line, standing))
        if View(scene=scene) in line.scores
    )
    authors = ", ".join(in_html(author) for author in declared.authors)
    return f"""<p>Cite what its link leads to. Its scores depend on the scorer and on no date:</p>
<p class="citation">{authors}: {in_html(declared.name)}. crowdbench leaderboard, track
{declared.track}, scorer {entry.scorer} (crowdbench {in_html(entry.crowdbench)}):
{scores or "no score"}.</p>
<p>And cite the papers of the recordings, which <code>crowdbench data import</code> names.</p>"""


def _history(entry: Entry) -> str:
    if not entry.history:
        return f"<p>Scored once, by scorer {entry.scorer}. There are no earlier results.</p>"
    scenes = sorted({name for earlier in entry.history for name in earlier.scenes})
    heads = "".join(f'<th scope="col">{in_html(name, 60)}</th>' for name in scenes)
    rows = "".join(
        f'<tr class="edge"><td>{earlier.scorer}</td><td>{in_html(earlier.crowdbench, 40)}</td>'
        f"{_numbers([earlier.overall, *(earlier.scenes.get(name) for name in scenes)])}"
        f'<td class="words">{in_html(earlier.reason, 500)}</td></tr>\n'
        for earlier in entry.history
    )
    return f"""<p>Earlier results, which scorer {entry.scorer} has replaced.</p>
<div class="scroll" role="region" aria-label="Earlier results" tabindex="0">
<table class="plain"><thead><tr><th scope="col">scorer</th><th scope="col">crowdbench</th>
<th scope="col">overall</th>{heads}
<th scope="col" class="words">scored anew because</th></tr></thead>
<tbody>
{rows}</tbody></table>
</div>"""


def _numbers(values: Sequence[float | None]) -> str:
    return "".join(f"<td>{NOTHING if v is None else plainly(v)}</td>" for v in values)
