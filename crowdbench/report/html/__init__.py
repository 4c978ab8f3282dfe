"""The report of an evaluation: one page that needs no network, `report.html`.

It shows what the scorecard holds and what the rollouts look like beside the recording. It computes
no score of its own. Nothing in it depends on the machine or the time: the same evaluation gives
the same bytes.
"""

import shlex
from html import escape
from pathlib import Path

from crowdbench.files import write_text
from crowdbench.metrics import FAMILIES
from crowdbench.report.display_names import Names, names_of
from crowdbench.report.html.pictures import pictures
from crowdbench.report.html.shell import html_page
from crowdbench.report.html.tables import by_rank, metric_tables, outcome_table, score_table
from crowdbench.report.plots import Crowds, PlotData
from crowdbench.report.text.words import PROTOCOLS, STEERED, named, with_interval
from crowdbench.scene import Scene
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.scorecard import ANCHOR, Row, Scorecard, rows, steered, walked

_FAMILIES = {
    "arrivals": "when people enter: gaps between them, how many in a short time",
    "presence": "how many are there at once, and how that number moves",
    "lives": "how long they stay, from where to where, how directly, and if they arrive",
    "space": "where they are, and how far their nearest neighbour is",
    "motion": "how fast they walk, speed up and turn",
    "interaction": "how they keep clear of strangers and of walls",
}


def write_report(
    card: Scorecard, scene: Scene, reference: Reference, crowds: Crowds, out: Path
) -> Path:
    """Write `report.html` into `out`.

    `crowds` are some rollouts of each entry, of the first part of the protocol: pictures show
    them, scores come from the scorecard.

    Raises:
        OutputError: the file cannot be written.
    """
    path = out / "report.html"
    write_text(path, _page(card, PlotData.of(scene, reference, crowds, card.protocol)))
    return path


def _page(card: Scorecard, plot: PlotData) -> str:
    scene, table = plot.scene, rows(card)
    names = names_of([(row.spawn, row.policy) for row in table], scene)
    style = (Path(__file__).parent / "style.css").read_text(encoding="utf-8")
    body = f"""<header>
<p class="kicker">crowdbench · evaluation report</p>
<h1>{escape(scene.title)}</h1>
<p class="lead">{_evaluated(card, names)}</p>
<nav aria-label="Sections">
<a href="#scores">Scores</a> <a href="#metrics">Metrics</a> <a href="#pictures">Pictures</a>
<a href="#method">How it was made</a>
</nav>
</header>
<main>
{_how_to_read(card)}
<section id="scores">
<h2>Scores</h2>
{_summary(card, table, names)}
{score_table(card, table, names)}
{_below_the_table(card)}
</section>
<section id="metrics">
<h2>Metric by metric</h2>
{metric_tables(card, plot, names)}
</section>
<section id="pictures">
<h2>Pictures</h2>
{pictures(plot)}
</section>
<section id="method">
<h2>How it was made</h2>
{_method(card, scene, names)}
</section>
</main>
"""
    return html_page(f"{scene.title}: crowdbench report", body, style=style)


def _listed(names: list[str]) -> str:
    each = [f"<b>{escape(name)}</b>" for name in names]
    return each[0] if len(each) == 1 else f"{', '.join(each[:-1])} and {each[-1]}"


def _evaluated(card: Scorecard, names: Names) -> str:
    shown = [e for e in card.entries if e.spawn != "replay"] or card.entries
    spawn = list(dict.fromkeys(names.spawn[e.spawn] for e in shown))
    policy = list(dict.fromkeys(names.policy[e.policy] for e in shown))
    return (
        f"{_listed(spawn)} let people in, {_listed(policy)} walk{'s' * (len(policy) == 1)} them: "
        f"{len(shown)} crowd{'s' * (len(shown) != 1)} on scene <b>{escape(card.scene)}</b>, "
        f"protocol <b>{card.protocol}</b>."
    )


def _how_to_read(card: Scorecard) -> str:
    spawn, policy = ANCHOR
    return f"""<section class="guide" aria-labelledby="guide">
<h2 id="guide">How to read this page</h2>
<ul>
<li>Every crowd is compared with the recording of a place. A <b>score of 0</b> is the anchor, a
crowd that knows next to nothing ({spawn}: people arrive at a constant rate; {policy}: they walk
straight ahead). A <b>score of 1</b> is what the true process, the one that made the recording,
gets on average. Since the recording is one draw of chance, scores can exceed 1.</li>
<li>Brackets and whiskers are <b>95 % intervals</b>, from {card.resamples:,} resamples of time
blocks, fits and rollouts. A <b>rank</b> is 1 + the number of crowds that are clearly better; crowds
of equal rank cannot be told apart.</li>
<li>Beside the scores stand <b>plain distances</b> to the recording: 0 is equal. They are easy to
grasp, but favour crowds that vary too little, so that they do not rank.</li>
</ul>
</section>"""


def _summary(card: Scorecard, table: list[Row], names: Names) -> str:
    ranked = by_rank(row for row in table if row.rank is not None)
    if not card.scored:
        return "<p>No metric of this scene counts yet: there are distances, but no scores.</p>"
    if not ranked and any(steered(row.spawn) for row in table):
        return f"<p>No ranks. {STEERED}</p>"
    if not ranked:
        return (
            f"<p>No ranks: {card.rollouts} rollout{'s' * (card.rollouts != 1)} of each crowd with "
            f"{card.fits} fits. Scores need two rollouts of each fit, {2 * card.fits} in all.</p>"
            if card.rollouts < 2 * card.fits
            else "<p>No ranks: not every crowd has a score.</p>"
        )
    whole = all(row.overall is not None for row in ranked)
    by = "overall score" if whole else "crowd score, since walking was not scored here"
    first = []
    for row in (row for row in ranked if row.rank == 1):
        score = row.overall if whole else row.crowd
        if score is not None:
            name = escape(names.pair(row.spawn, row.policy))
            first.append(f"<b>{name}</b> {with_interval(score)}")
    if len(ranked) == 1:
        return f"<p>By {by}: {first[0]}.</p>"
    if len(first) == 1:
        return f"<p>Ranked by {by}. Ahead of all others: {first[0]}.</p>"
    return f"<p>Ranked by {by}. In front, and not to be told apart: {'; '.join(first)}.</p>"


def _below_the_table(card: Scorecard) -> str:
    families = "".join(
        f"<div><dt>{family}</dt><dd>{_FAMILIES[family]}</dd></div>" for family in FAMILIES
    )
    note = "" if walked(card) else _missing_recording()
    if any(steered(entry.spawn) for entry in card.entries):
        note += f'<p class="note">{STEERED}</p>'
    return f"""{note}<dl class="families">{families}
<div><dt>crowd</dt><dd>mean of the first four families; with straight walkers the score of the
spawn model</dd></div>
<div><dt>walk</dt><dd>mean of motion and interaction, scored where the policy walks people who
enter as recorded, so that arrivals and walking do not mix; the anchor is straight</dd></div>
<div><dt>overall</dt><dd>mean of all families</dd></div>
</dl>
<p class="note">A family without a scored metric has no score (–) and counts in no mean. Anchors
come with the scene: <i>replay</i> has the recording by heart, <i>block-replay</i> pieces of it;
a model that has learned more than memory should beat the latter. Walk scores are about policies:
crowds of the same policy share them.</p>"""


def _missing_recording() -> str:
    return (
        '<p class="note"><b>No recording imported.</b> Policies are scored under the recorded '
        "arrivals, which are not at hand here; walk columns read “needs recording”. "
        "<code>crowdbench data fetch</code> brings a recording in.</p>"
    )


def _command(card: Scorecard, scene: Scene) -> str:
    """What reproduces the evaluation."""
    pairs = [(e.spawn, e.policy) for e in card.entries]
    # Policies are walked under the recorded arrivals unasked, all but `replay`.
    unasked = all(s != "replay" for s, _ in pairs) or (
        any(s != "replay" for s, _ in pairs) and ("replay", "replay") not in pairs
    )
    spawn = [s for s in dict.fromkeys(s for s, _ in pairs) if s != "replay" or not unasked]
    policy = list(dict.fromkeys(p for _, p in pairs))
    words = ["crowdbench", "evaluate", named(scene), "--spawn", *spawn, "--policy", *policy]
    return shlex.join([*words, "--protocol", card.protocol, "--seeds", str(card.rollouts)])


def _method(card: Scorecard, scene: Scene, names: Names) -> str:
    folds = " in each of three folds" if card.protocol == "heldout" else ""
    protocol = scene.protocol
    facts = {
        "Scene": f"{escape(card.scene)}, {escape(scene.title)}; recording "
        f"<i>{escape(scene.recording.name)}</i>, {card.horizon_s:,.0f} s in frames of "
        f"{scene.dt_s:g} s",
        f"Protocol {card.protocol}": PROTOCOLS[card.protocol],
        "Rollouts": f"{card.rollouts} of each crowd{folds}, each as long as the recording, from "
        f"{card.fits} fits of each model: rollout k is of fit k mod {card.fits}",
        "Time blocks": f"{card.blocks} of about {protocol.block_s:g} s; both sides are looked at "
        "in the same ones, and no gap or bin crosses an edge",
        "Score": "S = 1 − (ES − F) / (ES<sub>anchor</sub> − F): ES is the energy score of the "
        "rollouts, F what the recording’s own variation leaves over (0 for walking). Mean over "
        "metrics, then over families; never below −1 for a single metric",
        "Intervals": f"{card.resamples:,} resamples of runs of {protocol.resample_s:g} s, fits "
        "and rollouts, shared by all crowds; ranks from paired differences on them, 5 % by "
        "Holm’s procedure",
        "Recording": "at hand, so that walking is scored too"
        if walked(card)
        else "not imported: its statistics come with the scene, walking is not scored",
        "Software": f"crowdbench {escape(card.crowdbench)}; scene files "
        f"<code>{escape(card.made_from)}</code>",
    }
    items = "".join(f"<div><dt>{name}</dt><dd>{what}.</dd></div>" for name, what in facts.items())
    return f"""<dl class="facts">{items}</dl>
<h3>The same again</h3>
<pre tabindex="0"><code>{escape(_command(card, scene))}</code></pre>
<h3>How lives ended</h3>
{outcome_table(card, names)}"""


__all__ = ["write_report"]
