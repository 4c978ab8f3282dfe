"""The report of an evaluation, `report.html`: a single page that needs no network.

It shows the scorecard, and pictures of the rollouts beside the recording. It computes no scores of
its own. The page depends on neither the machine nor the time: the same evaluation gives the same
bytes, where PedPy (for flow and density) is installed or where it is not.
"""

import shlex
from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from crowdbench.data.table import Trajectories
from crowdbench.files import write_text
from crowdbench.registry.map_images import map_of
from crowdbench.report.display_names import Names, names_of
from crowdbench.report.html.pictures import pictures
from crowdbench.report.html.player import SCRIPT, STYLE, clip_of, player
from crowdbench.report.html.render import html, html_page, own
from crowdbench.report.html.tables import metric_tables, outcome_table, score_table
from crowdbench.report.plots.measured import RECORDED
from crowdbench.report.plots.plot_data import Crowds, PlotData
from crowdbench.report.text.notes import made
from crowdbench.report.text.words import PROTOCOLS, named
from crowdbench.scene import Scene
from crowdbench.scoring.ranking import Row, ordered, rows
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.scorecard import ANCHOR, Scorecard, has_recorded_arrivals
from crowdbench.spawn.names import replays


def write_report(
    card: Scorecard,
    scene: Scene,
    reference: Reference,
    crowds: Crowds,
    out: Path,
    *,
    recording: Trajectories | None = None,
) -> Path:
    """Write `report.html` into `out` and return its path.

    `crowds` are rollouts of each entry in the protocol's first split, for the pictures and the
    player, which shows the `recording` too. All scores come from the scorecard.

    Raises:
        OutputError: the file cannot be written.
    """
    path = out / "report.html"
    plot = PlotData.of(scene, reference, crowds, card.protocol)
    write_text(path, _page(card, plot, crowds, recording))
    return path


def _page(card: Scorecard, plot: PlotData, crowds: Crowds, recording: Trajectories | None) -> str:
    scene, table = plot.scene, rows(card)
    names = names_of([(row.spawn, row.policy) for row in table], scene)
    shown = [e for e in card.entries if not replays(e.spawn)] or card.entries
    body = html(
        "report.html.j2",
        card=card,
        scene=scene,
        spawns=list(dict.fromkeys(names.spawn[e.spawn] for e in shown)),
        policies=list(dict.fromkeys(names.policy[e.policy] for e in shown)),
        anchor=ANCHOR,
        resamples=f"{card.resamples:,}",
        protocol=PROTOCOLS[card.protocol].removesuffix("."),
        made=made(card),
        walked=has_recorded_arrivals(card),
        scores=score_table(card, table, names),
        metrics=metric_tables(card, plot, names),
        recorded=recording is not None,
        player=_player(scene, table, crowds, recording, names),
        pictures=pictures(plot) if plot.groups else "",
        command=_command(card, scene),
        outcomes=outcome_table(card, names),
    )
    return html_page(
        f"{scene.title}: crowdbench report", body, style=own("style.css") + STYLE, script=SCRIPT
    )


def _player(
    scene: Scene,
    table: Sequence[Row],
    crowds: Crowds,
    recording: Trajectories | None,
    names: Names,
) -> Markup:
    """The best crowd, then the recording if it is there, and then the others."""
    first: dict[tuple[str, str], Trajectories] = {}
    for (spawn, policy, _), crowd in crowds.items():
        first.setdefault((spawn, policy), crowd)
    pairs = [(row.spawn, row.policy) for row in ordered(table) if (row.spawn, row.policy) in first]
    shown = [(names.pair(*pair), first[pair]) for pair in pairs]
    if recording is not None:
        shown.insert(1, (RECORDED, recording))
    clips = [(label, clip_of(crowd, scene)) for label, crowd in shown]
    return player(scene, clips, map_of(scene)) if clips else Markup()


def _command(card: Scorecard, scene: Scene) -> str:
    pairs = [(e.spawn, e.policy) for e in card.entries]
    spawn = list(dict.fromkeys(s for s, _ in pairs))
    # `evaluate` runs every policy except `replay` under the recorded arrivals by default.
    if spawn != ["replay"] and ("replay", "replay") not in pairs:
        spawn = [s for s in spawn if s != "replay"]
    policy = list(dict.fromkeys(p for _, p in pairs))
    words = ["crowdbench", "evaluate", named(scene), "--spawn", *spawn, "--policy", *policy]
    return shlex.join([*words, "--protocol", card.protocol, "--seeds", str(card.rollouts)])
