"""`pages/ID.html`: the page of one entry."""

from collections.abc import Mapping

from crowdbench.leaderboard.scores import View
from crowdbench.report.html.player import SCRIPT, STYLE
from crowdbench.report.html.render import html_page
from crowdbench.report.text.words import with_interval
from studies.clips import Clips
from studies.site.players import NONE, entry_player
from studies.site.render import html, own
from studies.site.scene_results import scene_results
from studies.site.standings import Line, Standing
from studies.site.text import plain

_STATUS = {
    "ranked": "Ranked: crowdbench ran the rollouts and scored them on held-out data.",
    "listed": "Listed, not ranked: crowdbench did not run the rollouts, or the models were trained "
    "on the recordings that they are scored on.",
    "external": "A model of another simulator, not ranked: crowdbench ran the rollouts and scored "
    "them on held-out data.",
    "reference": "An unranked reference, shown for comparison.",
}
_KIND = {
    "learned": "learned",
    "model-based": "model-based",
    "privileged": "privileged (uses the simulation’s state instead of observations)",
}
_TRAINING = {
    "heldout": "heldout: each fold’s models were trained on that fold’s training blocks only",
    "none": "none: trained on no recording of these scenes",
    "full": "full: trained on whole recordings",
}


def entry_page(
    line: Line, standing: Standing, clips: Mapping[str, Clips] = {}, *, definitions: str = ""
) -> str:
    """The page of an entry as HTML.

    `standing` is that of its track, `clips` are those of all entries by id, and `definitions` is
    the address of the page that defines the metrics.
    """
    entry, declared = line.entry, line.entry.declared
    scenes = [scene for scene in standing.scenes if scene in entry.scenes]  # as in all tables
    body = html(
        "entry.html.j2",
        line=line,
        standing=standing,
        scenes=scenes,
        status=_STATUS[entry.status],
        kind=_KIND[declared.kind],
        protocol=_TRAINING[declared.training.protocol],
        results=[
            scene_results(name, entry, entry_player(name, line, standing, clips), definitions)
            for name in scenes
        ],
        scores=[
            f"{scene or 'overall'} {with_interval(line.scores[View(scene=scene)])}"
            for scene in ("", *scenes)
            if View(scene=scene) in line.scores
        ],
        earlier_scenes=sorted({name for earlier in entry.history for name in earlier.scenes}),
    )
    title = f"{plain(declared.name, 80)}: crowdbench leaderboard"
    moving = bool(clips.get(entry.id, NONE).scenes)
    style = own("pages.css") + STYLE if moving else own("pages.css")
    return html_page(title, body, style=style, script=SCRIPT if moving else "")
