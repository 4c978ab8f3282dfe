"""The founding paper's claims, checked with its own models and settings and with crowdbench's.

`write_paper` trains the paper's models (ICRA 2025, "Whenever, Wherever") with each of its windows
and strides, samples them and crowdbench's models, and writes a Markdown page with pictures for each
scene and an overview, meant to be kept under version control. The same samples give the same bytes.
"""

from pathlib import Path

import numpy as np

from crowdbench.data.preprocessing import paper_preprocessed
from crowdbench.data.storage import read_own
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError
from crowdbench.files import read_struct, replacing, revision, write_json, write_text
from crowdbench.registry import raw_recording_of, recording_of, spawn_model
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.run.executor import checked_workers
from crowdbench.run.judge import draws_of
from crowdbench.run.processes import alone_in
from crowdbench.run.rollout_jobs import Progress
from crowdbench.scene import Scene, load_scene
from crowdbench.scene_building.fit import check_torch
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn import arrivals_of
from crowdbench.spawn.areas import fit_areas, read_areas
from studies.paper.claims import claims
from studies.paper.evidence import Evidence, noise
from studies.paper.fits import SHIPPED, make_fits
from studies.paper.page import Studied, Verdicts, overview, page
from studies.paper.pictures import draw_agents, draw_bursts
from studies.paper.study import (
    compared,
    crowds_of,
    make,
    plan,
    recorded_bursts,
    recorded_presence,
    walker_of,
)
from studies.results.drawing import with_recording
from studies.results.pictures import draw_pictures

VERDICTS = "verdicts.json"
"""Beside the pictures of a scene."""
PUBLISHED = {
    "eth": (258, "people on ETH", ""),
    "gc": (
        12_255,
        "people in 11,999 frames",
        "The number of steps depends on the length of a frame, which the paper does not state. Its "
        "code has no lower limit here.",
    ),
    "forum": (
        1_331,
        "people in 58,480 frames of 14 July",
        "This recording is of 1 July. That of 14 July is not in OpenTraj.",
    ),
}
"""The number of people that the paper states, of what, and why it differs, by recording."""


def write_paper(
    scene: str | Path,
    *,
    out: Path = Path("docs"),
    work: Path = Path("results"),
    workers: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Check the paper's claims on a scene; write `paper/<scene>.md` and its pictures into `out`.

    Returns the path of the page. The overview `paper.md` in `out`, of all scenes that have a page
    there, is written again. Fits and samples are kept in `paper-<scene>` of `work`; a later call
    reuses those whose dependencies have not changed. `progress(done, total)` is called for the
    fits, then for the samples: before the first and after each. `workers` is the number of
    processes (by default one per core).

    Raises:
        SceneError, WeightsError: there is no such scene, or it lacks areas, fits or statistics.
        RecordingError: the recording has not been imported.
        SettingError: torch is not installed, or `workers` is less than 1.
        OutputError: `out` or `work` cannot be written, or verdicts in `out` cannot be read.
    """
    place = load_scene(scene)
    workers = checked_workers(workers)
    check_torch()
    recording = recording_of(place)
    spawn_model(SHIPPED.spawn, place)  # fails here, not after hours, if there are no fits
    commit = revision(Path(__file__).parent)
    path, folder = out / "paper" / f"{place.id}.md", work / f"paper-{place.id}"
    _verdicts_in(out)  # fails here, too
    with replacing(path) as temporary:  # fails early without access
        with alone_in(folder):
            studied = _studied(place, recording, folder, out, workers, progress)
        write_text(temporary, page(studied, commit))
        write_json(path.with_suffix("") / VERDICTS, Verdicts.of(studied))
    write_overview(out)
    return path


def write_overview(out: Path) -> None:
    """Write the overview `paper.md` of all scenes that have a page in `out`.

    Raises:
        OutputError: verdicts in `out` cannot be read.
    """
    write_text(out / "paper.md", overview(_verdicts_in(out)))


def _verdicts_in(out: Path) -> list[Verdicts]:
    """The verdicts of all scenes that have a page, in the order of their ids."""
    hint = "Make its page again with `python -m studies paper`, or remove the folder."
    return [
        read_struct(file, Verdicts, OutputError, hint)
        for file in sorted(out.glob(f"paper/*/{VERDICTS}"))
    ]


def _studied(
    place: Scene, recording: Trajectories, folder: Path, out: Path, workers: int, progress: Progress
) -> Studied:
    """Make the study of a scene, and draw its pictures."""
    reference, areas = read_reference(place), read_areas(place)
    arrivals = arrivals_of(recording, reference.blocks.training("full"), len(areas.spawn))
    jobs = plan(place, arrivals, folder)
    fits = {job.fit.path: job.fit for job in jobs if job.fit is not None}
    make_fits(list(fits.values()), place, arrivals, areas, workers, progress)
    samples = make(jobs, place, recording, arrivals, areas, workers, progress)
    walker = walker_of(place)
    evidence = Evidence(
        scene=place,
        walker=walker,
        bursts=recorded_bursts(place, arrivals),
        present=recorded_presence(recording),
        samples=samples,
        walked=compared(jobs, reference),
        dwell_noise=noise(reference, "dwell", draws_of(place, reference, "full")),
    )
    pictures = out / "paper" / place.id
    crowds = {key: read_own(path) for key, path in crowds_of(jobs, walker).items()}
    plot = with_recording(PlotData.of(place, reference, crowds, "full"), recording)
    raw = raw_recording_of(place)
    return Studied(
        evidence,
        claims(evidence),
        [
            draw_bursts(evidence, pictures),
            draw_agents(evidence, pictures),
            *draw_pictures(plot, pictures, walker),
        ],
        kept=kept_people(raw, place.recording.name),
        areas=_areas(place, raw),
        longest_s=float(np.diff(recording.observed).max() * recording.dt_s),
    )


def kept_people(recording: Trajectories, name: str) -> dict[str, str]:
    """How many people are left after each rule of the paper, beside its own number."""
    facts = paper_preprocessed(recording)[1]
    if name in PUBLISHED:
        number, what, why = PUBLISHED[name]
        facts["paper"] = f"{number:,} {what}"
        if why:
            facts["difference"] = why
    return facts


def _areas(place: Scene, recording: Trajectories) -> dict[str, str]:
    """What DBSCAN finds with each of the scene's settings."""
    found = {}
    for name, settings in place.clustering.items():
        areas, _ = fit_areas(recording, place, settings)
        found[name] = (
            f"{len(areas.spawn)} spawn areas, {100 * areas.left_out[0]:.0f} % of starts in none; "
            f"{len(areas.goal)} goal areas, {100 * areas.left_out[1]:.0f} % of ends in none"
        )
    return found


__all__ = ["write_overview", "write_paper"]
