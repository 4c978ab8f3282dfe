"""The page in Markdown."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from crowdbench.metrics import METRICS, WALK, MetricResult
from crowdbench.report.text.markdown import flowed, table
from crowdbench.report.text.words import NOTHING, interval, named
from crowdbench.scene import Scene
from crowdbench.scoring.score import ranks
from crowdbench.scoring.scorecard import PairResult, Protocol, Scorecard, metric_scores, rows
from crowdbench.studies.results.page import of_recording
from crowdbench.studies.results.tables import distance_table, with_unit

_NAMES: dict[Protocol, str] = {"full": "Full", "heldout": "Held out"}
_FAMILIES = ("lives", *WALK)
_ENDS = ("goal", "exit", "timeout")


@dataclass(frozen=True, eq=False)
class Walked:
    """What was found out on a scene."""

    scene: Scene
    names: dict[str, str]
    """How tables call each policy."""
    sees: dict[str, str]
    """What each policy acts on, `observation` or `state`."""
    cards: dict[Protocol, Scorecard]
    """Under the recorded arrivals."""
    sampled: Scorecard
    """Under arrivals of a spawn model, fitted on all of the recording."""
    rule: dict[str, MetricResult]
    """What the metrics say of the recorded paths, cut off where they first come to their goals."""


def page(found: Sequence[Walked], more: Sequence[str], seeds: int | None) -> str:
    """The page; the same evaluations give the same bytes."""
    words = ["crowdbench", "walks", *(named(walked.scene) for walked in found)]
    if more:
        words += ["--policy", *more]
    if seeds is not None:
        words += ["--seeds", str(seeds)]
    scenes = "\n\n".join(_scene(walked) for walked in found)
    first = found[0]
    return flowed(f"""# How policies walk

Everyone enters when and where recorded people did, with the speed and the goal that they had, and
is walked by a policy. What scores, brackets, ranks and protocols are is explained in
`docs/metrics.md`; *walk* is the mean of motion and interaction. Who sees *observations* sees what
an agent in the environment does, its rays among it; who sees the *state*, positions, velocities and
goals of everyone (random looks at nothing).

Made with crowdbench {first.cards["full"].crowdbench} by

```sh
{shlex.join(words)}
```

{scenes}
""")


def _scene(walked: Walked) -> str:
    scene = walked.scene
    parts = [f"## {scene.title} ({scene.id})", of_recording(scene)]
    parts += [f"### {_NAMES[p]}\n\n{scores(walked, card)}" for p, card in walked.cards.items()]
    parts += [
        f"### Distances, {_NAMES[p].lower()}\n\n{_distances(walked, card)}"
        for p, card in walked.cards.items()
    ]
    parts += [f"### Do they arrive?\n\n{_lives(walked)}", _rule(walked)]
    parts += [
        f"### Dwell times\n\n![Dwell times](walks/{scene.id}-dwell.png)",
        "Share of people who stay longer, all rollouts under the recorded arrivals together; grey "
        "is what 95 % of the resamples of the recording’s time blocks lie between.",
    ]
    return "\n\n".join(parts)


def scores(walked: Walked, card: Scorecard) -> str:
    """A table of those who have a score, and why others have none."""
    known = [row for row in rows(card) if row.kind == "entry" and row.walk is not None]
    rank = ranks([row.walk for row in known if row.walk is not None])
    scored = [m for m in METRICS if m.family in WALK and m.name in card.scored]
    head = ["policy", "sees", "rank", "walk", *WALK, *(m.name.replace("_", " ") for m in scored)]
    lines = []
    for row, of_row in zip(known, rank, strict=True):
        each = metric_scores(card, row.entry)
        lines.append(
            [
                walked.names[row.policy],
                walked.sees[row.policy],
                str(of_row),
                interval(row.walk),
                *(interval(row.families.get(family)) for family in WALK),
                *(interval(each.get(m.name)) for m in scored),
            ]
        )
    shown = [table(head, lines, text=2)] if lines else []
    return "\n\n".join(shown + _unscored(walked, card, {row.policy for row in known}))


def _unscored(walked: Walked, card: Scorecard, scored: set[str]) -> list[str]:
    """Why policies are missing from the table of scores."""
    missing = [name for policy, name in walked.names.items() if policy not in scored]
    if not missing:
        return []
    made = f"{card.rollouts} {'was' if card.rollouts == 1 else 'were'} made"
    return [
        f"No score of {', '.join(missing)}: that needs at least two rollouts of each of the "
        f"{card.fits} fits, {2 * card.fits} in all; {made}."
    ]


def _distances(walked: Walked, card: Scorecard) -> str:
    return distance_table(card, _FAMILIES, walked.names)


def _lives(walked: Walked) -> str:
    """Who arrives, how long they stay and how near they come to each other, two arrivals."""
    full, sampled = walked.cards["full"], walked.sampled
    spawn = sampled.entries[0].spawn
    both = (("recorded", full, "replay"), (spawn, sampled, spawn))
    columns = ("at goal", "dwell, W1/mean", "closest approach, W1/mean", "wall hits")
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
    walls = entry.metrics["wall_hits"].simulated
    return [
        f"{100 * arrived / ended:.1f} %" if ended else NOTHING,
        *(_plain(entry.metrics[name].distance) for name in ("dwell", "closest_approach")),
        NOTHING if walls is None else f"{100 * walls:.2f} %",
    ]


def _plain(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.3f}"


def _rule(walked: Walked) -> str:
    dwell = walked.rule["dwell"]
    return (
        "A simulated life ends where its way first comes to the goal, a recorded one with its "
        f"record: people who linger there do so in the recording alone (mean dwell time "
        f"{with_unit(dwell.recorded, dwell.unit)}). Of the recorded paths themselves, cut off by "
        f"that rule, the dwell time is {with_unit(dwell.simulated, dwell.unit)} in the mean and "
        f"{dwell.distance:.3f} from the recording’s, which is what a policy that walks just as "
        "people did would get here."
    )
