"""The samples of the study: a fit, its rollouts, and the statistics that are kept.

Each sample is a separate job. Its file contains a fingerprint of everything that it depends on, so
that an interrupted study can continue and outdated samples are never reused.
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
from crowdbench.evaluation.resolved import fingerprint
from crowdbench.evaluation.rollout_jobs import Progress
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
"""The paper's windows and strides; its text calls the strides overlaps."""
SAMPLES = 5
"""Samples of each configuration: fits with seeds 0, 1, …, which matter more than rollout seeds."""
SCHEMES = (1, 10)
"""Numbers of rollouts into which the length of the recording is divided."""
_SCHEMA = 1


@dataclass(frozen=True)
class Configuration:
    """A spawn model and how it is trained."""

    spawn: str
    window_frames: int = 0
    stride_frames: int = 0
    """Only `ntpp-gmm` has windows and strides; 0 for other models."""

    @property
    def label(self) -> str:
        """Name of the model, with window and stride if it has them: `ntpp-gmm 100/5`."""
        windows = f" {self.window_frames}/{self.stride_frames}" if self.window_frames else ""
        return self.spawn + windows


class Sample(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A fit, and statistics of its rollouts."""

    schema: int
    made_from: str
    """Hash of everything that the sample depends on."""
    nats: float
    """Log-likelihood of the training arrivals, nats per person."""
    training_s: float
    """CPU time of the training, seconds."""
    present: list[Presence]
    """The number of people present for each of `SCHEMES`, all rollouts pooled."""
    statistics: dict[str, dict[str, Sparse]]
    """Statistics of the full-length rollout by metric and name, except motion and interaction."""

    def of(self, metric: str) -> Statistics:
        """The statistics of a metric."""
        return {name: dense(*values) for name, values in self.statistics[metric].items()}


@dataclass(frozen=True)
class Job:
    """A sample that is needed."""

    configuration: Configuration
    seed: int
    settings: Any
    """`ntpp_training.Settings`; None for other models."""
    path: Path
    fingerprint: str


def configurations() -> list[Configuration]:
    """All configurations of the study, in the order of the page."""
    windows = [
        Configuration("ntpp-gmm", window, stride)
        for window in WINDOWS_FRAMES
        for stride in STRIDES_FRAMES
    ]
    return [Configuration("poisson-gmm"), Configuration("renewal-gmm"), *windows]


def plan(scene: Scene, folder: Path) -> list[Job]:
    """The samples of all configurations."""
    from crowdbench.spawn.ntpp_training import SETTINGS

    recording = cached(scene.recording.name)
    files = [Path(__file__)]
    files += [recording] if recording.exists() else []  # the recording of the plaza is generated
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
    """Make the missing samples; return all samples of each configuration, in the order of seeds.

    `progress(done, total)` is called before the first sample and after each.
    """
    found = {job: sample for job in jobs if (sample := _read(job)) is not None}
    progress(len(found), len(jobs))
    # The longest jobs first, so that all processes end at about the same time.
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
    """The sample of an earlier call; None if there is none or a dependency has changed."""
    try:
        sample = read_struct(job.path, Sample, RecordingError, "")
    except RecordingError:  # missing or invalid: it is made again
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
    """The spawn model of a job, fitted to the whole recording."""
    if job.configuration.spawn == "poisson-gmm":
        return PoissonGMM.fit(arrivals, areas)
    if job.configuration.spawn == "renewal-gmm":
        return RenewalGMM.fit(arrivals, areas)
    from crowdbench.spawn import ntpp_training

    return ntpp_training.fit(arrivals, areas, scene, seed=job.seed, settings=job.settings)


def _present(scene: Scene, model: SpawnModel, seed: int, frames: int) -> Int[np.ndarray, " frames"]:
    """N(t) of a rollout with straight walkers, frame by frame."""
    horizon_s = frames * scene.dt_s
    try:
        return rollout(scene, model, Straight(), seed=seed, horizon_s=horizon_s).present()
    except RecordingError:  # nobody entered, which is possible in a short time
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
    """The recording's N(t) for each of `SCHEMES`, divided in the same way as the rollouts."""
    found = []
    for scheme in SCHEMES:
        series = np.array_split(recording.present(), parts_at(recording.frames, scheme)[1:-1])
        pieces = stretches(recording.observed, recording.frames, scheme)
        seen = [series[part][start:stop] for part, start, stop in pieces]
        found.append(Presence.of(seen, recording.dt_s))
    return found
