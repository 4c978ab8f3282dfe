"""Scores of an entry: by family and scene, and over all scenes."""

from typing import NamedTuple

from crowdbench.leaderboard.submission.schema import SCENES, Track
from crowdbench.leaderboard.verification.entry import Entry
from crowdbench.leaderboard.verification.soundness import FAMILY_OF
from crowdbench.metrics import FAMILIES, WALK
from crowdbench.report.text.notes import beyond_gate, effect_of_gate
from crowdbench.scene import load_scene
from crowdbench.scoring.score import Score, combined, total_score

FAMILIES_OF: dict[Track, tuple[str, ...]] = {
    "walk": WALK,
    "spawn": tuple(family for family in FAMILIES if family not in WALK),
    "crowd": FAMILIES,
}


class View(NamedTuple):
    """The part of an entry that is ranked: a family and a scene.

    Empty strings stand for all families, and for the scenes of the overall score.
    """

    family: str = ""
    scene: str = ""


def scores(entry: Entry, *, gated: bool = True, recorded: bool = False) -> dict[View, Score]:
    """The scores of an entry, by the views in which it has one.

    A scene's score combines its families (see `total_score`), if no scored family is missing. The
    overall score, in total and of each family, is the mean of the scenes in `SCENES`, if none is
    missing. Crowds submitted as trajectories do not have the recorded arrivals, so they are scored
    without motion and interaction. With `gated=False`, the scores are those without the gate; with
    `recorded`, those of walking are under the recorded arrivals, where policies are ranked under
    perturbed ones.
    """
    families = FAMILIES_OF[entry.declared.track]
    if entry.declared.track == "crowd" and are_trajectories(entry):
        families = FAMILIES_OF["spawn"]
    found: dict[View, Score] = {}
    for name, scene in entry.scenes.items():
        exact = scene.as_recorded if recorded else None
        cards = scene.families | (exact.families if exact else {})
        fails = exact.fails if exact else scene.fails
        each = {f: cards[f].score() for f in families if f in cards}
        found |= {View(family, name): score for family, score in each.items()}
        counted = {FAMILY_OF[metric] for metric, m in scene.metrics.items() if m.scored}
        whole = total_score(each, passes=not (fails and gated))
        if whole is not None and counted & set(families) <= set(each):
            found[View(scene=name)] = whole
    if all(View(scene=name) in found for name in SCENES):
        for family in ("", *families):
            known = [found[View(family, s)] for s in SCENES if View(family, s) in found]
            mean = combined(known)
            if mean is not None:
                found[View(family)] = mean
    return found


def gate_notes(entry: Entry) -> dict[str, str]:
    """By scene, a note on the limits of the gate that the entry exceeds and on their effect."""
    found, without = scores(entry), scores(entry, gated=False)
    notes = {}
    for name, scene in entry.scenes.items():
        if scene.fails:
            exceeded = beyond_gate(
                scene.fails,
                load_scene(name).gate,
                (scene.speed_mps, scene.recorded_speed_mps),
                (scene.at_goal, scene.recorded_at_goal),
            )
            view = View(scene=name)
            walks = entry.declared.track == "walk"
            of = "the score" if walks else "the score (the mean of crowd and walk)"
            effect = effect_of_gate(of, found.get(view), without.get(view))
            notes[name] = f"The policy does not pass the gate: {exceeded}. {effect}"
    return notes


def are_trajectories(entry: Entry) -> bool:
    """Whether an entry was submitted as trajectories of another program."""
    return any("/trajectories/" in name for name in entry.artefacts)
