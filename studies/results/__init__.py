"""The results page of a scene: scores of the shipped models, and what they miss.

`write_results` evaluates the spawn models that come with crowdbench in both protocols and writes a
Markdown page with pictures, meant to be kept under version control. All numbers come from the two
scorecards and their rollouts: the same evaluations give the same bytes.
"""

from pathlib import Path

from crowdbench.data.storage import read_own
from crowdbench.evaluation import evaluate
from crowdbench.files import replacing, write_text
from crowdbench.registry import has_recording, recording_of
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.run.jobs import Job, plan, splits_of
from crowdbench.run.rollout_jobs import Progress, roll_out
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import Reference, read_reference
from crowdbench.scoring.scorecard import Protocol, Scorecard
from studies.results.correlations import Lag, at_lags
from studies.results.drawing import with_recording
from studies.results.misses import best_of
from studies.results.page import page
from studies.results.pictures import draw_pictures

SPAWN = ("poisson-gmm", "renewal-gmm", "ntpp-gmm")
POLICY = ("straight", "social-force")
"""The spawn models and policies that the pages compare."""


def write_results(
    scene: str | Path,
    *,
    out: Path = Path("docs/results"),
    work: Path = Path("results"),
    seeds: int | None = None,
    workers: int | None = None,
    progress: Progress = lambda done, total: None,
) -> Path:
    """Evaluate a scene in both protocols and write `<scene>.md` and `<scene>/*.png` into `out`.

    Returns the path of the page. The evaluations are kept in `<scene>-full` and `<scene>-heldout`
    of `work`, where a later call reuses them. `seeds`, `workers` and `progress` are those of
    `evaluate`.

    Raises:
        SceneError, WeightsError, RecordingError, SettingError: as `evaluate`.
        OutputError: `out` or `work` cannot be written.
    """
    place = load_scene(scene)
    path = out / f"{place.id}.md"
    folders: dict[Protocol, Path] = {
        "full": work / f"{place.id}-full",
        "heldout": work / f"{place.id}-heldout",
    }
    with replacing(path) as temporary:  # fails early if the page cannot be written
        cards = {
            protocol: evaluate(
                scene,
                spawn=SPAWN,
                policy=POLICY,
                protocol=protocol,
                seeds=seeds,
                workers=workers,
                out=folder,
                report=False,
                progress=progress,
            )
            for protocol, folder in folders.items()
        }
        jobs = {protocol: _jobs(place, card, folders[protocol]) for protocol, card in cards.items()}
        jobs["heldout"] = _of_best(jobs["heldout"], cards["heldout"])
        for each in jobs.values():
            roll_out(each, None, workers, progress)
        reference = read_reference(place)
        crowds = {(job.spawn, job.policy, job.seed): read_own(job.path) for job in jobs["full"]}
        recording = recording_of(place) if has_recording(place) else None
        plot = with_recording(PlotData.of(place, reference, crowds, "full"), recording)
        pictures = draw_pictures(plot, out / place.id)
        lags = {
            protocol: _lags(reference, card, jobs[protocol]) for protocol, card in cards.items()
        }
        write_text(temporary, page(place, cards, lags, pictures))
    return path


def _jobs(place: Scene, card: Scorecard, folder: Path) -> list[Job]:
    """The first rollout of each fit (and fold), which pictures and correlations show."""
    pairs = [(entry.spawn, entry.policy) for entry in card.entries]
    jobs = plan(place.asked, place, pairs, card.protocol, card.rollouts, folder / "rollouts")
    return [job for job in jobs if job.seed < place.protocol.fits]


def _of_best(jobs: list[Job], card: Scorecard) -> list[Job]:
    """The rollouts of a scorecard's best crowd; none without scores."""
    best = best_of(card)
    return (
        []
        if best is None
        else [j for j in jobs if (j.spawn, j.policy) == (best.spawn, best.policy)]
    )


def _lags(reference: Reference, card: Scorecard, jobs: list[Job]) -> list[Lag]:
    """Autocorrelation of N(t) for a scorecard's best crowd, lag by lag; empty without scores."""
    of_best = _of_best(jobs, card)
    crowds = {
        split: [read_own(job.path) for job in of_best if job.split == split]
        for split in splits_of(card.protocol)
    }
    return at_lags(reference, crowds) if of_best else []


__all__ = ["write_results"]
