"""From an opened submission to its entry: rollouts and their scores.

This runs inside the sandbox. What is rolled out is left in the folder of work, so that a
verification that was stopped goes on where it was.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from crowdbench import __version__
from crowdbench.errors import RecordingError
from crowdbench.evaluation.judge import judge
from crowdbench.evaluation.rollout_jobs import Job, Pair, RolloutSummary, alone_in, plan, roll_out
from crowdbench.leaderboard.submission.submission import Submission, open_submission
from crowdbench.leaderboard.verification.entry import SCHEMA, SCORER, Entry, Flag, SceneEntry
from crowdbench.leaderboard.verification.scene_entry import Rollouts, scene_entry
from crowdbench.registry import has_recording, recording_of
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import Reference, read_reference
from crowdbench.scoring.scorecard import Protocol, read_anchors
from crowdbench.spawn.areas import read_areas
from crowdbench.trajectories.storage import read, read_own
from crowdbench.trajectories.table import Trajectories

TRAJECTORIES = "trajectories"
"""What stands for the models of a crowd that comes as tables."""


@dataclass(frozen=True, eq=False)
class _Task:
    """A scene that a submission is for, before anything is rolled out."""

    place: Scene
    reference: Reference
    protocol: Protocol
    crowd: Pair | None
    """What the families of crowds are of; None on track walk."""
    walk: Pair | None
    """What motion and interaction are of; None on track spawn."""
    jobs: list[Job]
    seeds: int


def make_entry(
    progress: Callable[[int, int], None],
    submission: str,
    work: str,
    workers: int | None,
    rollouts: int | None = None,
) -> Entry:
    """Roll out what a submission brings and score it.

    `progress(done, total)` counts rollouts. `rollouts` of each part are by default the protocol's.

    Raises:
        CrowdbenchError: the submission, or what it brings, is not as it should be.
        RecordingError: a scene's recording is not at hand.
    """
    with open_submission(Path(submission)) as given:
        folder = Path(work).resolve() / given.id
        # By names that do not tell where it lies (a zip is unpacked elsewhere each time) rollouts
        # are found again.
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
            Job(name, *pair, part="full", fit=0, seed=k, path=path, fingerprint="")
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
    """A path into the submission as seen from there; other names as they are."""
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
    """A rollout's table; of another program's the areas are those of where people were."""
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
    """The scene's recording, without which walkers are not scored and copies not found."""
    if not has_recording(place):
        raise RecordingError(
            place.id,
            got="no recording",
            expected="its recording, under whose arrivals people walk and in which copies are "
            "looked for",
            hint=f"Run `crowdbench data fetch {place.recording.name}`.",
        )
    return recording_of(place)
