"""An entry's results on one scene: every metric, every fit, and what they look like."""

from collections.abc import Sequence

from crowdbench.leaderboard.pages import axis
from crowdbench.leaderboard.pages.curves import figure
from crowdbench.leaderboard.pages.standings import FAMILIES_OF
from crowdbench.leaderboard.pages.tables import correlation, share
from crowdbench.leaderboard.pages.text import in_html
from crowdbench.leaderboard.verification.entry import Entry, MetricEntry, SceneEntry
from crowdbench.leaderboard.verification.soundness import FAMILY_OF
from crowdbench.metrics import METRICS
from crowdbench.report.text.words import NOTHING, digits, plainly


def scene_results(name: str, entry: Entry) -> str:
    """A section with facts, tables and curves."""
    scene = entry.scenes[name]
    families = FAMILIES_OF[entry.declared.track]
    parts = list(dict.fromkeys(part for m in scene.metrics.values() for part in m.parts))
    curves = "".join(figure(title, curve) for title, curve in scene.curves.items())
    return f"""<h3 id="{name}">{name}</h3>
<p>{_facts(scene)}</p>
{_metrics(name, scene, families, parts)}
{_fits(name, scene, families, parts)}
<div class="curves">
{curves}</div>"""


def _facts(scene: SceneEntry) -> str:
    """How it was scored, who walked, and how much may be copied."""
    each = " in each fold" if scene.protocol == "heldout" else ""
    ends = ", ".join(
        f"{in_html(name, 40)} {share(count / max(1, scene.persons))}"
        for name, count in scene.outcomes.items()
    )
    copy = scene.copy
    limit = ""
    if copy.arrivals_limit is not None:
        limit = f" (without copying at most {correlation(copy.arrivals_limit)})"
    arrivals = "" if copy.arrivals is None else f"arrivals {correlation(copy.arrivals)}{limit}, "
    return (
        f"Protocol {scene.protocol}: {scene.rollouts} rollout{'s' * (scene.rollouts != 1)}{each}, "
        f"{scene.fits} fit{'s' * (scene.fits != 1)}; {scene.persons:,} simulated persons"
        f"{f': {ends}' if ends else ''}. "
        f"Copy: {arrivals}lives {share(copy.lives)}."
    )


def _shown(scene: SceneEntry, families: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Families with their metrics, in the order of all tables."""
    known = [m.name for m in METRICS if m.name in scene.metrics]
    each = [(family, [n for n in known if FAMILY_OF[n] == family]) for family in families]
    return [(family, names) for family, names in each if names]


def _metrics(name: str, scene: SceneEntry, families: Sequence[str], parts: Sequence[str]) -> str:
    rows = "".join(
        f'<tr class="part"><th colspan="8" scope="rowgroup">{family}</th></tr>\n'
        + "".join(_metric(metric, scene.metrics[metric], parts) for metric in names)
        for family, names in _shown(scene, families)
    )
    ticks = axis.ticks(axis.NARROW)
    return f"""<div class="scroll" role="region" aria-label="Metrics on {name}" tabindex="0">
<table class="metrics">
<thead><tr><th scope="col" class="name">metric</th><th scope="col">recorded</th>
<th scope="col">simulated</th><th scope="col">distance</th><th scope="col">score</th>
<th scope="col" aria-label="interval"></th>
<th scope="col" class="plot" aria-label="drawn">{ticks}</th>
<th scope="col" class="plot">by fold and fit{ticks}</th></tr></thead>
<tbody>
{rows}</tbody></table>
</div>"""


def _metric(name: str, metric: MetricEntry, parts: Sequence[str]) -> str:
    score, brackets, bar = NOTHING, "", axis.no_bar(axis.NARROW)
    if metric.score is not None and metric.interval is not None:
        score, brackets = plainly(metric.score), axis.brackets(metric.interval)
        bar = axis.bar(metric.score, metric.interval, axis.NARROW)
    distance = NOTHING if metric.distance is None else f"{metric.distance:.3f}"
    strip = axis.strip([metric.parts.get(part, []) for part in parts])
    return (
        f'<tr{"" if metric.scored else " class=uncounted"}><th scope="row" class="name">'
        f"{name.replace('_', ' ')}</th><td>{_value(metric.recorded, metric.unit)}</td>"
        f"<td>{_value(metric.simulated, metric.unit)}</td><td>{distance}</td>"
        f'<td class="s">{score}</td><td class="brackets">{brackets}</td>'
        f'<td class="plot">{bar}</td><td class="plot">{strip}</td></tr>\n'
    )


def _value(value: float | None, unit: str) -> str:
    return NOTHING if value is None else f"{digits(value)}&nbsp;{in_html(unit, 20)}"


def _fits(name: str, scene: SceneEntry, families: Sequence[str], parts: Sequence[str]) -> str:
    """The numbers of the dots."""
    rows = "".join(
        f'<tr><th scope="row" class="name">{metric.replace("_", " ")}</th>'
        + "".join(
            f"<td>{_numbers(scene.metrics[metric].parts.get(part, []))}</td>" for part in parts
        )
        + "</tr>\n"
        for _, names in _shown(scene, families)
        for metric in names
        if any(scene.metrics[metric].parts.values())
    )
    if not rows:
        return ""
    heads = "".join(f'<th scope="col">{in_html(part, 20)}</th>' for part in parts)
    return f"""<details><summary>Scores of each fold and fit in numbers</summary>
<div class="scroll" role="region" aria-label="Each fold and fit on {name}" tabindex="0">
<table class="plain"><thead><tr><th scope="col" class="name">metric</th>{heads}</tr></thead>
<tbody>
{rows}</tbody></table>
</div></details>"""


def _numbers(values: Sequence[float | None]) -> str:
    shown = [NOTHING if value is None else plainly(value) for value in values]
    return "&ensp;".join(shown) or NOTHING
