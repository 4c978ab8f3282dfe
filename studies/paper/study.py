"""The samples of the study: arrivals and rollouts of each model, and the statistics that are kept.

The samples of a model are one job. Its files contain a fingerprint of everything that they depend
on, so that an interrupted study can continue and outdated samples are never reused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float, Int

from crowdbench.code import code_hash
from crowdbench.data.recordings.catalogue import cached
from crowdbench.data.storage import read_own, write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError
from crowdbench.files import read_struct, sha256, write_json
from crowdbench.metrics import PAPER, MetricResult
from crowdbench.policies import Straight
from crowdbench.registry import policy as find_policy
from crowdbench.registry import spawn_model, spawn_source, trained_policies
from crowdbench.run.episode import arrivals as draw_arrivals
from crowdbench.run.executor import call_each
from crowdbench.run.rollout import rollout
from crowdbench.run.rollout_jobs import Progress
from crowdbench.scene import Scene
from crowdbench.scoring.reference import Reference
from crowdbench.spawn import Areas, Arrivals, PoissonGMM, PoissonPaper, SpawnModel
from crowdbench.spawn.paper.kernels import density
from crowdbench.spawn.paper.model import NtppPaper
from crowdbench.spawn.times.groups import KolmogorovSmirnov, kolmogorov_smirnov
from studies.paper.bursts import Bursts
from studies.paper.fits import (
    COMPARED,
    POISSON,
    POISSON_CODE,
    RECORDED,
    SAMPLES,
    SHIPPED,
    Configuration,
    Fit,
    fit_of,
    read_fit,
    windowed,
)
from studies.paper.presence import Presence, parts_at, stretches

SCHEMES = (1, 10)
"""Numbers of rollouts into which the length of the recording is divided."""
DRAWS = 20
"""Number of samples of the arrivals alone, for each of `SAMPLES`."""
WALKER = "bc-paper"
"""The paper's policy; scenes without it use straight walkers."""
_READERS = ("crowdbench.data.recordings",)
"""The recording itself is hashed, not how it is read."""
_SCHEMA = 2


class Sample(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Statistics of one sample of a model."""

    schema: int
    made_from: str
    """Hash of everything that the sample depends on."""
    nats: float | None
    """Log-likelihood of the training arrivals, nats per person; None for the recording itself."""
    training_s: float
    """CPU time of the training, seconds."""
    own: KolmogorovSmirnov | None
    """Test of a sample of `ntpp-paper` against its own density, by time rescaling."""
    present: list[Presence]
    """The number of people present for each of `SCHEMES`, all rollouts pooled; walkers are
    straight."""
    bursts: list[Bursts]
    """Of samples of the arrivals alone."""


@dataclass(frozen=True)
class Job:
    """A sample that is needed, and its files."""

    configuration: Configuration
    seed: int
    fit: Fit | None
    policies: tuple[str, ...]
    """The policies whose rollouts are kept, to be compared with the recording."""
    path: Path
    made_from: str

    def crowd(self, policy: str) -> Path:
        """File with the rollout of a policy."""
        return self.path.with_name(f"{self.path.stem}_{policy}.parquet")


def files_of(job: Job) -> list[Path]:
    """The files that a sample is made from or that it writes."""
    fit = [] if job.fit is None else [job.fit.path]
    return [*fit, job.path, *map(job.crowd, job.policies)]


def walker_of(scene: Scene) -> str:
    """The policy of the rollouts that are compared with the recording."""
    return WALKER if WALKER in trained_policies(scene) else "straight"


def plan(scene: Scene, arrivals: Arrivals, folder: Path) -> list[Job]:
    """The samples of all configurations."""
    recording = cached(scene.recording.name)
    files = [scene.folder / "areas.json", spawn_source(SHIPPED.spawn, scene).fits]
    files += sorted(scene.folder.glob("policies/*/full.onnx"))
    files += [recording] if recording.exists() else []  # the recording of the plaza is generated
    hashes = [sha256(file.read_bytes()) for file in files if file is not None]
    of_scene = f"{scene.rules!r} {code_hash(__name__, cut=_READERS)} {hashes}"
    walker = walker_of(scene)
    shown = tuple(dict.fromkeys([walker, "straight"]))
    shown += tuple(p for p in ("bc",) if p in trained_policies(scene))
    jobs = []
    for of in dict.fromkeys([RECORDED, *COMPARED, *windowed()]):
        policies = shown if of == RECORDED else (walker,) if of in COMPARED else ()
        for seed in range(SAMPLES):
            fit = fit_of(of, seed, scene, arrivals, folder / "fits") if of.window_frames else None
            what = f"{of} {seed} {policies} {SCHEMES} {DRAWS} {fit.made_from if fit else ''}"
            path = folder / f"{of.stem}_{seed}.json"
            made_from = sha256(f"{of_scene} {what}".encode())[:16]
            jobs.append(Job(of, seed, fit, policies, path, made_from))
    return jobs


def make(
    jobs: Sequence[Job],
    scene: Scene,
    recording: Trajectories,
    arrivals: Arrivals,
    areas: Areas,
    workers: int,
    progress: Progress,
) -> dict[Configuration, list[Sample]]:
    """Make the missing samples; return all samples of each configuration, in the order of seeds.

    `progress(done, total)` is called before the first sample and after each.
    """
    found = {job: sample for job in jobs if (sample := _read(job)) is not None}
    progress(len(found), len(jobs))
    # The longest jobs first, so that all processes end at about the same time.
    missing = sorted((job for job in jobs if job not in found), key=lambda j: -len(j.policies))
    tasks = [(job,) for job in missing]
    common = (scene, recording.observed, arrivals, areas)
    for k, sample in call_each(
        _sample,
        tasks,
        workers,
        common=common,
        name=lambda job: f"sample {job.path.stem}",
        files=files_of,
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
    known = (sample.schema, sample.made_from) == (_SCHEMA, job.made_from)
    return sample if known and all(job.crowd(p).exists() for p in job.policies) else None


def _sample(
    job: Job,
    scene: Scene,
    observed: np.ndarray,
    arrivals: Arrivals,
    areas: Areas,
) -> Sample:
    model, took_s = _fitted(job, scene, arrivals, areas)
    seeds = count(job.seed * 100)
    present, bursts, nats, own = [], [], None, None
    if job.configuration != RECORDED:
        nats = float(model.log_likelihood(arrivals))
        present = [
            _present(scene, model, [next(seeds) for _ in range(scheme)], observed)
            for scheme in SCHEMES
        ]
        bursts = [_bursts(scene, model, next(seeds), arrivals) for _ in range(DRAWS)]
    if isinstance(model, NtppPaper):
        rng = np.random.default_rng(job.seed)
        own = kolmogorov_smirnov(residuals_of(model, scene.horizon_s, rng))
    for policy in job.policies:
        crowd = rollout(scene, model, find_policy(policy, scene), seed=next(seeds))
        write_parquet(crowd, job.crowd(policy))
    sample = Sample(
        schema=_SCHEMA,
        made_from=job.made_from,
        nats=nats,
        training_s=took_s,
        own=own,
        present=present,
        bursts=bursts,
    )
    write_json(job.path, sample, compact=True)
    return sample


def residuals_of(
    model: NtppPaper, horizon_s: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Time-rescaled gaps of a sample: uniform on [0, 1] if it follows the model's own density.

    Source: Brown et al. (2002), The time-rescaling theorem, Neural Computation 14.
    """
    found = []
    for k, times in enumerate(model.times(horizon_s, rng)):
        # The last gap counts like the others here: it ends with an event.
        hazard = density(np.diff(times, prepend=0.0), model.of_area(k), model.published_code)[1]
        found.append(-np.expm1(-hazard))
    return np.concatenate(found)


def _fitted(job: Job, scene: Scene, arrivals: Arrivals, areas: Areas) -> tuple[Any, float]:
    """The spawn model of a job, fitted to the whole recording, and the time of its training."""
    if job.fit is not None:
        return read_fit(job.fit, scene, arrivals, areas)
    if job.configuration == POISSON:
        return PoissonGMM.fit(arrivals, areas), 0.0
    if job.configuration == POISSON_CODE:
        return PoissonPaper.fit_frames(arrivals, areas, scene), 0.0
    return spawn_model(job.configuration.spawn, scene, fit=job.seed), 0.0


def _present(
    scene: Scene, model: SpawnModel, seeds: Sequence[int], observed: Int[np.ndarray, "I 2"]
) -> Presence:
    """N(t) of rollouts with straight walkers that together are as long as the recording."""
    frames = -(-scene.recording.frames // len(seeds))
    series = []
    for seed in seeds:
        horizon_s = frames * scene.dt_s
        try:
            crowd = rollout(scene, model, Straight(), seed=seed, horizon_s=horizon_s)
            series.append(crowd.present())
        except RecordingError:  # nobody entered, which is possible in a short time
            series.append(np.zeros(frames, dtype=np.int64))
    pieces = stretches(observed, scene.recording.frames, len(seeds))
    return Presence.of([series[part][start:stop] for part, start, stop in pieces], scene.dt_s)


def _bursts(scene: Scene, model: SpawnModel, seed: int, arrivals: Arrivals) -> Bursts:
    """Arrivals alone, in the times in which the recording is observed.

    Recorded people are first seen at a point of the annotation grid. Those of a model that knows
    no grid are counted in the same way.
    """
    frames, grid_s = scene.recording.frames, arrivals.grid_s
    events = draw_arrivals(model, scene, seed=seed, world=0, warm_up=0, frames=frames)
    area = events.spawn_area.astype(np.int64)
    seen_s = np.ceil(events.time_s / grid_s - 1e-6) * grid_s
    return Bursts.of(seen_s, area, _observed_s(arrivals), scene, arrivals.areas)


def recorded_bursts(scene: Scene, arrivals: Arrivals) -> Bursts:
    """The recorded arrivals."""
    time_s = arrivals.tick * arrivals.grid_s
    return Bursts.of(time_s, arrivals.area, _observed_s(arrivals), scene, arrivals.areas)


def _observed_s(arrivals: Arrivals) -> np.ndarray:
    return arrivals.windows * arrivals.grid_s


def recorded_presence(recording: Trajectories) -> list[Presence]:
    """The recording's N(t) for each of `SCHEMES`, divided in the same way as the rollouts."""
    found = []
    for scheme in SCHEMES:
        series = np.array_split(recording.present(), parts_at(recording.frames, scheme)[1:-1])
        pieces = stretches(recording.observed, recording.frames, scheme)
        seen = [series[part][start:stop] for part, start, stop in pieces]
        found.append(Presence.of(seen, recording.dt_s))
    return found


def compared(
    jobs: Sequence[Job], reference: Reference
) -> dict[tuple[Configuration, str], list[dict[str, MetricResult]]]:
    """Rollouts compared with the recording by the paper's metrics, by model and policy."""
    statistics = {name: reference.statistics[name] for name in PAPER}
    only = replace(reference, statistics=statistics)
    found: dict[tuple[Configuration, str], list[dict[str, MetricResult]]] = {}
    for job in jobs:
        for policy in job.policies:
            results = only.score(read_own(job.crowd(policy)))
            found.setdefault((job.configuration, policy), []).append(results)
    return found


def crowds_of(jobs: Sequence[Job], policy: str) -> Mapping[tuple[str, str, int], Path]:
    """Files with the rollouts of a policy, by model, policy and seed."""
    return {
        (job.configuration.model, policy, job.seed): job.crowd(policy)
        for job in jobs
        if policy in job.policies
    }
