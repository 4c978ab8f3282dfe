"""`check_scene`: checks that the files of a scene are complete and consistent."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from crowdbench.data.blocks import FOLDS, SPLITS
from crowdbench.data.recordings.catalogue import SOURCES
from crowdbench.data.table import Trajectories
from crowdbench.errors import CrowdbenchError, SceneError
from crowdbench.metrics import metrics_for
from crowdbench.registry import FITTED, has_recording, raw_recording_of, trained_policies
from crowdbench.scene import Scene, load_scene
from crowdbench.scene_building.fit import check_against, not_a_fit, same_areas
from crowdbench.scene_building.rules import LEFT_OUT
from crowdbench.scoring.reference import Reference, read_reference, sparse
from crowdbench.scoring.scorecard import read_anchors
from crowdbench.spawn import Areas, fit_areas
from crowdbench.spawn.areas import read_areas

T = TypeVar("T")
_NEEDED = "poisson-gmm"  # the anchor's spawn model; other models are optional
_NOT_LOOKED_AT = "not checked"


@dataclass(frozen=True)
class Finding:
    """Result of the check of one part of a scene; `problem` is the error that was found."""

    part: str
    state: str
    problem: CrowdbenchError | None = None


def check_scene(scene: str | Path) -> Iterator[Finding]:
    """Check all parts of a scene and yield a `Finding` for each.

    Errors in a part are returned as the `problem` of its finding.

    Raises:
        SceneError: there is no such scene, or its `scene.toml` is broken.
    """
    place = load_scene(scene)
    yield Finding(
        "scene.toml", f"{place.title}; {place.horizon_s:.0f} s; walls: {len(place.walls)}"
    )
    areas, finding = _read("areas", read_areas, _areas, place)
    yield finding
    reference, finding = None, Finding("reference", _NOT_LOOKED_AT)
    if areas is not None:
        reference, finding = _read("reference", read_reference, _blocks, place)
    yield finding
    for model in FITTED:
        yield _look(model, lambda model=model: _weights(model, place, areas))  # type: ignore[misc]
    complete = areas is not None and reference is not None
    yield _look("anchors", lambda: _anchors(place) if complete else _NOT_LOOKED_AT)
    yield _look("scored metrics", lambda: _scored(place, reference))
    yield Finding("policies", ", ".join(trained_policies(place)) or "none trained")
    yield _look("recording", lambda: _recording(place, areas, reference))


def _look(part: str, at: Callable[[], str]) -> Finding:
    try:
        return Finding(part, at())
    except CrowdbenchError as error:
        return Finding(part, "wrong", error)


def _read(
    part: str, read: Callable[[Scene], T], tell: Callable[[Scene, Any], str], scene: Scene
) -> tuple[T | None, Finding]:
    """The content of a part, or None if it cannot be read, and the finding."""
    try:
        there = read(scene)
    except CrowdbenchError as error:
        return None, Finding(part, "wrong", error)
    return there, _look(part, lambda: tell(scene, there))


def _areas(scene: Scene, areas: Areas) -> str:
    most = max(areas.left_out)
    if most >= LEFT_OUT:
        got = f"{most:.1%} of the starts or ends in no area, or only in the broad one"
        expected = f"less than {LEFT_OUT:.0%}"
        hint = "Increase eps_m in [clustering.default] of scene.toml, and fit the scene again."
        raise SceneError(scene.folder / "areas.json", got=got, expected=expected, hint=hint)
    return f"{len(areas.spawn)} spawn, {len(areas.goal)} goal; at most {most:.1%} left out"


def _blocks(scene: Scene, reference: Reference) -> str:
    blocks = reference.blocks
    if len(blocks) < FOLDS:
        got = f"{len(blocks)} time blocks"
        expected = f"{FOLDS} or more, at least one per fold"
        hint = "Decrease protocol.block_s, and fit the scene again."
        raise SceneError(scene.folder / "scene.toml", got=got, expected=expected, hint=hint)
    return f"{len(blocks)} time blocks, {blocks.exposure_s():.0f} s"


def _weights(model: str, scene: Scene, areas: Areas | None) -> str:
    if areas is None:
        return _NOT_LOOKED_AT
    if model != _NEEDED and not any(scene.folder.glob(f"{model}.*")):
        return "missing (optional)"
    for split in SPLITS:
        for fit in range(scene.protocol.fits):
            FITTED[model].read(scene, areas, split, fit)
    return f"fitted for {', '.join(SPLITS)}"


def _anchors(scene: Scene) -> str:
    anchors = read_anchors(scene)
    return f"{len(anchors.protocols['full'].anchors)} crowds in each protocol"


def _scored(scene: Scene, reference: Reference | None) -> str:
    scored = scene.protocol.scored
    if reference is None:
        return _NOT_LOOKED_AT
    written = "\nscored = [" in (scene.folder / "scene.toml").read_text(encoding="utf-8")
    if written and not scored:
        return "none: no metric distinguishes the anchor from the recording"
    unknown = set(scored) - {metric.name for metric in metrics_for(reference.blocks)}
    if unknown or not scored:
        names = ", ".join(sorted(unknown))
        got = f"{names} in protocol.scored" if scored else "no protocol.scored"
        expected = "at least one metric, and only metrics that apply to time blocks of this length"
        hint = f"Import the recording, and run `crowdbench scene power {scene.asked} --write`."
        raise SceneError(scene.folder / "scene.toml", got=got, expected=expected, hint=hint)
    return f"{len(scored)} of {len(metrics_for(reference.blocks))}"


def _recording(scene: Scene, areas: Areas | None, reference: Reference | None) -> str:
    name = scene.recording.name
    if not has_recording(scene):
        return f"{name} is not imported: nothing was compared with it"
    crowd = raw_recording_of(scene)
    _check_hash(scene, crowd)
    check_against(scene, crowd)
    if areas is None or reference is None:
        return f"{name}, {len(crowd)} persons; areas and statistics {_NOT_LOOKED_AT}"
    fresh_areas, crowd = fit_areas(crowd, scene, scene.clustering["default"])
    if not same_areas(areas, fresh_areas):
        raise not_a_fit(scene, "areas.json")
    if not _same_statistics(reference, Reference.of(crowd, scene, fresh_areas)):
        raise not_a_fit(scene, "reference.json.gz")
    return f"{name}, {len(crowd)} persons; areas and statistics match"


def _check_hash(scene: Scene, crowd: Trajectories) -> None:
    name = scene.recording.name
    stated = SOURCES[name].sha256 if name in SOURCES else scene.recording.sha256
    got = crowd.provenance.get("sha256")
    if stated and got != stated:
        raise SceneError(
            f"recording {name}",
            got=f"imported data with SHA-256 {str(got)[:12]}…",
            expected=f"data with SHA-256 {stated[:12]}…, from which {scene.id} was created",
            hint="Import the recording from which the scene was created.",
        )


def _same_statistics(a: Reference, b: Reference) -> bool:
    """Whether the statistics are equal, apart from columns of zeros at their ends."""
    return np.array_equal(a.blocks.frames, b.blocks.frames) and all(
        sparse(counts)[1] == sparse(b.statistics[metric][name])[1]
        for metric, statistics in a.statistics.items()
        for name, counts in statistics.items()
    )
