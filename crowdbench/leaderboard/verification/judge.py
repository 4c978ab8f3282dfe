"""From an opened submission to its entry: run and score the rollouts.

This runs inside the sandbox. Rollouts stay in the working folder, so that an interrupted
verification can be continued.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from crowdbench import __version__
from crowdbench.data.storage import read, read_own
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError
from crowdbench.leaderboard.submission.submission import Submission, open_submission
from crowdbench.leaderboard.verification.check import check_unused
from crowdbench.leaderboard.verification.entry import SCHEMA, SCORER, Entry, Flag, SceneEntry
from crowdbench.leaderboard.verification.scene_entry import Rollouts, scene_entry
from crowdbench.registry import has_recording, recording_of
from crowdbench.run.judge import TRAJECTORIES, judge
from crowdbench.run.processes import alone_in
from crowdbench.run.rollout_jobs import Job, Pair, plan, roll_out
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import Reference, read_reference
from crowdbench.scoring.scorecard import Protocol, read_anchors
from crowdbench.spawn.areas import read_areas


@dataclass(frozen=True, eq=False)
class _Task:
    """One scene of a submission and its planned rollouts."""

    place: Scene
    reference: Reference
    protocol: Protocol
    crowd: Pair | None
    """Models scored on arrivals, presence, trips and space; None on track walk."""
    walk: Pair | None
    """Models scored on motion and interaction; None on track spawn."""
    jobs: list[Job]
    seeds: int


def make_entry(
    progress: Callable[[int, int], None],
    submission: str,
    work: str,
    workers: int | None,
    rollouts: int | None = None,
    owners: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> Entry:
    """Roll out a submission, score it and return its entry.

    `progress(done, total)` counts rollouts. `rollouts` is the number per split, by default that of
    the scene's protocol. `owners` are the authors of other entries by id, see `check_unused`.

    Raises:
        OutputError: the id belongs to an entry of other authors.
        CrowdbenchError: the submission or one of its models is invalid.
        RecordingError: a scene's recording is missing.
    """
    with open_submission(Path(submission)) as given:
        check_unused(submission, given.id, given.declared.authors, owners)
        folder = Path(work).resolve() / given.id
        # A zip is unpacked to another folder each time. Relative paths stay the same, so that
        # existing rollouts are found again.
        before = Path.cwd()
        os.chdir(given.folder)
        try:
            tasks = [_task(given, name, folder, rollouts) for name in _scenes(given)]
            with alone_in(folder):
                return _entry(given, tasks, workers, progress)
        finally:
            os.chdir(before)


def _scenes(given: Submission) -> list[str]:
    return list(dict.fromkeys(given.declared.scenes))


def _entry(
    given: Submission,
    tasks: list[_Task],
    workers: int | None,
    progress: Callable[[int, int], None],
) -> Entry:
    total, before = sum(len(task.jobs) for task in tasks), 0
    scenes: dict[str, SceneEntry] = {}
    flags: list[Flag] = []
    for task in tasks:
        rolled = _rolled(task, workers, lambda done, b=before: progress(b + done, total))  # type: ignore[misc]
        before += len(task.jobs)
        card = judge(
            task.place,
            task.reference,
            rolled,
            task.protocol,
            task.seeds,
            read_anchors(task.place).protocols[task.protocol],
        )
        rollouts = Rollouts(task.place, task.reference, card, rolled, task.crowd, task.walk)
        of_scene, raised = scene_entry(rollouts, _recording(task.place), _crowd_of)
        scenes[task.place.id] = of_scene
        flags += raised
    return Entry(
        schema=SCHEMA,
        id=given.id,
        status=given.status,
        declared=given.declared,
        scorer=SCORER,
        crowdbench=__version__,
        artefacts=given.artefacts | given.shipped,
        scenes=scenes,
        flags=flags,
        history=[],
    )


def _task(given: Submission, name: str, folder: Path, rollouts: int | None) -> _Task:
    place = load_scene(name)
    _recording(place)
    reference = read_reference(place)
    track = given.declared.track
    tables = given.trajectories_of(name)
    if tables:
        pair = ("replay" if track == "walk" else TRAJECTORIES, TRAJECTORIES)
        jobs = [
            Job(name, *pair, split="full", fit=0, seed=k, path=path, fingerprint="")
            for k, path in enumerate(tables)
        ]
        crowd, walk = (None if track == "walk" else pair), (None if track == "spawn" else pair)
        return _Task(place, reference, given.protocol, crowd, walk, jobs, len(jobs))
    policy = "straight" if track == "spawn" else _local(given.policy_of(name), given.folder)
    spawn = "replay" if track == "walk" else _local(given.spawn_of(name), given.folder)
    crowd = None if track == "walk" else (spawn, policy)
    walk = None if track == "spawn" else ("replay", policy)
    default = place.protocol.fits * place.protocol.rollouts_per_fit
    seeds = default if rollouts is None else rollouts
    pairs = list(dict.fromkeys(pair for pair in (crowd, walk) if pair is not None))
    jobs = plan(name, place, pairs, given.protocol, seeds, folder / name)
    return _Task(place, reference, given.protocol, crowd, walk, jobs, seeds)


def _local(name: str, folder: Path) -> str:
    """A path in the submission, relative to `folder`; other names are returned unchanged."""
    return os.path.relpath(name, folder) if Path(name).is_absolute() else name


def _rolled(
    task: _Task, workers: int | None, progress: Callable[[int], None]
) -> dict[Job, RolloutSummary]:
    if task.jobs[0].policy != TRAJECTORIES:
        return roll_out(task.jobs, task.reference, workers, lambda done, _: progress(done))
    rolled = {}
    for job in task.jobs:
        rolled[job] = RolloutSummary.of_crowd(_crowd_of(job), task.reference)
        progress(len(rolled))
    return rolled


def _crowd_of(job: Job) -> Trajectories:
    """Read a rollout's table; areas of submitted trajectories are derived from the positions."""
    if job.policy != TRAJECTORIES:
        return read_own(job.path)
    place = load_scene(job.scene)
    crowd = read(job.path, scene=place.id, dt_s=place.dt_s)
    nowhere = np.full(len(crowd), -1, dtype=np.int32)
    unknown = replace(
        crowd, grid_s=place.grid_s, spawn_area=nowhere, goal_area=nowhere, scene=place.id
    )
    return read_areas(place).assign(unknown)


def _recording(place: Scene) -> Trajectories:
    """The scene's recording, which is needed to score policies and to find copies."""
    if not has_recording(place):
        raise RecordingError(
            place.id,
            got="no recording",
            expected="the scene's recording, which is needed to score policies and to find copies",
            hint=f"Run `crowdbench data fetch {place.recording.name}`.",
        )
    return recording_of(place)
