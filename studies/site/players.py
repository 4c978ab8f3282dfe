"""Players of crowds on the pages of entries and of results."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from markupsafe import Markup

from crowdbench.leaderboard.scores import View
from crowdbench.leaderboard.verification.entry import Entry
from crowdbench.report.html.player import Clip, Labelled, player
from crowdbench.scene import load_scene
from studies.clips import ARRIVALS, Clips, read_clips
from studies.site.standings import Line, Standing
from studies.site.text import plain

RIVALS = 2
"""Number of other crowds beside an entry's own."""
NONE = Clips()


def label_of(entry: Entry) -> str:
    """What a player calls an entry's crowd."""
    arrivals = f", arrivals of {ARRIVALS}" if entry.declared.track == "walk" else ""
    return f"{plain(entry.declared.name, 60)}{arrivals}"


def entry_player(scene: str, line: Line, standing: Standing, clips: Mapping[str, Clips]) -> Markup:
    """An entry's crowd on a scene beside those of the best others, and of the anchor.

    `clips` are those of all entries by id. Nothing is shown of an entry without a clip.
    """

    def clip(other: Line) -> Clip | None:
        return clips.get(other.entry.id, NONE).scenes.get(scene)

    if clip(line) is None:
        return Markup()
    view = View(scene=scene)
    others = [other for other in standing.ordered(view) if other is not line and clip(other)]
    anchors = [other for other in others if is_anchor(other, view)]
    best = [other for other in others if other not in anchors][: RIVALS - len(anchors)]
    lines = [line, *best, *anchors]
    shown = [(label_of(each.entry), found) for each in lines if (found := clip(each))]
    return player(load_scene(scene), shown)


def is_anchor(line: Line, view: View) -> bool:
    """Whether an entry is the one whose score is 0."""
    return line.entry.status == "reference" and line.scores[view].value == 0


def scene_players(standings: Sequence[Standing], root: Path) -> dict[str, Markup]:
    """A player for each scene with the crowds of a leaderboard: the best one, the anchor, and more.

    Entries of different tracks may have the same crowd, which is shown once.

    Raises:
        WeightsError: clips are broken.
    """
    found: dict[str, list[tuple[bool, Labelled]]] = {}
    for standing in sorted(standings, key=lambda each: each.track):  # crowd, spawn, walk
        for scene in standing.scenes:
            view = View(scene=scene)
            for line in standing.ordered(view):
                clip = read_clips(line.entry, root).scenes.get(scene)
                shown = found.setdefault(scene, [])
                if clip is not None and clip not in [known for _, (_, known) in shown]:
                    anchor = standing.track == "crowd" and is_anchor(line, view)
                    shown.append((anchor, (label_of(line.entry), clip)))
    return {
        scene: player(load_scene(scene), _anchor_second(shown))
        for scene, shown in found.items()
        if shown
    }


def _anchor_second(crowds: Sequence[tuple[bool, Labelled]]) -> list[Labelled]:
    """The crowds in their order, but with those that are marked behind the first one."""
    first, *others = crowds
    return [each for _, each in (first, *sorted(others, key=lambda of: not of[0]))]
