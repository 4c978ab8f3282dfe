"""`exam`: put policies through the tests."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from crowdbench import __version__
from crowdbench.data.table import Trajectories
from crowdbench.errors import CrowdbenchError, SettingError, did_you_mean
from crowdbench.exam import other_guidelines, rimea  # noqa: F401  # they fill the list of tests
from crowdbench.exam.results import Certificate, TrialResult, failed, result_of
from crowdbench.exam.rooms import Room
from crowdbench.exam.trial import TRIALS, Run, Trial, Values
from crowdbench.files import unwritable
from crowdbench.policies import Policy
from crowdbench.progress import tell
from crowdbench.registry import policy as policy_of
from crowdbench.run.executor import call_each, checked_workers
from crowdbench.scene import LARGEST_BODY_M, Scene, load_scene
from crowdbench.scoring.ranking import RECORDED_POLICIES

BODY_RADIUS_M = 0.15
"""Radius of bodies in scenes that have none of their own, in metres."""
RANDOM = "random"


def exam(
    policy: str | Sequence[str],
    scene: str | Path | Scene = "eth-v0",
    *,
    tests: Sequence[str] | None = None,
    body_radius_m: float | None = None,
    workers: int | None = None,
    out: str | Path | None = None,
) -> list[Certificate]:
    """Put policies through the rooms of RiMEA, IMO and ISO 20414; returns a certificate for each.

    Args:
        policy: names of policies, ONNX files or `pkg.module:Class`.
        scene: the rooms have its time step and its limits of motion, and policies by name are those
            trained for it.
        tests: ids of tests, see `TRIALS`; default: all.
        body_radius_m: radius of bodies, 0 for none; default: that of the scene, 0.15 m if it has
            none.
        workers: number of processes; default: one per core. The results are the same.
        out: folder for `exam.html`, with pictures of the rooms, and `exam.json`.

    Raises:
        SettingError: a policy or a test does not exist, a policy only replays recordings, or a
            number is out of range.
        SceneError: there is no such scene.
        WeightsError: a policy's file does not fit.
        ActionError: a policy does not return one finite action per person.
        OutputError: `out` cannot be written.
    """
    chosen = _chosen(tests)
    names = [policy] if isinstance(policy, str) else list(dict.fromkeys(policy))
    processes = checked_workers(workers)
    place = _with_bodies(load_scene(scene), body_radius_m)
    for name in names:
        _check(name, place)
    if out is not None:
        _make(Path(out))
    everyone = dict.fromkeys([*names, RANDOM])
    tasks = [
        (name, of.id, seed)
        for of in chosen
        for name in everyone
        for seed in range(of.seeds if name in names else 1)
    ]
    found: dict[tuple[str, str, int], tuple[Values, Room, Trajectories]] = {}
    tell("rooms", 0, len(tasks))
    walks = call_each(_walked, tasks, processes, common=(place,), name=_named)
    for done, (index, result) in enumerate(walks, 1):
        found[tasks[index]] = result
        tell("rooms", done, len(tasks))

    def values(name: str, of: Trial, seeds: int) -> list[Values]:
        return [found[name, of.id, seed][0] for seed in range(seeds)]

    by_chance = {of.id: result_of(of, values(RANDOM, of, 1)).passed for of in chosen}
    certificates = [
        _certificate(
            name,
            place,
            [
                result_of(of, values(name, of, of.seeds), random_passes=by_chance[of.id])
                for of in chosen
            ],
        )
        for name in names
    ]
    if out is not None:
        from crowdbench.exam.page import write_exam

        shown = {(name, of.id): found[name, of.id, 0][1:] for name in names for of in chosen}
        write_exam(certificates, shown, Path(out))
    return certificates


def verdicts(
    policy: str | Policy, scene: str | Path | Scene, *, split: str = "full"
) -> Certificate:
    """The certificate of one policy in all tests, without a comparison with random walkers.

    `policy` is a policy, or its name as in `crowdbench.policy`, where `split` selects the network
    of a folder. A policy fails a test in which it raises an error.

    Raises:
        SettingError, SceneError, WeightsError: see `exam`.
    """
    place = _with_bodies(load_scene(scene), None)
    walker = policy_of(policy, place, split)
    results = [_result(of, place, walker) for of in _chosen(None)]
    return _certificate(policy if isinstance(policy, str) else policy.name, place, results)


def _result(of: Trial, place: Scene, walker: Policy) -> TrialResult:
    try:
        return result_of(of, [of.run(Run(place, walker, seed)) for seed in range(of.seeds)])
    except CrowdbenchError:
        return failed(of)


def _certificate(policy: str, place: Scene, tests: Sequence[TrialResult]) -> Certificate:
    return Certificate(
        crowdbench=__version__,
        policy=policy,
        scene=place.id,
        dt_s=place.dt_s,
        body_radius_m=place.motion.body_radius_m,
        tests=tuple(tests),
    )


def _check(policy: str, place: Scene) -> None:
    """Report a wrong policy before minutes of rollouts."""
    if policy in RECORDED_POLICIES:
        raise SettingError(
            "exam",
            got=f"the policy {policy}",
            expected="one that can walk where nobody was recorded",
        )
    policy_of(policy, place)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error


def _chosen(tests: Sequence[str] | None) -> list[Trial]:
    for name in tests or ():
        if name not in TRIALS:
            raise SettingError(
                "exam", got=repr(name), expected=f"one of {', '.join(TRIALS)}",
                hint=did_you_mean(name, list(TRIALS)),
            )  # fmt: skip
    return [TRIALS[name] for name in dict.fromkeys(tests or TRIALS)]


def _with_bodies(scene: Scene, radius_m: float | None) -> Scene:
    if radius_m is None:
        radius_m = scene.motion.body_radius_m or BODY_RADIUS_M
    if not 0 <= radius_m <= LARGEST_BODY_M:
        raise SettingError(
            "body_radius_m", got=str(radius_m), expected=f"0 (no bodies) to {LARGEST_BODY_M}"
        )
    return replace(scene, motion=msgspec.structs.replace(scene.motion, body_radius_m=radius_m))


def _walked(policy: str, trial: str, seed: int, place: Scene) -> tuple[Values, Room, Trajectories]:
    """Measured values of a test, and its last room with what happened in it."""
    run = Run(place, policy_of(policy, place), seed)
    values = TRIALS[trial].run(run)
    return values, *run.walked[-1]


def _named(policy: str, trial: str, seed: int) -> str:
    return f"{policy} in the test {trial}, seed {seed}"
