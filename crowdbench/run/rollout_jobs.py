"""Makes the rollouts that jobs ask for, unless they exist already.

All that scores need of a rollout is its summary. It goes into the store, `crowdbench.run.store`, so
that interrupted work can continue and no rollout is made twice. Its trajectories are written as a
Parquet file if somebody wants to see them.
"""

import functools
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

from crowdbench.code import code_hash
from crowdbench.data.blocks import HELD_OUT
from crowdbench.data.storage import read_own, write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import CrowdbenchError, OwnCodeError, RecordingError
from crowdbench.files import sha256
from crowdbench.plugins import told
from crowdbench.policies import Policy
from crowdbench.progress import ROLLOUTS
from crowdbench.registry import recording_of
from crowdbench.registry.recordings import recording_hash
from crowdbench.run import store
from crowdbench.run.executor import call_each, checked_workers, is_local
from crowdbench.run.jobs import Job, Models, batches, fitted_for, walkers_of
from crowdbench.run.processes import Stopped
from crowdbench.run.resolved import MODELS, Resolved
from crowdbench.run.rollout import rollouts, seed_of
from crowdbench.run.summaries import RolloutSummary, code_of_summaries
from crowdbench.scene import load_scene, scenes_folder
from crowdbench.scoring.reference import Reference
from crowdbench.spawn import SpawnModel
from crowdbench.spawn.events import blocks_of

Progress = Callable[[int, int], None]
Measure = Callable[[Job, Trajectories], dict[str, float]]
"""What else is measured of a rollout, by name; a function of a module."""
TABLE, SUMMARY = ".parquet", ".summary"
"""Suffixes of files in the store."""

LIGHT_FRAMES = 30_000
"""Up to this number of frames, no other process is started: about two seconds of work, which is
what a process needs to start."""


def roll_out(
    jobs: list[Job],
    reference: Reference | None,
    workers: int | None = None,
    progress: Progress = ROLLOUTS,
    measure: Measure | None = None,
) -> dict[Job, RolloutSummary]:
    """Make all missing rollouts; returns the summary of each, in the order of the jobs.

    `progress(done, total)` is called before the first and after each batch of rollouts.
    `workers` is the number of processes, by default one per core, or none but this one if that is
    faster. Without a reference, there are no summaries. `measure` adds numbers to the summaries.
    """
    code = None if reference is None else code_of_summaries(reference)
    of_measure = _measured_by(jobs, measure)
    keys = {
        job: _summary_key(job, code + of_measure) for job in jobs if code and not _pair(job).foreign
    }
    rolled = {job: summary for job, key in keys.items() if (summary := _kept_summary(job, key))}
    tasks = [
        (batch, missing, tuple(job for job in batch if job.shown or job not in keys))
        for batch in batches(jobs)
        if (missing := tuple(job for job in batch if job not in rolled))
        or any(j.shown for j in batch)
    ]
    if workers is None and is_local() and _light([batch for batch, *_ in tasks]):
        workers = 1
    made = len(jobs) - sum(len(batch) for batch, *_ in tasks)
    progress(made, len(jobs))
    # Closing ends the worker processes even if this function is left early.
    with closing(
        call_each(
            _roll_out,
            tasks,
            checked_workers(workers),
            common=(reference, measure),
            name=_told,
            files=lambda batch, *_: [job.path for job in batch],
            reads=_own_files,
        )
    ) as done:
        for k, summaries in done:
            batch, missing, _ = tasks[k]
            for job, summary in zip(missing, summaries, strict=False):
                rolled[job] = summary
                if code and job in keys:  # kept for whoever measures nothing, too
                    encoded = summary.encoded()
                    for key in {keys[job], _summary_key(job, code)}:
                        store.keep(key, SUMMARY, encoded, job.path.parent)
            made += len(batch)
            progress(made, len(jobs))
    if tasks:
        store.clean()
    return {job: rolled[job] for job in jobs if job in rolled}


def _light(batched: Sequence[tuple[Job, ...]]) -> bool:
    """Whether all rollouts take less time than starting a process: few, and without networks.

    A class of a user's is never walked in this process, which it could end.
    """
    frames = 0
    for batch in batched:
        pair = _pair(batch[0])
        if pair.own or pair.policy.files(batch[0].split):
            return False
        frames += len(batch) * pair.scene.recording.frames
    return frames <= LIGHT_FRAMES


def _own_files(batch: tuple[Job, ...], *_: object) -> list[Path]:
    pair = _pair(batch[0])
    named = [*pair.policy.files(batch[0].split), pair.spawn.scenario, pair.spawn.fits]
    if not pair.scene.folder.is_relative_to(scenes_folder()):
        named += sorted(path for path in pair.scene.folder.rglob("*") if path.is_file())
    return [p for p in named if p is not None and not p.is_relative_to(scenes_folder())]


def _told(batch: tuple[Job, ...], *_: object) -> str:
    first, last = batch[0], batch[-1]
    return str(first) if first is last else f"{first} to {last.seed}"


def _measured_by(jobs: Sequence[Job], measure: Measure | None) -> str:
    """Hash of what a measurement depends on besides the rollout: its code and the recordings."""
    if measure is None:
        return ""
    scenes = {job.scene: _pair(job).scene for job in jobs}
    recordings = [recording_hash(scene) for scene in scenes.values()]
    return "".join([code_hash(measure.__module__, cut=MODELS), *recordings])


def _summary_key(job: Job, code: str) -> str:
    return sha256(f"{_key(job)} {code}".encode())[:32]


def _kept_summary(job: Job, key: str) -> RolloutSummary | None:
    with suppress(OSError):  # another process may remove it
        file = store.find(key, SUMMARY, job.path.parent)
        return None if file is None else RolloutSummary.decoded(file.read_bytes())
    return None


def _roll_out(
    batch: tuple[Job, ...],
    missing: tuple[Job, ...],
    shown: tuple[Job, ...],
    reference: Reference | None,
    measure: Measure | None,
) -> list[RolloutSummary]:
    """The missing summaries of a batch, and the trajectories of those that are shown."""
    crowds = _made(batch, tuple(dict.fromkeys((*missing, *shown))), shown)
    if reference is None:
        return []
    return [
        RolloutSummary.of_crowd(
            crowds[job], reference, measure(job, crowds[job]) if measure else {}
        )
        for job in missing
    ]


def _made(
    batch: tuple[Job, ...], wanted: Sequence[Job], shown: Sequence[Job]
) -> dict[Job, Trajectories]:
    """The rollouts that are wanted, from files of the jobs or from the store, otherwise made.

    Those that are shown are written into files of the jobs, and into the store.
    """
    shared = not _pair(batch[0]).foreign
    crowds = {job: crowd for job in wanted if (crowd := _kept(job)) is not None}
    missing = [job for job in wanted if job not in crowds]
    found = {job: crowd for job in missing if shared and (crowd := _in_store(job))}
    to_make = [job for job in missing if job not in found]
    if to_make and not batch[0].exact:
        to_make = list(batch)
    made = zip(to_make, _rolled_out(to_make), strict=True) if to_make else ()
    for job, crowd in (found | dict(made)).items():
        crowds[job] = replace(crowd, provenance=_provenance(job))
        if job in shown:
            write_parquet(crowds[job], job.path)
            if shared and job in to_make:
                store.keep(_key(job), TABLE, job.path.read_bytes())
    return crowds


def _kept(job: Job) -> Trajectories | None:
    with suppress(RecordingError):  # not a valid rollout: it is overwritten
        crowd = read_own(job.path)
        return crowd if dict(crowd.provenance) == _provenance(job) else None
    return None


def _in_store(job: Job) -> Trajectories | None:
    file = store.find(_key(job), TABLE)
    with suppress(RecordingError):  # another process may remove it
        return None if file is None else read_own(file)
    return None


def _key(job: Job) -> str:
    """Key of a rollout in the store: its models may have other names elsewhere."""
    return sha256(f"{job.fingerprint} {job.fit} {job.seed}".encode())[:32]


def _provenance(job: Job) -> dict[str, object]:
    names = ("spawn", "policy", "split", "fit", "seed")
    return {name: getattr(job, name) for name in names} | {"made_from": job.fingerprint}


def _rolled_out(jobs: Sequence[Job]) -> list[Trajectories]:
    """The rollouts of jobs with the same models and split.

    The rollout is added to the message of errors that a user's own class raises.

    Raises:
        OwnCodeError: the class raised an exception that is not a `CrowdbenchError`.
    """
    first, pair = jobs[0], _pair(jobs[0])
    try:
        models = [_loaded(job.models, job.split, job.fit) for job in jobs]
        seeds = [seed_of(job.split, job.seed) for job in jobs]
        spawn, walkers, turns = [model for model, _ in models], models[0][1], []
        if first.split == HELD_OUT:
            blocks = blocks_of(recording_of(pair.scene), pair.scene)
            turns = [(frame, walkers[fold]) for frame, fold in blocks.turns()]
        walker = next(iter(walkers.values()))
        return rollouts(pair.scene, spawn, walker, seeds=seeds, turns=turns)
    except Stopped:
        raise
    except CrowdbenchError as error:
        if not pair.own:
            raise
        where = f"{error.where}, {first}"
        raise type(error)(where, got=error.got, expected=error.expected, hint=error.hint) from error
    except (Exception, SystemExit) as error:
        if not pair.own:
            raise
        raise OwnCodeError(
            f"{' or '.join(pair.own)}, {first}",
            got=told(error),
            expected="no error",
            hint="Correct the class and start again: rollouts of other models are kept.",
        ) from error


def _pair(job: Job) -> Resolved:
    return _resolved(job.models)


@functools.lru_cache(maxsize=8)
def _resolved(models: Models) -> Resolved:
    scene, spawn, policy, _ = models
    return Resolved.of(load_scene(scene), spawn, policy)


@functools.lru_cache(maxsize=8)  # jobs of one pair are consecutive, so a recording is read once
def _loaded(models: Models, split: str, fit: int) -> tuple[SpawnModel, dict[str, Policy]]:
    pair = _resolved(models)
    return pair.spawn.model(fitted_for(split), fit), walkers_of(pair, split)
