"""`create_scene`: from a file with a recording to a folder that `evaluate` takes.

Nothing is left of a scene that could not be made whole: it is built beside its place and moved
there at the end.
"""

import re
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench.errors import OutputError, SceneError, SettingError
from crowdbench.evaluation.parallel import checked_workers
from crowdbench.evaluation.rollout_jobs import Progress
from crowdbench.files import unwritable, write_text
from crowdbench.leftovers import swept, temporary, temporary_folder
from crowdbench.metrics import METRICS, metrics_for
from crowdbench.recordings import own
from crowdbench.recordings.catalogue import cached
from crowdbench.recordings.mending import Gaps
from crowdbench.registry import recording_of
from crowdbench.scene import Recording, Scene, list_scenes, load_scene, write_scored
from crowdbench.scene_building import rules
from crowdbench.scene_building.anchors import make_anchors, power_study
from crowdbench.scene_building.fit import ASTRAY, MODELS, dwell_p99_s, fit_scene, has_torch
from crowdbench.scene_building.pictures import draw_place
from crowdbench.scene_building.toml import scene_toml
from crowdbench.scene_building.walls import read_walls
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import write_anchors
from crowdbench.trajectories.table import Trajectories

_ID = re.compile(r"([a-z][a-z0-9_]*)-v[0-9]+")

Stage = Callable[[str], AbstractContextManager[Progress]]
"""Is called with the name of what comes next; within it the progress is told."""


@dataclass(frozen=True)
class Created:
    """A new scene, and what was found on the way."""

    scene: Scene
    recording: Trajectories
    facts: dict[str, str]
    """Of the fits, by name, as text for a table."""


def create_scene(
    name: str,
    recording: Path,
    *,
    layout: str,
    dt_s: float | None = None,
    gaps: Gaps | None = None,
    offset_s: float | None = None,
    walls: Path | None = None,
    title: str = "",
    out: Path | None = None,
    fits: int | None = None,
    rollouts_per_fit: int | None = None,
    workers: int | None = None,
    stage: Stage = lambda what: nullcontext(lambda done, total: None),
) -> Created:
    """Make the scene `name` (like `corner-v0`) from a recording in one of `own.FORMATS`.

    The settings follow from the recording by `rules`; models are fitted (`ntpp-gmm` where torch
    is installed), anchors rolled out, the scored metrics chosen by the power study. Written into
    the new folder `out`, by default one of the scene's name here. The recording is kept in the
    user's cache by the name before `-vN`. `dt_s` are the seconds from row to row; `gaps` and
    `offset_s` mend its small faults, see `own.read_rows`.

    Raises:
        SettingError: the name or a number is none, or the recording's name is taken.
        OutputError: the folder is there already, or cannot be written.
        RecordingError: the recording cannot be read, or is too short.
        SceneError: the walls cannot be read, or people walk through them.
    """
    place = out or Path(name)
    known_as = _checked(name, place, fits, rollouts_per_fit)
    workers = checked_workers(workers)
    with stage("read"):
        crowd = own.read_recording(
            recording, layout, name=known_as, dt_s=dt_s, gaps=gaps, offset_s=offset_s
        )
        rules.check_size(crowd, recording)
        scene = _scene(name, title, crowd, recording, walls, fits, rollouts_per_fit)
    new = own.keep(crowd)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with (
            swept(),
            tempfile.TemporaryDirectory(dir=place.parent, prefix=f".{place.name}-") as half,
            temporary(Path(half)),
        ):
            built = Path(half) / place.name
            built.mkdir()
            source = f"{recording.name}{_with(gaps, offset_s)}"
            toml = scene_toml(scene, source=source, walls_file=walls.name if walls else "")
            write_text(built / "scene.toml", toml)
            facts = _fill(built, crowd, workers, stage)
            if place.exists():
                raise _there_already(place)
            built.rename(place)
    except BaseException as error:
        if new:
            cached(known_as).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise unwritable(place, error) from error
        raise
    return Created(load_scene(place), crowd, facts | {"written to": str(place)})


def _checked(name: str, place: Path, fits: int | None, rollouts_per_fit: int | None) -> str:
    """The name of the recording, if all that is asked for can be."""
    found = _ID.fullmatch(name)
    if found is None:
        raise SettingError(
            "scene", got=f"the name {name!r}", expected="small letters, digits and _, then -v0"
        )
    if name in list_scenes():
        raise SettingError(
            "scene", got=f"the name {name}, of a scene that comes with crowdbench", expected="yours"
        )
    own.check_name(found[1])
    if place.exists():
        raise _there_already(place)
    for option, value, least in (("--fits", fits, 1), ("--rollouts-per-fit", rollouts_per_fit, 2)):
        if value is not None and value < least:
            raise SettingError(option, got=str(value), expected=f"{least} or more")
    return found[1]


def _with(gaps: Gaps | None, offset_s: float | None) -> str:
    """How whoever imports the recording must have it mended, too."""
    options = {"--gaps": gaps, "--offset-s": offset_s}
    given = [f"{option} {value}" for option, value in options.items() if value is not None]
    return f" with {' '.join(given)}" if given else ""


def _there_already(place: Path) -> OutputError:
    return OutputError(
        place,
        got="something that is there already",
        expected="a new folder",
        hint="Name another one with --out, or delete it if you need it no more.",
    )


def _scene(
    name: str,
    title: str,
    crowd: Trajectories,
    source: Path,
    walls: Path | None,
    fits: int | None,
    rollouts_per_fit: int | None,
) -> Scene:
    """The scene by the rules."""
    bounds = rules.bounds_of(crowd)
    scene = Scene(
        id=name,
        title=title or name.rpartition("-")[0].replace("_", " ").capitalize(),
        dt_s=crowd.dt_s,
        grid_s=crowd.grid_s,
        recording=Recording(
            crowd.scene, crowd.frames, round(dwell_p99_s(crowd), 2), crowd.provenance["sha256"]
        ),
        bounds=bounds,
        walls=read_walls(walls, bounds) if walls else (),
        motion=rules.motion_of(crowd),
        spawning=rules.SPAWNING,
        clustering={"default": rules.clustering_of(crowd, source)},
        protocol=rules.protocol_of(crowd, fits=fits, rollouts_per_fit=rollouts_per_fit),
        folder=Path(name),
    )
    if walls:
        _check_walls(scene, crowd, walls)
    return scene


def _check_walls(scene: Scene, crowd: Trajectories, walls: Path) -> None:
    """Refuse walls that people walk through."""
    inside = ~scene.walkable(crowd.xy.astype(np.float64))
    if inside.mean() > ASTRAY:
        at = crowd.xy[np.flatnonzero(inside)[0]].astype(np.float64).round(2).tolist()
        raise SceneError(
            walls,
            got=f"walls in which {inside.mean():.1%} of the recorded positions lie, one at {at} m",
            expected=f"{ASTRAY:.0%} at most",
            hint="Walls must be in metres, in the recording's frame: look at both in one picture.",
        )


def _fill(built: Path, crowd: Trajectories, workers: int, stage: Stage) -> dict[str, str]:
    """Compute all that stands beside `scene.toml`."""
    scene = load_scene(built)
    models = MODELS if has_torch() else tuple(m for m in MODELS if m != "ntpp-gmm")
    with stage("fits") as progress:
        facts = fit_scene(scene, crowd, models=models, workers=workers, progress=progress)
    if "ntpp-gmm" not in models:
        facts["ntpp-gmm"] = "left out: no torch to fit it with (extra `fit`)"
    with temporary_folder("rollouts") as rollouts:
        with stage("power study") as progress:
            studies = power_study(built, rollouts, workers=workers, progress=progress)
        # Before scene.toml is changed: what both need is rolled out once.
        with stage("anchors") as progress:
            anchors = make_anchors(built, rollouts, workers=workers, progress=progress)
    write_anchors(anchors, built)
    scored = [study.metric for study in studies if study.counts]
    write_scored(scene, scored)
    computed = {metric.name for metric in metrics_for(read_reference(scene).blocks)}
    if lacking := [m.name.replace("_", " ") for m in METRICS if m.name not in computed]:
        facts["left out"] = f"{', '.join(lacking)}: time blocks are too short for it"
    facts["scored metrics"] = ", ".join(name.replace("_", " ") for name in scored) or "none"
    with stage("pictures"):
        draw_place(scene, recording_of(scene), built)
    return facts
