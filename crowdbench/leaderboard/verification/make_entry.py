"""From an untrusted submission to its entry: run and score the rollouts.

This runs inside the sandbox. Rollouts stay in the working folder, so that an interrupted
verification can be continued.
"""

from collections.abc import Mapping, Sequence
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from crowdbench import __version__
from crowdbench.data.blocks import SPLITS
from crowdbench.exam import verdicts
from crowdbench.leaderboard.submission.submission import Submission, read_submission
from crowdbench.leaderboard.verification.entry import (
    SCHEMA,
    SCORER,
    Entry,
    ExamEntry,
    Flag,
    SceneEntry,
    check_unused,
)
from crowdbench.leaderboard.verification.scene_entry import SceneRollouts, scene_entry
from crowdbench.progress import ROLLOUTS
from crowdbench.registry import recording_of
from crowdbench.run.jobs import Job, plan
from crowdbench.run.judge import TRAJECTORIES
from crowdbench.run.processes import alone_in
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import RECORDED_POLICIES
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn.names import PERTURBED

RECORDED = 2
"""Number of rollouts of a ranked policy under the recorded arrivals, whose scores do not count."""


def make_entry(
    submission: str,
    work: str,
    workers: int | None,
    rollouts: int | None = None,
    owners: Mapping[str, Sequence[str]] = MappingProxyType({}),
    examine: bool = False,
    replace_entry: bool = False,
    key: str = "",
    known: Mapping[str, tuple[SceneEntry, Sequence[Flag]]] = MappingProxyType({}),
) -> Entry:
    """Roll out a submission, score it and return its entry.

    `rollouts` is the number per split, by default that of the scene's protocol. `owners` are the
    authors of other entries by id, and `replace_entry` is `replace` of `check_unused`. `examine`
    puts the policy through the exam. `key` is that of the perturbed arrivals, under which policies
    are ranked; nobody may have known it before.
    `known` are results by scene, which are not made again, with their flags.

    Raises:
        OutputError: the id belongs to an entry of other authors.
        CrowdbenchError: the submission or one of its models is invalid.
        RecordingError: a scene's recording is missing.
    """
    given = read_submission(Path(submission))
    authors = given.declared.authors
    check_unused(submission, given.id, authors, owners, replace=replace_entry)
    folder = Path(work).resolve() / given.id
    scenes: dict[str, SceneEntry] = {}
    flags: list[Flag] = []
    # Rollouts name their models by relative paths, and are found again if the folder has moved.
    with chdir(given.folder):
        here = replace(given, folder="")
        names = here.declared.scenes
        planned = {n: _planned(here, n, folder, rollouts, key) for n in names if n not in known}
        total, before = sum(len(each.jobs) for each in planned.values()), 0
        with alone_in(folder):
            for name in names:
                found: Sequence[Flag]
                if name in known:
                    scenes[name], found = known[name]
                else:
                    each = planned[name]
                    each.roll_out(workers, lambda done, _, b=before: ROLLOUTS(b + done, total))  # type: ignore[misc]
                    before += len(each.jobs)
                    scenes[each.place.id], found = scene_entry(each)
                flags += found
        exam = _exam(here) if examine else None
    return Entry(
        schema=SCHEMA,
        id=given.id,
        status=given.status,
        declared=given.declared,
        scorer=SCORER,
        crowdbench=__version__,
        artefacts=given.artefacts,
        scenes=scenes,
        flags=flags,
        exam=exam,
        key=key if any(scene.as_recorded for scene in scenes.values()) else "",
        history=[],
    )


def _exam(given: Submission) -> ExamEntry | None:
    """The exam of the policy that walks on the first scene; None without one, or if it replays."""
    name = given.declared.scenes[0]
    if given.declared.track == "spawn" or given.trajectories_of(name):
        return None
    policy = given.policy_of(name)
    if policy in RECORDED_POLICIES:
        return None
    split = SPLITS[1] if given.protocol == "heldout" else "full"
    found = verdicts(policy, name, split=split)
    return ExamEntry(
        scene=name,
        body_radius_m=found.body_radius_m,
        passed=[of.id for of in found.tests if of.passed],
        failed=[of.id for of in found.tests if not of.passed],
    )


def _planned(
    given: Submission, name: str, folder: Path, rollouts: int | None, key: str
) -> SceneRollouts:
    place = load_scene(name)
    recording_of(place)  # where it is missing, this is said before any rollout
    reference = read_reference(place)
    track, protocol = given.declared.track, given.protocol
    if tables := given.trajectories_of(name):
        pair = ("replay" if track == "walk" else TRAJECTORIES, TRAJECTORIES)
        crowd, walk = (None if track == "walk" else pair), (None if track == "spawn" else pair)
        jobs = [Job(name, *pair, "full", 0, k, path, "") for k, path in enumerate(tables)]
        return SceneRollouts(place, reference, protocol, crowd, walk, jobs, len(jobs))
    policy = given.policy_of(name)
    crowd = None if track == "walk" else (given.spawn_of(name), policy)
    recorded = None if track == "spawn" else ("replay", policy)
    ranked = recorded and given.status == "ranked"
    walk = (f"{PERTURBED}:{key}", policy) if ranked else recorded
    default = place.protocol.fits * place.protocol.rollouts_per_fit
    seeds = default if rollouts is None else rollouts
    pairs = list(dict.fromkeys(pair for pair in (crowd, walk) if pair is not None))
    jobs = plan(name, place, pairs, protocol, seeds, folder / name)
    if walk != recorded and recorded is not None:
        jobs += plan(name, place, [recorded], protocol, RECORDED, folder / name)
    return SceneRollouts(place, reference, protocol, crowd, walk, jobs, seeds)
