"""`evaluate`: roll out spawn models and policies on a scene and compare with its recording.

Every rollout is a job of its own, written as Parquet; the scorecard is computed from the files
in a fixed order. It holds nothing that depends on the machine, the time or the number of
workers: the same seeds give the same bytes.
"""

import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from crowdbench import __version__
from crowdbench.errors import RecordingError, SettingError
from crowdbench.figures import FIGURES, draw_figures
from crowdbench.files import read_struct, unwritable, write_json
from crowdbench.reference import Reference, read_reference
from crowdbench.registry import policy as find_policy
from crowdbench.registry import spawn_model
from crowdbench.rollouts import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.tables import read_own, write_parquet
from crowdbench.trajectories import OUTCOMES, Trajectories

SCHEMA = 1
DEFAULT_SEEDS = 6


class MetricSummary(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One metric of one crowd, over its rollouts."""

    distance: float
    """Mean over the rollouts."""
    distances: list[float]
    """Each rollout's, by seed."""
    recorded: float
    simulated: float
    """Mean over the rollouts, in `unit`."""
    unit: str
    n: int
    """Sample size of all rollouts together."""


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A spawn model with a policy."""

    spawn: str
    policy: str
    seeds: list[int]
    persons: int
    """In all rollouts together."""
    outcomes: dict[str, int]
    """How their lives ended."""
    metrics: dict[str, MetricSummary]


class Scorecard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What `scorecard.json` holds."""

    schema: int
    crowdbench: str
    scene: str
    protocol: str
    horizon_s: float
    blocks: int
    entries: list[Entry]


def read_scorecard(path: Path) -> Scorecard:
    """Read a `scorecard.json`.

    Raises:
        RecordingError: the file is missing or broken, or of another schema version.
    """
    mend = "Run `crowdbench evaluate` again."
    card = read_struct(path, Scorecard, RecordingError, mend)
    if card.schema != SCHEMA:
        raise RecordingError(
            path, got=f"schema {card.schema}", expected=f"schema {SCHEMA}", mend=mend
        )
    return card


@dataclass(frozen=True)
class Job:
    """One rollout to make."""

    scene: str
    spawn: str
    policy: str
    seed: int
    path: Path


def evaluate(
    scene: str | Path,
    *,
    spawn: Sequence[str] = ("poisson-gmm",),
    policy: Sequence[str] = ("straight", "social-force", "random"),
    seeds: int = DEFAULT_SEEDS,
    workers: int | None = None,
    out: Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Scorecard:
    """Evaluate each spawn model with each policy on a scene, `seeds` rollouts each.

    Writes `scorecard.json`, `run.json`, `rollouts/*.parquet` and the figures into `out`;
    `progress(done, total)` is called before the first and after each rollout. `workers`
    processes (by default one per core) share the work. The policy `replay` walks recorded
    arrivals only and is left out elsewhere; with them it leaves nothing to chance, so that
    pair has one rollout.

    Raises:
        SceneError, WeightsError, RecordingError, SettingError: what was asked for does not
            exist or does not fit; checked before the first rollout.
        OutputError: `out` cannot be written.
    """
    began = time.time()
    place = load_scene(scene)
    reference = read_reference(place)
    jobs = _plan(str(scene), place, spawn, policy, seeds, out)
    for job in {(job.spawn, job.policy): job for job in jobs}.values():
        spawn_model(job.spawn, place)
        find_policy(job.policy, place)
    workers = _workers(workers, len(jobs))
    _clear(out)
    progress(0, len(jobs))
    for done, _ in enumerate(_run(jobs, workers), start=1):
        progress(done, len(jobs))
    crowds = {(job.spawn, job.policy, job.seed): read_own(job.path) for job in jobs}
    card = _scorecard(place, reference, crowds)
    write_json(out / "scorecard.json", card)
    draw_figures(place, reference, crowds, out)
    write_json(
        out / "run.json",
        {
            "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(began)),
            "took_s": round(time.time() - began, 1),
            "workers": workers,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "machine": platform.platform(),
        },
    )
    return card


def _clear(out: Path) -> None:
    """Make the folder, without an earlier run's results, which would stand beside new rollouts."""
    try:
        (out / "rollouts").mkdir(parents=True, exist_ok=True)
        for name in ("scorecard.json", "run.json", *FIGURES):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error


def _plan(
    scene: str, place: Scene, spawn: Sequence[str], policy: Sequence[str], seeds: int, out: Path
) -> list[Job]:
    if seeds < 1:
        raise SettingError("seeds", got=str(seeds), expected="1 or more")
    jobs = []
    for s in dict.fromkeys(spawn):
        for p in dict.fromkeys(policy):
            if p == "replay" and s != "replay":
                continue
            for seed in range(1 if s == p == "replay" else seeds):
                name = f"{_plain(s)}_{_plain(p)}_{seed}.parquet"
                jobs.append(Job(scene, s, p, seed, out / "rollouts" / name))
    if not jobs:
        raise SettingError(
            f"evaluation of {place.id}",
            got=f"spawn {', '.join(spawn)} with policy {', '.join(policy)}",
            expected="a pair that can walk: the policy replay needs the spawn model replay",
        )
    return jobs


def _plain(name: str) -> str:
    return "".join(c if c.isalnum() or c in "-." else "-" for c in name)


def _workers(asked: int | None, jobs: int) -> int:
    if asked is not None and asked < 1:
        raise SettingError("workers", got=str(asked), expected="1 or more")
    return min(asked or os.cpu_count() or 1, jobs)


def _run(jobs: list[Job], workers: int) -> Iterator[None]:
    if workers == 1:
        yield from map(_roll_out, jobs)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky import get_reusable_executor

    # joblib's own processes are started afresh, not forked: forking after OpenMP has run hangs.
    parallel = Parallel(n_jobs=workers, return_as="generator_unordered", pre_dispatch=workers)
    try:
        yield from parallel(delayed(_alone)(job) for job in jobs)
    finally:
        # Left alone, the processes would serve the next call too, in this one's surroundings.
        get_reusable_executor().shutdown(kill_workers=True)


def _alone(job: Job) -> None:
    """Roll out on one thread: the processes already fill the machine."""
    import numba

    numba.set_num_threads(1)
    _roll_out(job)


def _roll_out(job: Job) -> None:
    scene = load_scene(job.scene)
    spawn, policy = spawn_model(job.spawn, scene), find_policy(job.policy, scene)
    write_parquet(rollout(scene, spawn, policy, seed=job.seed), job.path)


def _scorecard(
    scene: Scene, reference: Reference, crowds: dict[tuple[str, str, int], Trajectories]
) -> Scorecard:
    pairs = list(dict.fromkeys((spawn, policy) for spawn, policy, _ in crowds))
    entries = []
    for spawn, policy in pairs:
        of_pair = {key[2]: crowd for key, crowd in crowds.items() if key[:2] == (spawn, policy)}
        results = [reference.score(crowd) for crowd in of_pair.values()]
        metrics = {}
        for name in results[0]:
            each = [result[name] for result in results]
            metrics[name] = MetricSummary(
                distance=float(np.mean([r.distance for r in each])),
                distances=[r.distance for r in each],
                recorded=each[0].recorded,
                simulated=float(np.mean([r.simulated for r in each])),
                unit=each[0].unit,
                n=sum(r.n for r in each),
            )
        ended = np.bincount(
            np.concatenate([crowd.outcome for crowd in of_pair.values()]), minlength=len(OUTCOMES)
        )
        entries.append(
            Entry(
                spawn=spawn,
                policy=policy,
                seeds=list(of_pair),
                persons=int(ended.sum()),
                outcomes={n: int(c) for n, c in zip(OUTCOMES, ended, strict=True) if c},
                metrics=metrics,
            )
        )
    return Scorecard(
        schema=SCHEMA,
        crowdbench=__version__,
        scene=scene.id,
        protocol="full",
        horizon_s=scene.horizon_s,
        blocks=len(reference.blocks),
        entries=entries,
    )
