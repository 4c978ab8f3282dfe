"""The Markdown text of the page on policies."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from crowdbench.metrics import METRICS, WALK, MetricResult
from crowdbench.report.text.words import NOTHING, interval, named, plainly, share, speed
from crowdbench.scene import Scene
from crowdbench.scoring.ceilings import read_ceilings
from crowdbench.scoring.classifier import Auc
from crowdbench.scoring.ranking import metric_scores, rows, scale_of
from crowdbench.scoring.score import ranks
from crowdbench.scoring.scorecard import PairResult, Scorecard
from studies.markdown import flowed, table
from studies.results.page import of_recording
from studies.results.tables import distance_table, gated

_FAMILIES = ("trips", *WALK)
_ENDS = ("goal", "exit", "timeout")
FAR = 0.01
"""Distances of recorded people walked from which on the page names them."""


@dataclass(frozen=True, eq=False)
class Walked:
    """The evaluations of all policies on a scene."""

    scene: Scene
    names: dict[str, str]
    """Display name of each policy."""
    sees: dict[str, str]
    """Input of each policy, `observation` or `state`."""
    card: Scorecard
    """Held-out scorecard under the recorded arrivals."""
    sampled: Scorecard
    """Scorecard under arrivals of a spawn model that is fitted to the whole recording."""
    rule: dict[str, MetricResult]
    """Metrics of recorded people walked."""
    told: dict[str, Auc | None]
    """How well a classifier tells one rollout of each policy from the recording."""


def page(found: Sequence[Walked], more: Sequence[str], seeds: int | None) -> str:
    """The page in Markdown; the same evaluations give the same bytes."""
    words = ["python", "-m", "studies", "walks", *(named(walked.scene) for walked in found)]
    if more:
        words += ["--policy", *more]
    if seeds is not None:
        words += ["--seeds", str(seeds)]
    scenes = "\n\n".join(_scene(walked) for walked in found)
    first = found[0]
    return flowed(f"""# How policies walk

People enter at the recorded times and places, with the recorded speeds and goals, and are moved by
a policy. `docs/metrics.md` explains how to read a table of scores. The last row is an estimate of
what a right model would get whose people act by chance: what `anticipate` would get if the
recording were one of its rollouts (`python -m studies ceilings`). The column *sees* is the input
of a policy: *observation*, that of an agent in the environment, including its rays, or *state*, the
positions, velocities and goals of all people (random uses none of it).

Generated with crowdbench {first.card.crowdbench} by

```sh
{shlex.join(words)}
```

{scenes}
""")


def _scene(walked: Walked) -> str:
    scene = walked.scene
    parts = [f"## {scene.title} ({scene.id})", of_recording(scene)]
    parts += [
        f"### Scores, held out\n\n{scores(walked, walked.card)}",
        f"### Distances, held out\n\n{distance_table(walked.card, _FAMILIES, walked.names)}",
        f"### Do they arrive?\n\n{_lives(walked)}",
        f"### Can they be told apart?\n\n{_told(walked)}",
        _rule(walked),
    ]
    parts += [
        f"### Dwell times\n\n![Dwell times](walks/{scene.id}-dwell.png)",
        "Share of people who stay longer, in one rollout of each policy under the recorded "
        "arrivals. Networks were trained on the whole recording. Grey band: 95 % of resamples of "
        "the recording’s time blocks.",
    ]
    return "\n\n".join(parts)


def scores(walked: Walked, card: Scorecard) -> str:
    """Markdown table of the policies with scores, and why others have none."""
    known = [row for row in rows(card) if row.kind == "entry" and row.walk is not None]
    rank = ranks([row.walk for row in known if row.walk is not None])
    scored = [m for m in METRICS if m.family in WALK and m.name in card.scored]
    head = ["policy", "sees", "rank", "walk", *WALK, "speed, m/s", "at goal"]
    head += [m.name.replace("_", " ") for m in scored]
    lines, scale = [], scale_of(card)
    for row, of_row in zip(known, rank, strict=True):
        each = metric_scores(scale, row.entry)
        lines.append(
            [
                walked.names[row.policy],
                walked.sees[row.policy],
                str(of_row),
                interval(row.walk),
                *(interval(row.families.get(family)) for family in WALK),
                gated(row, "speed", speed(row.entry.speed_mps)),
                gated(row, "arrivals", share(row.entry.at_goal)),
                *(interval(each.get(m.name)) for m in scored),
            ]
        )
    if lines and (ceilings := read_ceilings(walked.scene)):
        of = ceilings.recorded
        right = [_rounded(of.walk), *(_rounded(of.families.get(family)) for family in WALK), "", ""]
        values = [_rounded(of.metrics.get(m.name)) for m in scored]
        lines.append(["*a right model, about*", "", "", *right, *values])
    shown = [table(head, lines, text=2)] if lines else []
    return "\n\n".join(shown + _unscored(walked, card, {row.policy for row in known}))


def _rounded(value: float | None) -> str:
    return NOTHING if value is None else plainly(value)


def _told(walked: Walked) -> str:
    """Markdown table of the classifier's results, and its control."""
    known = {policy: of for policy, of in walked.told.items() if of is not None}
    if not known:
        return "There are too few windows, or the classifier tells the recording from itself."
    lines = [
        [walked.names[policy], f"{of.value:.2f} ± {of.error:.2f}"] for policy, of in known.items()
    ]
    lines.append(["recording", f"{next(iter(known.values())).control:.2f}"])
    return (
        "A classifier sees windows of 5 s of people who walk, in one rollout of each policy under "
        "the recorded arrivals, and learns which are recorded. On windows that it has not seen, "
        "its AUC is 0.5 if they cannot be told apart, and 1 if they always can. The last row is a "
        "control: the recording, treated like a rollout. It sees single persons only, so it is "
        "blind to avoidance and ranks nothing.\n\n" + table(["policy", "AUC"], lines, text=1)
    )


def _unscored(walked: Walked, card: Scorecard, scored: set[str]) -> list[str]:
    """A sentence on the policies without scores; empty if there are none."""
    missing = [name for policy, name in walked.names.items() if policy not in scored]
    if not missing:
        return []
    return [
        f"No scores: {', '.join(missing)}. Rollouts of each policy: {card.rollouts}. "
        "Scores need two."
    ]


def _lives(walked: Walked) -> str:
    """Markdown table of arrivals at the goal, mean speeds and dwell times."""
    sampled = walked.sampled
    spawn = sampled.entries[0].spawn
    both = (("recorded", walked.card, "replay"), (spawn, sampled, spawn))
    columns = ("at goal", "speed, m/s", "dwell, W1/mean")
    head = ["policy", *(f"{what} ({arrivals})" for arrivals, _, _ in both for what in columns)]
    lines = []
    for policy, name in walked.names.items():
        line = [name]
        for _, card, of_spawn in both:
            entry = next(e for e in card.entries if (e.spawn, e.policy) == (of_spawn, policy))
            line += _life(entry)
        lines.append(line)
    return table(head, lines)


def _life(entry: PairResult) -> list[str]:
    ended = sum(entry.outcomes.get(how, 0) for how in _ENDS)
    arrived = entry.outcomes.get("goal", 0)
    return [
        f"{100 * arrived / ended:.1f} %" if ended else NOTHING,
        speed(entry.speed_mps),
        _plain(entry.metrics["dwell"].distance),
    ]


def _plain(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.3f}"


def _rule(walked: Walked) -> str:
    far = {name: result for name, result in walked.rule.items() if result.distance >= FAR}
    if not far:
        rest = f"All its distances to the recording are below {FAR:g}."
    else:
        listed = ", ".join(f"{n.replace('_', ' ')} {r.distance:.3f}" for n, r in far.items())
        rest = f"Its distances to the recording are below {FAR:g}, but for {listed}."
    return (
        "Recorded trips are cut off where simulated ones end, at the first step to the goal after "
        "the last stop. So `recorded-paths`, which walks recorded people under the rules of the "
        f"simulation, shows what a perfect walker scores. {rest}"
    )
