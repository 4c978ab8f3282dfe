"""The founding paper's study of training windows and strides, with crowdbench's neural model.

`write_ablation` trains `ntpp-gmm` with each window and stride of the paper (ICRA 2025, "Whenever,
Wherever") and makes rollouts. It writes a Markdown page with a picture, meant to be kept under
version control, which compares the number of people present with the recording and with Poisson
arrivals, and tests the paper's finding. The same samples give the same bytes.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from crowdbench.evaluation.lock import alone_in
from crowdbench.evaluation.parallel import checked_workers
from crowdbench.evaluation.rollout_jobs import Progress
from crowdbench.files import replacing, write_text
from crowdbench.registry import recording_of
from crowdbench.scene import load_scene
from crowdbench.scene_building.fit import check_torch
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import read_anchors
from crowdbench.spawn import arrivals_of
from crowdbench.spawn.areas import read_areas
from crowdbench.studies.ablation.measures import scores_of
from crowdbench.studies.ablation.page import page
from crowdbench.studies.ablation.pictures import draw_agents
from crowdbench.studies.ablation.study import make, plan, recorded_presence


def write_ablation(
    scene: str | Path,
    *,
    out: Path = Path("docs/ablation"),
    work: Path = Path("results"),
    workers: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Make the study of a scene and write `<scene>.md` and `<scene>/agents.png` into `out`.

    Returns the path of the page. Samples are kept in `ablation-<scene>` of `work`; a later call
    reuses those whose dependencies have not changed. `progress(done, total)` is called before the
    first sample and after each. `workers` is the number of processes (by default one per core).

    Raises:
        SceneError, WeightsError: there is no such scene, or it lacks areas, statistics or anchors.
        RecordingError: the recording has not been imported.
        SettingError: torch is not installed, or `workers` is less than 1.
        OutputError: `out` or `work` cannot be written.
    """
    place = load_scene(scene)
    workers = checked_workers(workers)
    check_torch()
    reference, areas = read_reference(place), read_areas(place)
    scale = read_anchors(place).protocols["full"]
    recording = recording_of(place)
    arrivals = arrivals_of(recording, reference.blocks.training("full"), len(areas.spawn))
    folder = work / f"ablation-{place.id}"
    path = out / f"{place.id}.md"
    # Fails early if the folder or the page cannot be written.
    with alone_in(folder), _without_halves(folder, path), replacing(path) as temporary:
        jobs = plan(place, folder)
        samples = make(jobs, place, recording, arrivals, areas, reference, workers, progress)
        recorded = recorded_presence(recording)
        longest_s = float(np.diff(recording.observed).max() * recording.dt_s)
        scores = scores_of(place, reference, scale, samples)
        draw_agents(place, recorded, samples, out / place.id)
        write_text(temporary, page(place, recorded, samples, scores, longest_s))
    return path


@contextmanager
def _without_halves(folder: Path, path: Path) -> Iterator[None]:
    """Remove the temporary files of an earlier call that was killed."""
    for half in (*folder.glob(".*-*.json"), *path.parent.glob(f".{path.stem}-*.md")):
        half.unlink(missing_ok=True)
    yield


__all__ = ["write_ablation"]
