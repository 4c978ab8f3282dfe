"""`create_scene`: creates a complete scene from a file with a recording.

The scene is built in a temporary folder and moved to its place at the end, so that no incomplete
scene is left after an error.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import numpy as np
from msgspec import structs

from crowdbench.data.preprocessing import paper_preprocessed
from crowdbench.data.recordings import own
from crowdbench.data.recordings.catalogue import cached
from crowdbench.data.recordings.formats import read_recording
from crowdbench.data.recordings.noise import noise_of
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError, SceneError, SettingError
from crowdbench.files import replacing, temporary_folder, unwritable, write_text
from crowdbench.metrics import METRICS, metrics_for
from crowdbench.policies.guided import ANYWHERE
from crowdbench.progress import whole
from crowdbench.registry import DEFAULT_FITS, recording_of
from crowdbench.registry import recording as named_recording
from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import picture
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.run.executor import checked_workers
from crowdbench.scene import ID, Gate, Recording, Scene, list_scenes, load_scene
from crowdbench.scene_building import fit, rules
from crowdbench.scene_building.anchors import make_anchors, power_study
from crowdbench.scene_building.toml import like_toml, scene_toml, write_scored
from crowdbench.scene_building.walker import fit_walker
from crowdbench.scene_building.walls import read_walls
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import write_anchors

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True)
class NewScene:
    """What is asked of a new scene, however its settings are found.

    Raises:
        SettingError: the name or a number is invalid.
        OutputError: the folder exists already.
    """

    name: str
    """Its id, like `corner-v0`."""
    title: str = ""
    """Its title in pictures; by default from the name."""
    out: Path | None = None
    """The folder to create; by default one with the scene's name in the working directory."""
    fits: int | None = None
    """Number of fits of neural models."""
    rollouts_per_fit: int | None = None

    def __post_init__(self) -> None:
        if not ID.fullmatch(self.name) or self.name in list_scenes():
            raise SettingError(
                "scene",
                got=f"the name {self.name!r}",
                expected="lower-case letters, digits and _, followed by -v0; not the name of a "
                "scene that comes with crowdbench",
            )
        self.check_free()
        for name, value, least in (
            ("--fits", self.fits, 1),
            ("--rollouts-per-fit", self.rollouts_per_fit, 2),
        ):
            if value is not None and not least <= value <= fit.MOST_FITS:
                raise SettingError(name, got=str(value), expected=f"{least} to {fit.MOST_FITS}")

    @property
    def place(self) -> Path:
        """The folder of the scene."""
        return self.out or Path(self.name)

    @property
    def recording(self) -> str:
        """The name of its recording, if it has one of its own: that of the scene without `-vN`."""
        return self.name.rpartition("-")[0]

    @property
    def shown_title(self) -> str:
        """The title in pictures."""
        return self.title or self.recording.replace("_", " ").capitalize()

    def check_free(self) -> None:
        """Check that nothing is in its place."""
        if self.place.exists():
            got = "a path that exists already"
            hint = "Choose another folder with --out, or delete this one if it is no longer needed."
            raise OutputError(self.place, got=got, expected="a new folder", hint=hint)


@dataclass(frozen=True)
class Created:
    """A new scene, its recording, and results of its creation."""

    scene: Scene
    recording: Trajectories
    facts: dict[str, str]
    """Results of fits and power study by name, as text for a table."""


def create_scene(
    new: NewScene,
    recording: Path,
    *,
    layout: str,
    walls: Path | None = None,
    workers: int | None = None,
    **how: Unpack[own.Reading],
) -> Created:
    """Create a scene from a recording in one of `formats.FORMATS`.

    The settings are determined from the recording by `rules`. Spawn models are fitted (`ntpp-gmm`
    only if torch is installed), the scored metrics are selected by the power study, and the anchors
    are rolled out. The recording is stored in the user's data under the scene's name
    without `-vN`. `how` are options of `formats.read_recording`, such as `dt_s`, the time between
    consecutive rows of a person in seconds.

    Raises:
        SettingError: a number is invalid, or the recording's name is taken.
        OutputError: the folder cannot be written.
        RecordingError: the recording cannot be read, or is too short.
        SceneError: the walls cannot be read, or people walk through them.
    """
    own.check_name(new.recording)
    workers = checked_workers(workers)
    with whole("read"):
        crowd = read_recording(recording, layout, name=new.recording, **how)
        rules.check_size(crowd, recording)
        scene = _scene(new, crowd, recording, walls)
    # Others need the options that repaired the recording to import it.
    given = [
        f"--{option.replace('_', '-')} {value}"
        for option, value in how.items()
        if option != "dt_s" and value is not None
    ]
    source = " ".join([recording.name, *(["with"] if given else []), *given])
    toml = scene_toml(scene, source=source, walls_file=walls.name if walls else "")
    kept = own.keep(crowd)
    try:
        return _build(new, toml, crowd, workers)
    except BaseException:
        if kept:
            cached(new.recording).unlink(missing_ok=True)
        raise


def create_like(
    new: NewScene, like: str | Path, recording: str, *, workers: int | None = None
) -> Created:
    """Create the scene of another recording of the place `like`, such as another day.

    `recording` is the name of an imported recording. Bounds, walls and settings are those of
    `like`, except for `fits` and `rollouts_per_fit`, if given; areas, models, scored metrics and
    anchors are computed from the recording. Otherwise as `create_scene`.

    Raises:
        SettingError: a number is invalid.
        OutputError: the folder cannot be written.
        RecordingError: the recording has not been imported, or is too short.
        SceneError: there is no scene `like`, or the recording does not fit it.
    """
    workers = checked_workers(workers)
    known = load_scene(like)
    crowd = named_recording(recording)
    rules.check_size(crowd, Path(recording))
    dropping = known.recording.preprocess
    kept = paper_preprocessed(crowd)[0] if dropping else crowd
    scene = replace(
        known,
        id=new.name,
        title=new.shown_title,
        recording=Recording(
            recording, crowd.frames, round(fit.dwell_p99_s(kept), 2), preprocess=dropping
        ),
        protocol=structs.replace(
            known.protocol,
            fits=new.fits or known.protocol.fits,
            rollouts_per_fit=new.rollouts_per_fit or known.protocol.rollouts_per_fit,
            scored=(),
        ),
    )
    fit.check_against(scene, kept)  # in the folder of `like`: names the file that the user knows
    return _build(new, like_toml(known, scene), crowd, workers)


def _scene(new: NewScene, crowd: Trajectories, source: Path, walls: Path | None) -> Scene:
    bounds = rules.bounds_of(crowd)
    scene = Scene(
        id=new.name,
        title=new.shown_title,
        dt_s=crowd.dt_s,
        grid_s=crowd.grid_s,
        recording=Recording(
            crowd.scene, crowd.frames, round(fit.dwell_p99_s(crowd), 2), crowd.provenance["sha256"]
        ),
        bounds=bounds,
        walls=read_walls(walls, bounds) if walls else (),
        motion=rules.motion_of(crowd),
        spawning=rules.SPAWNING,
        clustering={"default": rules.clustering_of(crowd, source)},
        walking=rules.walking_of(crowd),
        gate=Gate(),
        protocol=rules.protocol_of(crowd, fits=new.fits, rollouts_per_fit=new.rollouts_per_fit),
        folder=Path(new.name),
    )
    inside = ~scene.walkable(crowd.xy.astype(np.float64))
    if walls and inside.mean() > fit.ASTRAY:
        at = crowd.xy[np.flatnonzero(inside)[0]].astype(np.float64).round(2).tolist()
        got = f"walls that contain {inside.mean():.1%} of the recorded positions, one at {at} m"
        hint = "Walls must be in metres and in the recording's frame: plot both together."
        raise SceneError(walls, got=got, expected=f"at most {fit.ASTRAY:.0%}", hint=hint)
    return scene


def _build(new: NewScene, toml: str, crowd: Trajectories, workers: int) -> Created:
    """Make a scene with this `scene.toml` in a temporary folder, and move it to its place."""
    place = new.place
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(place.name, place.parent) as half:
            built = half / place.name
            built.mkdir()
            write_text(built / "scene.toml", toml)
            facts = _fill(built, crowd, workers)
            new.check_free()
            built.rename(place)
    except OSError as error:
        raise unwritable(place, error) from error
    return Created(load_scene(place), crowd, facts | {"written to": str(place)})


def _fill(built: Path, crowd: Trajectories, workers: int) -> dict[str, str]:
    """Compute all files of the scene except `scene.toml`; returns results for a table."""
    scene = load_scene(built)
    models = tuple(m for m in DEFAULT_FITS if m != "ntpp-gmm" or fit.has_torch())
    facts = fit.fit_scene(scene, crowd, models=models, workers=workers)
    if "ntpp-gmm" not in models:
        facts["ntpp-gmm"] = "left out: fitting needs torch (extra `fit`)"
    with temporary_folder("rollouts") as rollouts:
        scored = [s.metric for s in power_study(built, rollouts, workers=workers) if s.counts]
        write_scored(scene, scored)  # before the anchors, because their hash depends on it
        anchors = make_anchors(built, rollouts, workers=workers)
    write_anchors(anchors, built)
    scene = load_scene(built)
    fit_walker(scene, elsewhere=ANYWHERE, command="crowdbench scene create", workers=workers)
    computed = {metric.name for metric in metrics_for(read_reference(scene).blocks)}
    if lacking := [m.name.replace("_", " ") for m in METRICS if m.name not in computed]:
        facts["left out"] = f"{', '.join(lacking)}: the time blocks are too short"
    facts["walking"] = _walking(scene, crowd)
    facts["scored metrics"] = ", ".join(name.replace("_", " ") for name in scored) or "none"
    with whole("pictures"):
        _draw_place(scene, recording_of(scene), built)
    return facts


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


def _draw_place(scene: Scene, recording: Trajectories, out: Path) -> None:
    """Draw `place.png` (recorded paths, walls and areas) and `time.png` (persons over time)."""
    plot = PlotData.of(scene, read_reference(scene), {}, "full")

    def place(axes: "list[Axes]") -> None:
        panels.paths(axes[0], plot, recording)
        axes[0].set_title("recorded; spawn areas (dashed) and goal areas, 2 σ")

    def over_time(axes: "list[Axes]") -> None:
        (axis,) = axes
        blocks, dt_s = plot.reference.blocks, recording.dt_s
        present = recording.present()
        axis.plot(np.arange(len(present)) * dt_s, present, color="black", linewidth=0.7)
        for k, (start, stop) in enumerate((blocks.frames * dt_s).tolist()):
            axis.axvspan(start, stop, color=("0.93", "0.85")[k % 2], linewidth=0)
        axis.set(xlim=(0, recording.duration_s), ylim=(0, 1.05 * present.max()))
        axis.set(xlabel="time (s); grey: time blocks, white: unobserved", ylabel="agents")
        axis.set_title(f"{scene.title}: agents over time")

    b, width = scene.bounds, 5.0
    height = width * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m)
    for name, draw, size in (
        ("place.png", place, (width + 0.6, height + 0.6)),
        ("time.png", over_time, (9.0, 2.6)),
    ):
        data = picture(draw, width=size[0], height=size[1], kind="small png")
        with replacing(out / name) as temporary:
            temporary.write_bytes(data)
