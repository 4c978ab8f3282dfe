"""The study's jobs: a fit, its rollouts, and what is kept of them.

Each fit is a job with a file of its own, which holds a fingerprint of all that it depends on: a
study that was killed goes on where it stopped, and nothing stale is taken for new.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Int

from crowdbench.errors import RecordingError
from crowdbench.evaluation.parallel import call_each
from crowdbench.evaluation.rollout_jobs import Progress, fingerprint
from crowdbench.files import read_struct, write_json
from crowdbench.metrics import WALK, Statistics, metrics_for
from crowdbench.policies import Straight
from crowdbench.recordings.catalogue import cached
from crowdbench.rollouts.rollout import rollout
from crowdbench.scene import Scene
from crowdbench.scoring.reference import Reference, Sparse, dense, sparse
from crowdbench.spawn import Areas, Arrivals, PoissonGMM, RenewalGMM, SpawnModel
from crowdbench.studies.ablation.presence import Presence, parts_at, stretches
from crowdbench.trajectories.table import Trajectories

WINDOWS_FRAMES = (100, 500, 1000)
STRIDES_FRAMES = (5, 50)
"""The paper's windows and, as its text calls them, overlaps; in its code they are strides."""
SAMPLES = 5
"""Of each configuration: fits of seeds 0, 1, …, as the fit's seed matters more than a sample's."""
SCHEMES = (1, 10)
"""So many rollouts of a sample share the length of the recording."""
_SCHEMA = 1


@dataclass(frozen=True)
class Configuration:
    """A spawn model and how it is trained."""

    spawn: str
    window_frames: int = 0
    stride_frames: int = 0
    """Of `ntpp-gmm`; the others have no windows."""

    @property
    def label(self) -> str:
        """The model's name, with window and stride where it has them."""
        windows = f" {self.window_frames}/{self.stride_frames}" if self.window_frames else ""
        return self.spawn + windows


class Sample(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A fit and what its rollouts were like."""

    schema: int
    made_from: str
    """Hash of all that it depends on."""
    nats: float
    """Log-likelihood of the arrivals that it was trained on, nats per person."""
    training_s: float
    """Of one core, whatever else the machine was busy with."""
    present: list[Presence]
    """For each of `SCHEMES`, of all its rollouts together."""
    statistics: dict[str, dict[str, Sparse]]
    """Of the rollout as long as the recording, by metric and name; walking apart."""

    def of(self, metric: str) -> Statistics:
        """The statistics of a metric."""
        return {name: dense(*values) for name, values in self.statistics[metric].items()}


@dataclass(frozen=True)
class Job:
    """One sample to make."""

    configuration: Configuration
    seed: int
    settings: Any
    """`ntpp_training.Settings`; None of a model without any."""
    path: Path
    fingerprint: str


def configurations() -> list[Configuration]:
    """All that are compared, in the order of the page."""
    windows = [
        Configuration("ntpp-gmm", window, stride)
        for window in WINDOWS_FRAMES
        for stride in STRIDES_FRAMES
    ]
    return [Configuration("poisson-gmm"), Configuration("renewal-gmm"), *windows]


def plan(scene: Scene, folder: Path) -> list[Job]:
    """All samples to make."""
    from crowdbench.spawn.ntpp_training import SETTINGS

    recording = cached(scene.recording.name)
    files = [Path(__file__)]
    files += [recording] if recording.exists() else []  # the plaza's is made by our code
    jobs = []
    for of in configurations():
        changed = {"window_frames": of.window_frames, "stride_frames": of.stride_frames}
        settings = replace(SETTINGS, **changed) if of.window_frames else None
        what = f"{of} {asdict(settings) if settings else ''} {SCHEMES}"
        made_from = fingerprint(scene, what, files)
        for seed in range(SAMPLES):
            path = folder / f"{of.label.replace('/', '-').replace(' ', '-')}_{seed}.json"
            jobs.append(Job(of, seed, settings, path, made_from))
    return jobs


def make(
    jobs: Sequence[Job],
    scene: Scene,
    recording: Trajectories,
    arrivals: Arrivals,
    areas: Areas,
    reference: Reference,
    workers: int,
    progress: Progress,
) -> dict[Configuration, list[Sample]]:
    """Make all samples that are missing; all of each configuration, by seed.

    `progress(done, total)` is called before the first and after each.
    """
    found = {job: sample for job in jobs if (sample := _read(job)) is not None}
    progress(len(found), len(jobs))
    # The longest first: else one process ends alone, and the time that is left seems short.
    missing = sorted((job for job in jobs if job not in found), key=_cost, reverse=True)
    tasks = [(job,) for job in missing]
    common = (scene, recording.observed, arrivals, areas, reference)
    for k, sample in call_each(
        _sample, tasks, workers, common=common, name=lambda job: f"sample {job.path.stem}"
    ):
        found[missing[k]] = sample
        progress(len(found), len(jobs))
    samples: dict[Configuration, list[Sample]] = {}
    for job in jobs:
        samples.setdefault(job.configuration, []).append(found[job])
    return samples


def _read(job: Job) -> Sample | None:
    """What an earlier call made, unless something that it depends on has changed."""
    try:
        sample = read_struct(job.path, Sample, RecordingError, "")
    except RecordingError:  # missing, or another program's: it is written anew
        return None
    return sample if (sample.schema, sample.made_from) == (_SCHEMA, job.fingerprint) else None


def _cost(job: Job) -> tuple[int, float]:
    of = job.configuration
    return of.window_frames, of.window_frames / max(1, of.stride_frames)


def _sample(
    job: Job,
    scene: Scene,
    observed: np.ndarray,
    arrivals: Arrivals,
    areas: Areas,
    reference: Reference,
) -> Sample:
    began = time.process_time()
    model = _fitted(job, scene, arrivals, areas)
    took_s = time.process_time() - began
    seeds = count(job.seed * sum(SCHEMES))
    whole = rollout(scene, model, Straight(), seed=next(seeds))
    present = []
    for scheme in SCHEMES:
        frames = -(-scene.recording.frames // scheme)
        each = [] if scheme == 1 else [next(seeds) for _ in range(scheme)]
        series = [_present(scene, model, seed, frames) for seed in each] or [whole.present()]
        pieces = stretches(observed, scene.recording.frames, scheme)
        seen = [series[part][start:stop] for part, start, stop in pieces]
        present.append(Presence.of(seen, scene.dt_s))
    sample = Sample(
        schema=_SCHEMA,
        made_from=job.fingerprint,
        nats=float(model.log_likelihood(arrivals)),
        training_s=round(took_s, 1),
        present=present,
        statistics=_statistics(whole, reference),
    )
    write_json(job.path, sample, compact=True)
    return sample


def _fitted(job: Job, scene: Scene, arrivals: Arrivals, areas: Areas) -> Any:
    """The spawn model, trained on the whole recording."""
    if job.configuration.spawn == "poisson-gmm":
        return PoissonGMM.fit(arrivals, areas)
    if job.configuration.spawn == "renewal-gmm":
        return RenewalGMM.fit(arrivals, areas)
    from crowdbench.spawn import ntpp_training

    return ntpp_training.fit(arrivals, areas, scene, seed=job.seed, settings=job.settings)


def _present(scene: Scene, model: SpawnModel, seed: int, frames: int) -> Int[np.ndarray, " frames"]:
    """N(t) of a rollout with straight walkers."""
    horizon_s = frames * scene.dt_s
    try:
        return rollout(scene, model, Straight(), seed=seed, horizon_s=horizon_s).present()
    except RecordingError:  # nobody came, as may be in so short a time
        return np.zeros(frames, dtype=np.int64)


def _statistics(crowd: Trajectories, reference: Reference) -> dict[str, dict[str, Sparse]]:
    return {
        metric.name: {
            name: sparse(values)
            for name, values in metric.summarise(crowd, reference.blocks, reference.place).items()
        }
        for metric in metrics_for(reference.blocks)
        if metric.family not in WALK
    }


def recorded_presence(recording: Trajectories) -> list[Presence]:
    """The recording's own N(t) for each of `SCHEMES`, cut as the rollouts are."""
    found = []
    for scheme in SCHEMES:
        series = np.array_split(recording.present(), parts_at(recording.frames, scheme)[1:-1])
        pieces = stretches(recording.observed, recording.frames, scheme)
        seen = [series[part][start:stop] for part, start, stop in pieces]
        found.append(Presence.of(seen, recording.dt_s))
    return found
