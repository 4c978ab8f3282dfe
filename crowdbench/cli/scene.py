"""`crowdbench scene`: list scenes, make one from your own recording, and what is scored on it."""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

import crowdbench
from crowdbench.cli.data import fetch, repairs
from crowdbench.cli.options import EngineName, OwnFile, SceneName, Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.cli.running import new_app
from crowdbench.errors import SceneError, SettingError
from crowdbench.report.text import terminal
from crowdbench.run.processes import LOCAL

app = new_app("scene", "Scenes: list them, make one from your own recording, and what is scored.")
_TRAINING = "Training of ntpp-gmm and ntpp-paper"


@Parameter(name="*", group=_TRAINING)
@dataclass(frozen=True)
class _Training:
    window_frames: Annotated[int | None, Parameter("--window")] = None
    """length of a training window, frames"""
    stride_frames: Annotated[int | None, Parameter("--stride")] = None
    """frames from one training window to the next"""
    epochs: int | None = None
    """(maximum) number of epochs"""
    learning_rate: Annotated[float | None, Parameter("--lr")] = None
    """learning rate"""
    published_code: bool | None = None
    """train ntpp-paper as the paper's published code does, which differs from the paper"""
    shared: bool | None = None
    """train one network of ntpp-gmm for all areas"""


@app.command(name="list")
def list_() -> None:
    """List the shipped scenes."""
    for name in crowdbench.list_scenes():
        print(f"{name:<10} {crowdbench.load_scene(name).title}")


@app.command
def metrics() -> None:
    """List the metrics, built-in and registered, and the scenes that are scored on them."""
    from crowdbench.metrics import METRICS, all_metrics

    scored = {
        scene: crowdbench.load_scene(scene).protocol.scored for scene in crowdbench.list_scenes()
    }
    rows = []
    for metric in all_metrics():
        scenes = [scene for scene, names in scored.items() if metric.name in names]
        package = "crowdbench" if metric in METRICS else type(metric).__module__
        rows.append((metric.name, metric.family, metric.unit, ", ".join(scenes), package))
    heads = ("family", "unit", "scored on", "from")
    terminal.print_table("metric", *heads, rows=rows, left=heads)
    terminal.print_note(
        "A scene is scored on the metrics that, according to `crowdbench scene power`, distinguish "
        "its anchor (the crowd that scores 0) from its recording. Other metrics are shown as "
        "distances."
    )


@app.command
def create(
    name: str,
    /,
    *,
    recording: str,
    like: str | None = None,
    walls: Path | None = None,
    title: str = "",
    out: Path | None = None,
    fits: int | None = None,
    rollouts_per_fit: int | None = None,
    workers: Workers = None,
    engine: EngineName = LOCAL,
    how: OwnFile = OwnFile(),
) -> None:
    """Create a scene: areas, models, anchors and scored metrics (minutes).

    Args:
        name: id of the new scene, like corner-v0
        recording: path of the recording; with --like, the name of one (fetched if it is not
            imported)
        like: scene of the same place: its bounds, walls and settings are used, for example those
            of forum-v0 for --recording forum-14jul
        walls: wall polygons in GeoJSON or WKT, in metres
        title: title of the scene in pictures
        out: folder to create (default: ./NAME)
        fits: ntpp-gmm fits for each split (default: 5)
        rollouts_per_fit: rollouts per fit in the protocol (default: 3 to 10, depending on the
            length of the recording)
    """
    from crowdbench.data.recordings.catalogue import cached
    from crowdbench.data.recordings.describe import describe
    from crowdbench.policies import GuidedWalker
    from crowdbench.scene_building import NewScene, create_like, create_scene

    if like is not None:
        for option in (*how.given(), *["--walls"] * (walls is not None)):
            got = f"{option} and --like"
            expected = f"--like without {option}, which the other scene determines"
            raise SettingError("crowdbench scene create", got=got, expected=expected)
    elif how.layout is None:
        got = "neither --format nor --like"
        expected = "the format of the recording, or a scene of the same place"
        raise SettingError("crowdbench scene create", got=got, expected=expected)
    new = NewScene(name=name, title=title, out=out, fits=fits, rollouts_per_fit=rollouts_per_fit)
    if like is not None:
        crowdbench.load_scene(like)  # what is wrong is said before anything is fetched
        if recording != "plaza" and not cached(recording).exists():
            fetch(recording)
        with progress_bar("scene"):
            created = create_like(new, like, recording, workers=workers)
    else:
        of_file: dict[str, Any] = asdict(how)
        with progress_bar("scene"):
            created = create_scene(new, Path(recording), **of_file, walls=walls, workers=workers)
    scene, crowd = created.scene, created.recording
    print()
    terminal.print_facts(f"recording {crowd.scene}", repairs(crowd, how) | describe(crowd))
    terminal.print_facts(scene.id, created.facts)
    whole = (scene.folder / "ntpp-gmm.safetensors").exists()
    models = f"--policy social-force {GuidedWalker.name}" + (
        "" if whole else " --spawn renewal-gmm"
    )
    print(f"Check place.png and time.png there. Next: crowdbench evaluate {scene.asked} {models}")
    if not whole:
        print('This scene has no ntpp-gmm, the default of environments: pass spawn="renewal-gmm".')


@app.command(name="map")
def map_(
    scene: SceneName,
    image: Path | None = None,
    /,
    *,
    homography: Path | None = None,
    row_first: bool = False,
    remove: bool = False,
) -> None:
    """Draw figures, players and the viewer on a photograph of the place, on this machine only.

    Args:
        image: photograph or plan of the place, PNG or JPEG
        homography: text file with the 3 × 3 matrix that maps (column, row) of its pixels to metres
        row_first: the matrix maps (row, column), as those of ETH's recordings do
        remove: remove the image again
    """
    from crowdbench.registry.map_images import add_map, map_path

    place = crowdbench.load_scene(scene)
    path = map_path(place)
    if remove and not (image is None and homography is None):
        expected = "--remove alone, or IMAGE and --homography"
        raise SettingError("crowdbench scene map", got="--remove and an image", expected=expected)
    if remove:
        path.unlink(missing_ok=True)
        print(f"{place.id} has no map now")
        return
    if image is None or homography is None:
        missing = "IMAGE" if image is None else "--homography"
        expected = "a picture, and the matrix that maps its pixels to metres"
        hint = f"Run crowdbench scene map {scene} IMAGE --homography FILE, or with --remove."
        raise SettingError(
            "crowdbench scene map", got=f"no {missing}", expected=expected, hint=hint
        )
    add_map(place, image, homography, row_first=row_first)
    print(f"written to {path}")
    how = f"crowdbench evaluate {place.asked} --policy social-force"
    print(f"Check that people walk on its floor: {how}")


@app.command
def check(scene: SceneName, /) -> None:
    """List the parts of a scene and their problems."""
    from crowdbench.scene_building import check_scene

    findings = list(check_scene(scene))
    table = terminal.new_table(
        "part", "state", rows=[(f.part, f.state) for f in findings], left=("state",)
    )
    table.columns[1].no_wrap = False
    terminal.new_console().print(table)
    problems = [finding.problem for finding in findings if finding.problem is not None]
    for problem in problems:
        print(f"crowdbench: {problem}", file=sys.stderr)
    if problems:
        number = f"{len(problems)} problem{'s' * (len(problems) != 1)}"
        raise SceneError(scene, got=number, expected="none", hint="The problems are listed above.")


@app.command
def fit(
    scene: SceneName,
    /,
    *,
    clustering: str = "default",
    preprocess: Literal["paper"] | None = None,
    models: Annotated[Sequence[str] | None, Parameter(consume_multiple=True)] = None,
    training: _Training = _Training(),
    fits: Annotated[int | None, Parameter(group=_TRAINING)] = None,
    workers: Workers = None,
    engine: EngineName = LOCAL,
    out: Path | None = None,
) -> None:
    """Fit a scene: areas, reference statistics, spawn models, and plans.

    Args:
        clustering: name of the clustering settings in scene.toml
        preprocess: drop people as the founding paper does, and print how many; needs --out
        models: spawn models to fit (default: everything, with all models but joint-gmm and those of
            the founding paper); only their fits are written, and the plans if they depend on them;
            with none, areas, reference statistics and plans are written
        fits: number of fits (default: the scene's)
        out: output folder (default: the scene's folder)
    """
    from crowdbench.scene_building.fit import fit_scene

    place = crowdbench.load_scene(scene)
    crowd = crowdbench.recording(place.recording.name)
    with progress_bar("fits"):
        facts = fit_scene(
            place,
            crowd,
            clustering=clustering,
            preprocess=preprocess,
            models=models,
            training={k: v for k, v in asdict(training).items() if v is not None},
            fits=fits,
            out=out,
            workers=workers,
        )
    terminal.print_facts(place.id, facts)
    print(f"Next, if arrivals or areas changed: crowdbench scene anchors {out or scene}")


@app.command
def anchors(scene: SceneName, /, *, workers: Workers = None, engine: EngineName = LOCAL) -> None:
    """Roll out the crowds that define a scene's score scale (minutes)."""
    from crowdbench.files import temporary_folder
    from crowdbench.scene_building.anchors import make_anchors
    from crowdbench.scoring.scorecard import write_anchors

    place = crowdbench.load_scene(scene)
    with temporary_folder("anchors") as folder, progress_bar("rollouts"):
        made = make_anchors(scene, folder, workers=workers)
    print(f"written to {write_anchors(made, place.folder)}")


@app.command
def power(scene: SceneName, /, *, write: bool = False) -> None:
    """Find the metrics that distinguish a scene's anchor from its recording.

    Args:
        write: write them to scene.toml as the scored metrics
    """
    from crowdbench.files import temporary_folder
    from crowdbench.scene_building.anchors import power_study
    from crowdbench.scene_building.toml import write_scored

    place = crowdbench.load_scene(scene)
    with temporary_folder("power") as folder, progress_bar("rollouts"):
        studies = power_study(scene, folder)
    rows = [
        (
            s.metric.replace("_", " "),
            *(f"{value:.3f}" for value in (s.floor, s.threshold, s.anchor)),
            f"{s.power:.2f}",
            "scored" if s.counts else "",
        )
        for s in studies
    ]
    terminal.print_table("metric", "floor", "95 %", "anchor", "power", "", rows=rows)
    terminal.print_note(
        "Energy scores on synthetic recordings. floor and 95 %: mean and 95th percentile for the "
        "true process. anchor: mean for the anchor. power: share of synthetic recordings on which "
        "the anchor's score exceeds the 95th percentile. A metric is scored if its power is at "
        "least 0.8, unless the recording has only one value of it."
    )
    scored = [s.metric for s in studies if s.counts]
    print(f"scored = {scored}".replace("'", '"'))
    if write:
        print(f"written to {write_scored(place, scored)}")
        print(f"Next, if they changed: crowdbench scene anchors {scene}")
