"""Rollouts as jobs: what is to be made, by whom, and what of it is there already.

Every rollout is a job of its own, written as Parquet with a fingerprint of all that it depends on:
work that was killed goes on where it stopped, and nothing stale is taken for new.
"""

import functools
import importlib.util
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from crowdbench import __version__, leftovers, plugins
from crowdbench.errors import (
    CrowdbenchError,
    OutputError,
    OwnCodeError,
    RecordingError,
    SettingError,
)
from crowdbench.evaluation.parallel import Stopped, call_each, checked_workers
from crowdbench.files import sha256, unwritable
from crowdbench.metrics import Metric, Statistics
from crowdbench.plugins import told
from crowdbench.policies import OnnxPolicy, Policy
from crowdbench.recordings.catalogue import cached
from crowdbench.registry import POLICIES, SPAWN_MODELS, policy_file, spawn_model, weights_file
from crowdbench.registry import policy as find_policy
from crowdbench.rollouts.rollout import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import Reference, summarise
from crowdbench.spawn.scenario import split
from crowdbench.trajectories.blocks import PARTS
from crowdbench.trajectories.storage import read_own, write_parquet
from crowdbench.trajectories.table import OUTCOMES, Trajectories

_LARGE = 2**26  # bytes of a file beyond which its age is looked at, not what is in it

MAKES_ROLLOUTS = (
    "scene.py",
    "registry.py",
    *(f"{room}/**/*.py" for room in ("trajectories", "recordings", "spawn", "simulation")),
    *(f"{room}/**/*.py" for room in ("policies", "rollouts")),
    "evaluation/rollout_jobs.py",
)
"""The code that rollouts depend on. A change elsewhere, as of a page, keeps them."""

Result = TypeVar("Result")
Pair = tuple[str, str]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Job:
    """One rollout to make."""

    scene: str
    spawn: str
    policy: str
    part: str
    fit: int
    seed: int
    path: Path
    fingerprint: str
    """Hash of all that the rollout depends on."""

    def __str__(self) -> str:
        return f"rollout {self.seed} of {self.spawn} × {self.policy} on {self.scene} ({self.part})"


@dataclass(frozen=True, eq=False)
class RolloutSummary:
    """What is kept of a rollout."""

    statistics: dict[str, dict[str, tuple[np.ndarray, np.ndarray, int]]]
    """By metric and name: the columns that are not zero, their values, and how many there are."""
    outcomes: np.ndarray

    @classmethod
    def of_crowd(cls, crowd: Trajectories, reference: Reference) -> "RolloutSummary":
        """Summarise a crowd in the time blocks of the reference."""
        statistics: dict[str, dict[str, tuple[np.ndarray, np.ndarray, int]]] = {}
        for metric, of_metric in summarise(
            crowd, reference.blocks, reference.place, reference.metrics
        ).items():
            statistics[metric] = {}
            for name, values in of_metric.items():
                columns = np.flatnonzero(values.any(axis=0))
                statistics[metric][name] = (columns, values[:, columns], values.shape[1])
        return cls(statistics, np.bincount(crowd.outcome, minlength=len(OUTCOMES)))

    def of(self, metric: Metric) -> Statistics:
        """The statistics of a metric."""
        dense = {}
        for name, (columns, values, size) in self.statistics[metric.name].items():
            dense[name] = np.zeros((len(values), size), dtype=np.int64)
            dense[name][:, columns] = values
        return dense


def parts_of(protocol: str) -> tuple[str, ...]:
    """The parts that a protocol averages over."""
    return PARTS[:1] if protocol == "full" else PARTS[1:]


def plan(
    scene: str,
    place: Scene,
    pairs: Sequence[Pair],
    protocol: str,
    seeds: int,
    folder: Path,
) -> list[Job]:
    """All rollouts to make.

    Raises:
        SettingError: a name stands for nothing, or `seeds` is no number of rollouts.
        WeightsError: a network mixes rows.
    """
    fits = place.protocol.fits
    if seeds < 1 or (seeds >= 2 * fits and seeds % fits):
        raise SettingError(
            "seeds",
            got=str(seeds),
            expected=f"a multiple of {fits}, so that each fit has as many rollouts, or 1 to "
            f"{2 * fits - 1} for plain distances only",
        )
    jobs = []
    tried: set[Path] = set()
    for s, p in pairs:
        recorded = s == "replay"
        for part in parts_of(protocol) if _learned(p, place) or not recorded else ("full",):
            walker = find_policy(p, place, part)
            _check_unseen(p, walker, place, part)
            if isinstance(walker, OnnxPolicy) and walker.path not in tried:
                walker.check_rows(place)
                tried.add(walker.path)
            certain = recorded and getattr(walker, "deterministic", False)
            spawn_model(s, place, part=part)
            fingerprint = _fingerprint(place, s, p, part)
            for seed in range(1 if certain else seeds):
                name = f"{_plain(s)}_{_plain(p)}_{part}_{seed}.parquet"
                jobs.append(Job(scene, s, p, part, seed % fits, seed, folder / name, fingerprint))
    return jobs


def _learned(policy: str, place: Scene) -> bool:
    """Whether there is one of it for each part."""
    file = policy_file(policy, place, "full")
    return file is not None and str(file) != policy


def _check_unseen(policy: str, walker: Policy, place: Scene, part: str) -> None:
    """Refuse who has been trained on what it is to be held against.

    Raises:
        SettingError: it has.
    """
    if part == "full" or not isinstance(walker, OnnxPolicy):
        return
    if walker.card.scene == place.id and walker.card.part != part:
        raise SettingError(
            f"policy {policy}",
            got=f"a network trained on {walker.card.part} of {place.id}",
            expected=f"one that has seen nothing of what {part} is scored on",
            hint="Train one for each fold and name the folder with fold0.onnx, fold1.onnx, … , or "
            "evaluate with --protocol full.",
        )


def roll_out(
    jobs: list[Job], reference: Reference, workers: int | None, progress: Progress
) -> dict[Job, RolloutSummary]:
    """Make all rollouts that are missing; what is kept of each, in the order of the jobs.

    `progress(done, total)` is called before the first and after each; `workers` processes (by
    default one per core) share the work.
    """
    rolled: dict[Job, RolloutSummary] = {}
    _remove_halves(jobs)
    progress(0, len(jobs))
    # What is there is given back at once where the caller ends before all is done.
    with closing(_each(_roll_out, jobs, workers, reference)) as done:
        for k, what in done:
            rolled[jobs[k]] = what
            progress(len(rolled), len(jobs))
    return {job: rolled[job] for job in jobs}


def make(jobs: list[Job], workers: int | None, progress: Progress) -> None:
    """Make all rollouts that are missing, as `roll_out` does, and leave it at that."""
    _remove_halves(jobs)
    progress(0, len(jobs))
    with closing(_each(_make, jobs, workers)) as each:
        for done, _ in enumerate(each, 1):
            progress(done, len(jobs))


def _each(
    function: Callable[..., Result], jobs: list[Job], workers: int | None, *common: object
) -> Generator[tuple[int, Result], None, None]:
    return call_each(
        function,
        [(job,) for job in jobs],
        checked_workers(workers),
        common=common,
        name=str,
    )


def _remove_halves(jobs: list[Job]) -> None:
    """Remove what a run that was killed was about to rename."""
    for folder in {job.path.parent for job in jobs}:
        for half in folder.glob(".*-*.parquet"):
            half.unlink(missing_ok=True)


def _make(job: Job) -> None:
    _made(job)


def _roll_out(job: Job, reference: Reference) -> RolloutSummary:
    return RolloutSummary.of_crowd(_made(job), reference)


def _made(job: Job) -> Trajectories:
    """The rollout, from its file if that is of this job, else made and written there."""
    provenance = {
        "spawn": job.spawn,
        "policy": job.policy,
        "part": job.part,
        "fit": job.fit,
        "seed": job.seed,
        "made_from": job.fingerprint,
    }
    crowd = None
    if job.path.exists():
        try:
            crowd = read_own(job.path)
        except RecordingError:  # another program's file: it is written anew
            crowd = None
    if crowd is None or dict(crowd.provenance) != provenance:
        with _named(job):
            scene, spawn, policy = _models(job)
            # Rollouts of different parts must not share their random numbers.
            seed = job.seed * len(PARTS) + PARTS.index(job.part)
            crowd = replace(rollout(scene, spawn, policy, seed=seed), provenance=provenance)
        write_parquet(crowd, job.path)
    return crowd


@contextmanager
def _named(job: Job) -> Iterator[None]:
    """Tell of an error in a class of the user's own where it was, and in which rollout.

    Raises:
        OwnCodeError: the class raised something that is no error of crowdbench's.
    """
    registered = [name for _, name in _foreign(split(job.spawn)[0], job.policy)]
    own = [f"{what} {name}" for what, name in (("policy", job.policy), ("spawn model", job.spawn))
           if ":" in name or name in registered]  # fmt: skip
    try:
        yield
    except Stopped:
        raise
    except CrowdbenchError as error:
        if not own:
            raise
        where = f"{error.where}, {job}"
        raise type(error)(where, got=error.got, expected=error.expected, hint=error.hint) from error
    except (Exception, SystemExit) as error:
        if not own:
            raise
        raise OwnCodeError(
            f"{' or '.join(own)}, {job}",
            got=told(error),
            expected="no error",
            hint="Mend the class and start again: rollouts of other models are kept.",
        ) from error


def _models(job: Job):  # type: ignore[no-untyped-def]  # what _cached_models returns
    return _cached_models(job.scene, job.spawn, job.policy, job.part, job.fit, job.fingerprint)


@functools.lru_cache(maxsize=8)  # jobs of one pair follow each other; a recording is read once
def _cached_models(  # type: ignore[no-untyped-def]
    scene: str, spawn: str, policy: str, part: str, fit: int, fingerprint: str
):
    place = load_scene(scene)
    return place, spawn_model(spawn, place, part=part, fit=fit), find_policy(policy, place, part)


def _fingerprint(scene: Scene, spawn: str, policy: str, part: str) -> str:
    """Hash of what a rollout depends on: our code, the scene's files, the recording, the scenario,
    the files of a spawn model's fits and of a policy, own classes.

    Of an own class these are all files in the folder of its module: weights lie beside the code.
    """
    files: list[Path] = []
    base, scenario = split(spawn)
    if base in ("replay", "block-replay") and cached(scene.recording.name).exists():
        files.append(cached(scene.recording.name))
    named = (scenario, weights_file(base), policy_file(policy, scene, part))
    files += [file for file in named if file]
    registered = b""
    for kind, name in _foreign(base, policy):
        code = plugins.code_of(plugins.part(kind, name))
        if isinstance(code, bytes):
            registered += code
        else:
            files += code
    for name in (base, policy):
        module, colon, _ = name.partition(":")
        found = importlib.util.find_spec(module) if colon else None
        if found is not None and found.origin is not None:
            files += _plain_files(Path(found.origin).parent)
    what = f"{spawn} {policy}" + (f" {sha256(registered)}" if registered else "")
    return fingerprint(scene, what, files)


def _foreign(spawn: str, policy: str) -> list[tuple[plugins.Kind, str]]:
    """Those of a spawn model and a policy that another package or program has registered."""
    each: tuple[tuple[plugins.Kind, str], ...] = (("spawn_models", spawn), ("policies", policy))
    ours = (*SPAWN_MODELS, *POLICIES)
    return [(kind, name) for kind, name in each if name not in ours and name in plugins.names(kind)]


def fingerprint(scene: Scene, what: str, more: Sequence[Path] = ()) -> str:
    """Hash of what the rollout `what` depends on: the code that makes rollouts, the scene's files,
    and more files.
    """
    package = Path(__file__).parents[1]
    files = [file for name in MAKES_ROLLOUTS for file in sorted(package.glob(name))]
    files += [*_plain_files(scene.folder, without="anchors.json"), *more]
    parts = [f"{__version__} {scene.id} {what}".encode()]
    return sha256(b"".join([*parts, *(_hash_of(f) for f in files)]))[:16]


def _plain_files(folder: Path, without: str = "") -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_file() and p.name != without)


def _hash_of(file: Path) -> bytes:
    stat = file.stat()
    if stat.st_size > _LARGE:
        return f"{file.name} {stat.st_size} {stat.st_mtime_ns}".encode()
    return sha256(file.read_bytes()).encode()


def _plain(name: str) -> str:
    plain = "".join(c if c.isalnum() or c in "-." else "-" for c in name)
    return plain if plain == name else f"{plain}-{sha256(name.encode())[:6]}"


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Refuse to work in a folder in which another evaluation is at work."""
    lock = out / ".lock"
    try:
        out.mkdir(parents=True, exist_ok=True)
        holder = int(lock.read_text() or 0) if lock.exists() else 0
    except OSError as error:
        raise unwritable(out, error) from error
    except ValueError:
        holder = 0
    if holder not in (0, os.getpid()) and _lives(holder):
        raise OutputError(
            out,
            got=f"a folder in which process {holder} evaluates",
            expected="a folder of one's own",
            hint=f"Wait for it, or name another folder; if there is none, remove {lock}.",
        )
    try:
        with leftovers.temporary(lock):
            try:
                lock.write_text(str(os.getpid()))
                yield
            finally:
                with suppress(OSError):
                    lock.unlink()
    except PermissionError as error:
        raise unwritable(out, error) from error


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
