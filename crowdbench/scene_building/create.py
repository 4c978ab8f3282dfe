"""`create_scene`: creates a complete scene from a file with a recording.

The scene is built in a temporary folder and moved to its place at the end, so that no incomplete
scene is left after an error.
"""

import re
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from crowdbench.data.preprocessing import paper_preprocessed
from crowdbench.data.recordings import own
from crowdbench.data.recordings.catalogue import cached
from crowdbench.data.recordings.mending import Gaps
from crowdbench.data.recordings.noise import noise_of
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError, SceneError, SettingError
from crowdbench.files import temporary_folder, unwritable, write_text
from crowdbench.metrics import METRICS, metrics_for
from crowdbench.registry import recording as named_recording
from crowdbench.registry import recording_of
from crowdbench.run.executor import checked_workers
from crowdbench.run.rollout_jobs import Progress
from crowdbench.scene import Gate, Recording, Scene, list_scenes, load_scene
from crowdbench.scene_building import rules
from crowdbench.scene_building.anchors import make_anchors, power_study
from crowdbench.scene_building.fit import (
    ASTRAY,
    MODELS,
    check_against,
    dwell_p99_s,
    fit_scene,
    has_torch,
)
from crowdbench.scene_building.pictures import draw_place
from crowdbench.scene_building.toml import like_toml, scene_toml, write_scored
from crowdbench.scene_building.walls import read_walls
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import write_anchors

_ID = re.compile(r"([a-z][a-z0-9_]*)-v[0-9]+")

Stage = Callable[[str], AbstractContextManager[Progress]]
"""Called with the name of the next stage; the context gives a function for its progress."""


@dataclass(frozen=True)
class Created:
    """A new scene, its recording, and results of its creation."""

    scene: Scene
    recording: Trajectories
    facts: dict[str, str]
    """Results of fits and power study by name, as text for a table."""


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
    """Create the scene `name` (like `corner-v0`) from a recording in one of `own.FORMATS`.

    The settings are determined from the recording by `rules`. Spawn models are fitted (`ntpp-gmm`
    only if torch is installed), the scored metrics are selected by the power study, and the anchors
    are rolled out. The scene is written to the new folder `out`, by default one with the scene's
    name in the working directory. The recording is stored in the user's data under the scene's name
    without `-vN`. `dt_s` is the time between consecutive rows of a person in seconds. `gaps` and
    `offset_s` repair small faults; see `own.read_recording`.

    Raises:
        SettingError: the name or a number is invalid, or the recording's name is taken.
        OutputError: the folder exists already, or cannot be written.
        RecordingError: the recording cannot be read, or is too short.
        SceneError: the walls cannot be read, or people walk through them.
    """
    place = out or Path(name)
    known_as = check_new(name, place, fits, rollouts_per_fit)
    own.check_name(known_as)
    workers = checked_workers(workers)
    with stage("read"):
        crowd = own.read_recording(
            recording, layout, name=known_as, dt_s=dt_s, gaps=gaps, offset_s=offset_s
        )
        rules.check_size(crowd, recording)
        scene = _scene(name, title, crowd, recording, walls, fits, rollouts_per_fit)
    source = f"{recording.name}{_with(gaps, offset_s)}"
    toml = scene_toml(scene, source=source, walls_file=walls.name if walls else "")
    new = own.keep(crowd)
    try:
        return _build(place, toml, crowd, workers, stage)
    except BaseException:
        if new:
            cached(known_as).unlink(missing_ok=True)
        raise


def create_like(
    name: str,
    like: str | Path,
    recording: str,
    *,
    title: str = "",
    out: Path | None = None,
    fits: int | None = None,
    rollouts_per_fit: int | None = None,
    workers: int | None = None,
    stage: Stage = lambda what: nullcontext(lambda done, total: None),
) -> Created:
    """Create the scene `name` of another recording of the place `like`, such as another day.

    `recording` is the name of an imported recording. Bounds, walls and settings are those of
    `like`, except for `fits` and `rollouts_per_fit`, if given; areas, models, scored metrics and
    anchors are computed from the recording. Otherwise as `create_scene`.

    Raises:
        SettingError: the name or a number is invalid.
        OutputError: the folder exists already, or cannot be written.
        RecordingError: the recording has not been imported, or is too short.
        SceneError: there is no scene `like`, or the recording does not fit it.
    """
    place = out or Path(name)
    check_new(name, place, fits, rollouts_per_fit)
    workers = checked_workers(workers)
    known = load_scene(like)
    crowd = named_recording(recording)
    rules.check_size(crowd, Path(recording))
    dropping = known.recording.preprocess
    kept = paper_preprocessed(crowd)[0] if dropping else crowd
    facts = Recording(recording, crowd.frames, round(dwell_p99_s(kept), 2), preprocess=dropping)
    check_against(replace(known, recording=facts), kept)  # names the file that the user knows
    toml = like_toml(
        known,
        name=name,
        title=title or _title(name),
        recording=facts,
        fits=fits,
        rollouts_per_fit=rollouts_per_fit,
    )
    return _build(place, toml, crowd, workers, stage)


def _build(place: Path, toml: str, crowd: Trajectories, workers: int, stage: Stage) -> Created:
    """Make a scene with this `scene.toml` in a temporary folder, and move it to its place."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(place.name, place.parent) as half:
            built = half / place.name
            built.mkdir()
            write_text(built / "scene.toml", toml)
            facts = _fill(built, crowd, workers, stage)
            if place.exists():
                raise _there_already(place)
            built.rename(place)
    except OSError as error:
        raise unwritable(place, error) from error
    return Created(load_scene(place), crowd, facts | {"written to": str(place)})


def check_new(name: str, place: Path, fits: int | None, rollouts_per_fit: int | None) -> str:
    """Check the arguments of a new scene in the folder `place`; returns the name without `-vN`.

    Raises:
        SettingError: the name or a number is invalid.
        OutputError: the folder exists already.
    """
    found = _ID.fullmatch(name)
    if found is None:
        raise SettingError(
            "scene",
            got=f"the name {name!r}",
            expected="lower-case letters, digits and _, followed by -v0",
        )
    if name in list_scenes():
        raise SettingError(
            "scene",
            got=f"the name {name} of a scene that comes with crowdbench",
            expected="a new name",
        )
    if place.exists():
        raise _there_already(place)
    for option, value, least in (("--fits", fits, 1), ("--rollouts-per-fit", rollouts_per_fit, 2)):
        if value is not None and value < least:
            raise SettingError(option, got=str(value), expected=f"{least} or more")
    return found[1]


def _with(gaps: Gaps | None, offset_s: float | None) -> str:
    """The options that repaired the recording, as text; others need them to import it."""
    options = {"--gaps": gaps, "--offset-s": offset_s}
    given = [f"{option} {value}" for option, value in options.items() if value is not None]
    return f" with {' '.join(given)}" if given else ""


def _there_already(place: Path) -> OutputError:
    return OutputError(
        place,
        got="a path that exists already",
        expected="a new folder",
        hint="Choose another folder with --out, or delete this one if it is no longer needed.",
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
    """The settings of the scene, as determined by `rules`."""
    bounds = rules.bounds_of(crowd)
    scene = Scene(
        id=name,
        title=title or _title(name),
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
        walking=rules.walking_of(crowd),
        gate=Gate(),
        protocol=rules.protocol_of(crowd, fits=fits, rollouts_per_fit=rollouts_per_fit),
        folder=Path(name),
    )
    if walls:
        _check_walls(scene, crowd, walls)
    return scene


def _title(name: str) -> str:
    return name.rpartition("-")[0].replace("_", " ").capitalize()


def _check_walls(scene: Scene, crowd: Trajectories, walls: Path) -> None:
    """Raise if too many recorded positions lie in walls."""
    inside = ~scene.walkable(crowd.xy.astype(np.float64))
    if inside.mean() > ASTRAY:
        at = crowd.xy[np.flatnonzero(inside)[0]].astype(np.float64).round(2).tolist()
        raise SceneError(
            walls,
            got=f"walls that contain {inside.mean():.1%} of the recorded positions, one at {at} m",
            expected=f"at most {ASTRAY:.0%}",
            hint="Walls must be in metres and in the recording's frame: plot both together.",
        )


def _walking(scene: Scene, crowd: Trajectories) -> str:
    """The noise of the positions, and the time scales on which walking is measured."""
    walking = scene.walking
    along, across = (axis.sigma_m for axis in noise_of(crowd, walking.tick_frames))
    tick_s = walking.tick_frames * scene.dt_s
    lags = ", ".join(f"{lag * tick_s:.3g}" for lag in walking.lags_ticks)
    return (
        f"positions have a noise of {100 * along:.1f} cm along and {100 * across:.1f} cm across "
        f"paths; speeds over {(walking.window_ticks - 1) * tick_s:.3g} s, accelerations over "
        f"{lags} s"
    )


def _fill(built: Path, crowd: Trajectories, workers: int, stage: Stage) -> dict[str, str]:
    """Compute all files of the scene except `scene.toml`; returns results for a table."""
    scene = load_scene(built)
    models = MODELS if has_torch() else tuple(m for m in MODELS if m != "ntpp-gmm")
    with stage("fits") as progress:
        facts = fit_scene(scene, crowd, models=models, workers=workers, progress=progress)
    if "ntpp-gmm" not in models:
        facts["ntpp-gmm"] = "left out: fitting needs torch (extra `fit`)"
    with temporary_folder("rollouts") as rollouts:
        with stage("power study") as progress:
            studies = power_study(built, rollouts, workers=workers, progress=progress)
        scored = [study.metric for study in studies if study.counts]
        write_scored(scene, scored)  # before the anchors, because their hash depends on it
        with stage("anchors") as progress:
            anchors = make_anchors(built, rollouts, workers=workers, progress=progress)
    write_anchors(anchors, built)
    computed = {metric.name for metric in metrics_for(read_reference(scene).blocks)}
    if lacking := [m.name.replace("_", " ") for m in METRICS if m.name not in computed]:
        facts["left out"] = f"{', '.join(lacking)}: the time blocks are too short"
    facts["walking"] = _walking(scene, crowd)
    facts["scored metrics"] = ", ".join(name.replace("_", " ") for name in scored) or "none"
    with stage("pictures"):
        draw_place(scene, recording_of(scene), built)
    return facts
