"""An entry's results on one scene: every metric, every fit, and plots."""

from markupsafe import Markup

from crowdbench.leaderboard.scores import FAMILIES_OF, are_trajectories, gate_notes
from crowdbench.leaderboard.verification.entry import Entry
from crowdbench.leaderboard.verification.flags import trip_limit
from crowdbench.leaderboard.verification.soundness import FAMILY_OF
from crowdbench.metrics import METRICS, Metric
from studies.site.curves import figure
from studies.site.render import html


def scene_results(name: str, entry: Entry, player: Markup, definitions: str = "") -> Markup:
    """The section of one scene as HTML: facts, a player of crowds, tables and plots.

    `definitions` is the address of the page that defines the metrics.
    """
    scene = entry.scenes[name]
    # Families and metrics have the same order in all tables; unknown metrics are not shown.
    known = {m.name: scene.metrics[m.name] for m in METRICS if m.name in scene.metrics}
    families = [
        (family, {n: metric for n, metric in known.items() if FAMILY_OF[n] == family})
        for family in FAMILIES_OF[entry.declared.track]
    ]
    shown = [(family, metrics) for family, metrics in families if metrics]
    declared = entry.declared
    return html(
        "scene.html.j2",
        name=name,
        player=player,
        definitions=definitions,
        meanings={metric.name: meaning(metric) for metric in METRICS},
        scene=scene,
        recorded=scene.as_recorded.families if scene.as_recorded else {},
        track=declared.track,
        given=are_trajectories(entry),
        # A policy that is trained on no recording is the same in all folds: its rollouts of the
        # whole recording serve each of them.
        per_fold=declared.track != "walk",
        walks_per_fold=entry.status == "external" and declared.training.protocol == "heldout",
        trip_limit=trip_limit(name),
        gate=gate_notes(entry).get(name, ""),
        families=shown,
        splits=list(dict.fromkeys(split for m in scene.metrics.values() for split in m.splits)),
        fits={n: m for _, each in shown for n, m in each.items() if any(m.splits.values())},
        figures=[figure(title, curve) for title, curve in scene.curves.items()],
    )


def meaning(metric: Metric) -> str:
    """The first sentence on a metric."""
    return " ".join((metric.__doc__ or "").split("\n\n")[0].split())
