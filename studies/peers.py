"""The page about models of other simulators, from their entries on the leaderboard."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.errors import SettingError
from crowdbench.files import replacing, write_text
from crowdbench.leaderboard.scores import View, scores
from crowdbench.leaderboard.verification.entry import AsRecorded, Entry, SceneEntry
from crowdbench.report.plots.canvas import picture
from crowdbench.report.text.words import NOTHING, interval, plainly
from crowdbench.scene import load_scene
from crowdbench.scoring.score import Score
from studies.markdown import flowed, table
from studies.site.standings import read_entries

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PEERS = Path("examples/peers")
ENTRIES = Path("leaderboard/entries")
OUT = Path("docs/peers.md")
SCENES = ("eth-v0", "hotel-v0", "zara1-v0", "gc-v0", "forum-v0")
OURS = ("straight", "orca", "speed-model", "social-force", "anticipate")
"""Entries that are shown beside."""
BEST = "anticipate"
CALIBRATED = ", calibrated"
"""End of the names of calibrated models."""

TITLE = """# Models of other simulators

Engineers know these models by name. They walk the people of the recordings here, and are judged as
every entry of the track *walk*: people enter at the recorded times and places, with the recorded
goals, speeds, stops and companions, and *walk* is the lesser of motion and interaction on held-out
time blocks ([how to read scores](metrics.md#how-to-read-a-table-of-scores)). 0 is the score of
straight walkers, 1 that of a perfect model. No model has a rank: they are entries of the
[leaderboard](../leaderboard/README.md) with the status *external*.

*Published* is a model with the default parameters of its library, *calibrated* one whose parameters
were chosen on the training blocks of each fold: {trials} trials of the tree-structured Parzen
estimator of Optuna, which starts from the published ones. On two long recordings, a trial walks
only the first {seconds}. As far as we know, most of these models have never been calibrated on
distributions of how people walk. A dash is what was not calibrated.

[examples/peers](../examples/peers/README.md) has the code, and says how people are handed over: the
rules of entering, via points and trips are those of crowdbench, and the routes around walls too.
The versions are in the names. A model that draws no random numbers walks once, as everywhere. Small
changes still grow into other crowds: other nudges of ORCA change its *motion* on ETH by ± 0.15
(`python -m examples.peers check`). `python -m studies peers` writes this page from the
leaderboard."""


@dataclass(frozen=True)
class Model:
    """A model of another simulator, as published and calibrated."""

    name: str
    published: Entry
    calibrated: Entry | None


def write_page(out: Path = OUT, entries: Path = ENTRIES) -> Path:
    """Write the page, and `exam.png` in its folder if a model was examined.

    Raises:
        SettingError: the leaderboard has no entry of another simulator.
    """
    everything = read_entries(entries)
    models = models_of(everything)
    ours = {e.id: e for e in everything if e.id in OURS}
    counts = json.loads((PEERS / "counts.json").read_text(encoding="utf-8"))
    told = json.loads((PEERS / "calibrated.json").read_text(encoding="utf-8"))
    seconds = " and ".join(
        f"{s:,.0f} s of {load_scene(scene).title.split(',')[0]}"
        for scene, s in told["seconds"].items()
    )
    title = TITLE.format(trials=told["trials"], seconds=seconds)
    parts = [flowed(title), "## All scenes\n", overview(models, ours), findings(models, ours)]
    parts += [_of_scene(scene, models, ours) for scene in SCENES]
    parts.append(_placed(models, counts))
    if any(model.published.exam for model in models):
        parts.append(_exam(out))
        with replacing(out.parent / out.stem / "exam.png") as temporary:
            temporary.write_bytes(scatter(models, ours))
    parts += [_crossing(), _parameters(told["parameters"])]
    write_text(out, "\n".join(parts))
    return out


def models_of(entries: Sequence[Entry]) -> list[Model]:
    """The external models, those with the highest score as published first."""
    external = {e.declared.name: e for e in entries if e.status == "external"}
    found = [
        Model(name, entry, external.get(name + CALIBRATED))
        for name, entry in external.items()
        if not name.endswith(CALIBRATED)
    ]
    if not found:
        raise SettingError(
            str(ENTRIES),
            got="no entry of another simulator",
            expected="one or more",
            hint="`python -m examples.peers entries` writes them; see examples/peers/README.md.",
        )
    return sorted(found, key=lambda model: (-_mean(model.published), model.name))


def overview(models: Sequence[Model], ours: Mapping[str, Entry]) -> str:
    """The table of walk scores: as published → calibrated."""
    lines = [
        [model.name, *(_both(model, scene) for scene in SCENES), _passed(model)] for model in models
    ]
    lines += [
        [f"*{name}*", *(_value(ours[name], scene) for scene in SCENES), _exams(ours[name])]
        for name in OURS
        if name in ours
    ]
    note = (
        "walk, as published → calibrated; *in italics*: policies of crowdbench. `!`: beyond the "
        "limits of the scene's gate, where walk is at most 0. *exam*: verification tests passed "
        "(see below)."
    )
    return f"{table(['model', *SCENES, 'exam'], lines)}\n\n{flowed(note)}"


def findings(models: Sequence[Model], ours: Mapping[str, Entry]) -> str:
    """What calibration changes, a list item for each scene with calibrated models."""
    items = []
    for scene in SCENES:
        view, gains, best = View(scene=scene), list[float](), list[tuple[float, str]]()
        for model in models:
            before = _score(model.published, view)
            after = None if model.calibrated is None else _score(model.calibrated, view)
            if before is not None and after is not None:
                gains.append(after.value - before.value)
                best.append((after.value, model.name))
        if gains:
            better = sum(gain > 0 for gain in gains)
            low, high = plainly(min(gains)), plainly(max(gains))
            value, name = max(best)
            known = ours[BEST].scenes if BEST in ours else {}
            beside = f"; {BEST} has {_value(ours[BEST], scene)}" if scene in known else ""
            items.append(
                f"- {scene}: calibration raises walk of {better} of {len(gains)} models; it "
                f"changes by {low} to {high}. The best is then {name} with "
                f"{plainly(value)}{beside}."
            )
    return flowed("\n".join(items)) if items else ""


def _both(model: Model, scene: str) -> str:
    after = NOTHING if model.calibrated is None else _value(model.calibrated, scene)
    return f"{_value(model.published, scene)} → {after}"


def _value(entry: Entry, scene: str) -> str:
    found = _score(entry, View(scene=scene))
    if found is None:
        return NOTHING
    return plainly(found.value) + (" !" if _as_recorded(entry.scenes[scene]).fails else "")


def _as_recorded(scene: SceneEntry) -> AsRecorded | SceneEntry:
    """The results under the recorded arrivals, which other simulators' models have."""
    return scene.as_recorded or scene


def _score(entry: Entry, view: View) -> Score | None:
    return scores(entry, recorded=True).get(view)


def _mean(entry: Entry, *others: Entry | None) -> float:
    """The mean walk score of the scenes that all these entries have; −1 without any."""
    entries = [entry, *(other for other in others if other is not None)]
    each = [[_score(e, View(scene=scene)) for e in entries] for scene in SCENES]
    known = [found[0].value for found in each if found[0] and all(found)]
    return float(np.mean(known)) if known else -1.0


def _exams(entry: Entry | None) -> str:
    if entry is None or entry.exam is None:
        return NOTHING
    return f"{len(entry.exam.passed)} of {len(entry.exam.passed) + len(entry.exam.failed)}"


def _passed(model: Model) -> str:
    return f"{_exams(model.published)} → {_exams(model.calibrated)}"


def _of_scene(scene: str, models: Sequence[Model], ours: Mapping[str, Entry]) -> str:
    lines = []
    for model in models:
        for what, entry in (("published", model.published), ("calibrated", model.calibrated)):
            if entry is not None and scene in entry.scenes:
                lines.append([model.name, what, *_line(entry, scene)])
    lines += [
        [f"*{name}*", "", *_line(ours[name], scene)]
        for name in OURS
        if name in ours and scene in ours[name].scenes
    ]
    head = ["model", "", "walk", "motion", "interaction", "speed, m/s", "at goal"]
    return f"## {load_scene(scene).title}\n\n{table(head, lines, text=2)}\n"


def _line(entry: Entry, scene: str) -> list[str]:
    of = _as_recorded(entry.scenes[scene])
    found = [_score(entry, View(family, scene)) for family in ("", "motion", "interaction")]
    speed = NOTHING if of.speed_mps is None else f"{of.speed_mps:.2f}"
    at_goal = NOTHING if of.at_goal is None else f"{100 * of.at_goal:.1f} %"
    return [
        *map(interval, found),
        speed + " !" * ("speed" in of.fails),
        at_goal + " !" * ("arrivals" in of.fails),
    ]


COUNTS = ("moved", "waited", "refused", "stood", "put back", "escaped")


def _placed(
    models: Sequence[Model], counts: Mapping[str, Mapping[str, Mapping[str, float]]]
) -> str:
    lines = []
    for model in models:
        of = counts.get(model.published.id, {})
        lines += [
            [model.name, scene, *(f"{of[scene][name]:,.0f}" for name in ("entered", *COUNTS))]
            for scene in SCENES
            if scene in of
        ]
    text = (
        "What could not be done as asked, as published. *Entered*: taken in where they were to "
        "enter. *Moved*: taken in up to 1 m away (5 cm in PySocialForce), because a wall or others "
        "were too near. *Waited*: stood at their start until they were taken in. *Refused*: never "
        "taken in; they stand until their time is over, and count. *Stood*: frames in which "
        "somebody who was taken out could not be put in again. *Put back*: times that a person was "
        "put where walls, bodies or the highest speed allow. *Escaped*: times that a person "
        "left the walkable area, or its position was no number; it goes on from its last one."
    )
    head = ["model", "scene", "entered", *COUNTS]
    return f"## Who could not be placed\n\n{flowed(text)}\n{table(head, lines, text=2)}\n"


def _exam(out: Path) -> str:
    text = (
        "The same models in the rooms of RiMEA, IMO and ISO 20414 ([the exam](exam.md)), with the "
        "time step and the bodies of ETH. The scatter shows who is good on recordings and bad in "
        "rooms, and the reverse: the mean of walk over the scenes of each model, and the number of "
        "tests passed. A line joins a model as published (open) and calibrated (filled), on the "
        "scenes that it was calibrated on. In the exam, calibrated parameters are those of ETH."
    )
    picture_of = f"![Tests passed, by walk score]({out.stem}/exam.png)"
    return f"## On recordings and in the exam\n\n{flowed(text)}\n{picture_of}\n"


def _crossing() -> str:
    text = (
        "The typical crossing of strangers in Grand Central (of median closest distance, see "
        "[encounters](encounters.md)), as recorded, and as four models walk everyone from "
        "the same moment on. Circles: where people are when the two are closest in the recording. "
        "Models are as published. `python -m examples.peers crossing` draws it."
    )
    return (
        f"## One crossing\n\n{flowed(text)}\n![A crossing in Grand Central](peers/crossing.png)\n"
    )


def _parameters(found: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]) -> str:
    parts = [
        "## Calibrated parameters\n",
        flowed(
            "By scene and fold. The published values and the ranges are in "
            "[models.py](../examples/peers/models.py)."
        ),
    ]
    for model, by_scene in found.items():
        names = list(next(iter(next(iter(by_scene.values())).values())))
        lines = [
            [scene, split, *(f"{values[name]:.3g}" for name in names)]
            for scene, splits in by_scene.items()
            for split, values in splits.items()
        ]
        head = ["scene", "fold", *(name.replace("_", " ") for name in names)]
        parts.append(f"### {model}\n\n{table(head, lines, text=2)}\n")
    return "\n".join(parts)


def scatter(models: Sequence[Model], ours: Mapping[str, Entry]) -> bytes:
    """A png of the tests passed over the mean walk score."""
    return picture(partial(_scatter, models=models, ours=ours), width=7.0, height=4.6, kind="png")


def _scatter(axes: "list[Axes]", *, models: Sequence[Model], ours: Mapping[str, Entry]) -> None:
    (axis,) = axes
    for k, model in enumerate(models):
        colour = f"C{k}"
        both = (model.published, model.calibrated)
        points = [
            (_mean(entry, *both), len(entry.exam.passed))
            for entry in both
            if entry is not None and entry.exam is not None
        ]
        if not points:
            continue
        axis.plot(*zip(*points, strict=True), color=colour, linewidth=1.0)
        axis.plot(*points[0], "o", color=colour, markerfacecolor="white", label=model.name)
        if len(points) > 1:
            axis.plot(*points[1], "o", color=colour)
    for name in OURS:
        entry = ours.get(name)
        if entry is not None and entry.exam is not None:
            at = (_mean(entry), len(entry.exam.passed))
            axis.plot(*at, "s", color="0.3", markersize=4)
            axis.annotate(name, at, xytext=(5, 4), textcoords="offset points", fontsize=8)
    axis.set_xlabel("walk, mean over scenes")
    axis.set_ylabel("tests of the exam that are passed")
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
