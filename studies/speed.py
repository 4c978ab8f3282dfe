"""Measures the speed of crowdbench on this machine.

Other programs can only slow a measurement down, so most figures are the best of many short
measurements. Figures are comparable within one run, not between machines.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from crowdbench.data.blocks import SPLITS, TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.envs.parallel_env import CrowdParallelEnv
from crowdbench.metrics import WALK, metrics_for
from crowdbench.policies import Policy, SocialForce, Straight
from crowdbench.registry import fitted_models, has_recording, recording_of, spawn_model
from crowdbench.registry import policy as named_policy
from crowdbench.robot.vector_env import RobotVectorEnv
from crowdbench.run.judge import draws_of
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.scene_building.plan_calibration import adjustment
from crowdbench.scoring.energy import RESAMPLES, Energy, energy
from crowdbench.scoring.reference import Reference, read_reference, summarise
from crowdbench.scoring.score import Score, combined, ranks, score_of
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION
from crowdbench.spawn import SpawnEvents, SpawnModel, arrivals_of
from crowdbench.spawn.areas import Areas, read_areas
from crowdbench.spawn.events import blocks_of, joined
from crowdbench.spawn.model import Start
from crowdbench.spawn.plans.files import read_plans
from crowdbench.spawn.plans.fitting import fit_plans
from crowdbench.spawn.times.cox import CoxGMM
from studies.open_square import AtOnce, crowd_at_once, open_square, to_and_fro

CHUNK_S = 0.05
MEASURE_S = 2.0
ENTRIES = 10
LARGE_S: float | None = None
"""Length of the rollouts of Grand Central, seconds; None for that of the recording."""


@dataclass(frozen=True)
class Figure:
    """One measured number."""

    name: str
    value: float
    unit: str

    def text(self) -> str:
        """The value with its unit; from 10,000 on in millions (`M`)."""
        if self.value >= 1e4:
            return f"{self.value / 1e6:.3f} M {self.unit}"
        return f"{self.value:.3g} {self.unit}"


def measure() -> Iterator[Figure]:
    """Yield each figure as soon as it is measured."""
    for worlds, persons in ((1, 20), (1, 100), (1, 300), (64, 50)):
        name = f"core with observations, {worlds} × {persons}"
        yield Figure(name, _core(worlds, persons), "agent-steps/s")
    for worlds, persons in ((1, 100), (64, 50)):
        name = f"core with social-1, {worlds} × {persons}"
        yield Figure(name, _core(worlds, persons, "social-1"), "agent-steps/s")
    name = "core with observations and bodies, 64 × 50"
    yield Figure(name, _core(64, 50, body_radius_m=0.15), "agent-steps/s")
    for persons in (20, 100, 300):
        yield Figure(
            f"PettingZoo environment, {persons} agents", _pettingzoo(persons), "agent-steps/s"
        )
    yield Figure("robots, 256 × 20 people", _robots(256), "robot-steps/s")
    yield from _torchrl(64, 50)
    yield from _training()
    scene = load_scene("eth-v0")
    for name in fitted_models(scene):
        spawn = spawn_model(name, scene)
        yield Figure(
            f"{name}, sampling 10,000 frames of ETH", _least_s(_sampling(spawn, scene)), "s"
        )
    yield from _fitting()
    yield from _fitting_plans()
    spawn = spawn_model("poisson-gmm", scene)
    for policy in (Straight(), SocialForce()):
        yield Figure(
            f"rollout of ETH, {policy.name}", _least_s(_rolling(scene, spawn, policy)), "s"
        )
    reference = read_reference(scene)
    crowds = [rollout(scene, spawn, Straight(), seed=k) for k in range(20)]
    yield Figure(
        "scoring 20 rollouts of ETH, all metrics", _once_s(_scoring(reference, crowds)), "s"
    )
    yield Figure(
        "intervals and ranks of 10 entries on ETH",
        _once_s(_ranking(scene, reference, crowds, entries=ENTRIES)),
        "s",
    )
    yield from _large()
    yield Figure("import crowdbench", min(_import_s() for _ in range(5)), "s")


def _large() -> Iterator[Figure]:
    """Figures of Grand Central at full length, 10,000 frames with 12,700 persons; measured once."""
    scene = load_scene("gc-v0")
    for name in ("poisson-gmm", "ntpp-gmm", "cox-plans"):
        spawn = spawn_model(name, scene)
        yield Figure(
            f"{name}, sampling 10,000 frames of GC", _least_s(_sampling(spawn, scene)), "s"
        )
    crowds = []
    policies: list[Policy] = [Straight(), SocialForce()]
    if find_spec("onnx") and find_spec("onnxruntime"):
        policies += [named_policy(name, scene) for name in ("gail", "anticipate")]
    for policy in policies:
        rollout(scene, spawn, policy, seed=0, horizon_s=4.0, start="empty")  # compiles
        began = time.perf_counter()
        crowds.append(rollout(scene, spawn, policy, seed=0, horizon_s=LARGE_S))
        yield Figure(f"rollout of GC, {policy.name}", time.perf_counter() - began, "s")
    reference = read_reference(scene)
    reference.score(rollout(scene, spawn, Straight(), seed=0, horizon_s=40.0))  # compiles
    took_s = _once_s(_scoring(reference, crowds[1:2]))
    yield Figure("scoring a rollout of GC, all metrics", took_s, "s")
    yield from _viewing(scene, crowds[1])


def _viewing(scene: Scene, crowd: Trajectories) -> Iterator[Figure]:
    """Figures of writing a viewer file; none without rerun or the recording."""
    if find_spec("rerun") is None or not has_recording(scene):
        return
    from crowdbench.viewer import save

    recording = recording_of(scene)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "crowd.rrd"
        took_s = _once_s(partial(save, crowd, scene, path, against=recording))
        yield Figure("viewer file of GC with its recording", took_s, "s")
        yield Figure("size of that viewer file", path.stat().st_size / 1e6, "MB")


def _core(
    worlds: int, persons: int, observation: str = OBSERVATION, body_radius_m: float = 0.0
) -> float:
    scene = open_square(persons, body_radius_m)
    settings = Settings(max_alive=persons, observation=observation)
    simulation = Simulation(scene, worlds=worlds, settings=settings)
    events = [crowd_at_once(scene, persons, world) for world in range(worlds)]
    simulation.reset(events, horizon=10**9)
    actions = to_and_fro((worlds, persons, 2))

    def chunk() -> int:
        steps = 0
        for action in actions:
            # In the world frame, because people turn round when they walk back.
            simulation.step(action, own_frame=False)
            simulation.observe()
            steps += int(simulation.slots.alive.sum())
        return steps

    return _best_rate(chunk)


def _pettingzoo(persons: int) -> float:
    env = CrowdParallelEnv(
        open_square(persons),
        spawn=AtOnce(persons),
        horizon_s=1e8,
        max_alive=persons,
        max_persons=persons,
    )
    actions = to_and_fro((persons, 2))

    def chunk() -> int:
        env.reset(seed=0)
        steps = 0
        for action in actions * 25:
            env.step(dict(zip(env.agents, action, strict=False)))
            steps += len(env.agents)
        return steps

    return _best_rate(chunk)


class _Busy:
    """Four crowds of a scene at once: on ETH, 20 people at a time."""

    name = "busy"
    start: ClassVar[Start] = "stationary"

    def __init__(self, scene: Scene) -> None:
        self._model = spawn_model("poisson-gmm", scene)

    def sample(self, horizon_s: float, scene: Scene, rng: np.random.Generator) -> SpawnEvents:
        return joined([self._model.sample(horizon_s, scene, rng) for _ in range(4)])


def _robots(worlds: int) -> float:
    """Robots among straight walkers, with `social` observations and random actions."""
    scene = load_scene("eth-v0")
    env = RobotVectorEnv(scene, worlds, walkers="straight", spawn=_Busy(scene), collision="count")
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (4, worlds, 2)).astype(np.float32)

    def chunk() -> int:
        for action in actions:
            env.step(action)
        return actions.shape[0] * worlds

    return _best_rate(chunk)


def _torchrl(worlds: int, persons: int) -> Iterator[Figure]:
    """Figures of TorchRL's collector, with a random policy and a network; none without TorchRL."""
    if find_spec("torchrl") is None:
        return
    from tensordict.nn import TensorDictModule
    from torch import nn
    from torchrl.collectors import Collector

    from crowdbench.envs.torchrl_env import CrowdEnv

    where = f"TorchRL collector, {worlds} × {persons}"
    layers = (nn.LazyLinear(32), nn.Tanh(), nn.Linear(32, 32), nn.Tanh(), nn.Linear(32, 2))
    network = TensorDictModule(
        nn.Sequential(*layers, nn.Tanh()), [("agents", "observation")], [("agents", "action")]
    )
    for what, policy in (("random", None), ("MLP 32-32", network)):
        env = CrowdEnv(
            open_square(persons),
            spawn=AtOnce(persons),
            worlds=worlds,
            max_alive=persons,
            horizon_s=1e8,
            seed=0,
        )
        collector = Collector(
            env,
            policy,
            frames_per_batch=10 * worlds,
            total_frames=-1,
            auto_register_policy_transforms=False,
        )
        batches = iter(collector)

        def chunk(batches: Iterator[Any] = batches) -> int:
            return int(next(batches)["agents", "mask"].sum())

        yield Figure(f"{where}, {what}", _best_rate(chunk), "agent-steps/s")
        collector.shutdown()


def _training() -> Iterator[Figure]:
    """Figure of training with `crowdbench.baselines.ppo` on the plaza; none without its packages.

    What counts is the whole time of an iteration: collecting a batch, beginning episodes included,
    and all epochs of learning from it.
    """
    if find_spec("torchrl") is None:
        return
    import torch

    from crowdbench.baselines.command import use_one_thread
    from crowdbench.baselines.ppo import PpoSettings, train

    threads = torch.get_num_threads()
    use_one_thread()  # as the command does
    settings = PpoSettings()
    scene = load_scene("plaza-v0")
    rounds = train(scene.id, settings)
    batches = round(scene.frames(settings.horizon_s) * settings.worlds / settings.batch_frames)
    rate = _best_rate(lambda: sum(next(rounds).steps for _ in range(batches)))  # of an episode
    rounds.close()
    torch.set_num_threads(threads)
    name = f"PPO on {scene.id}, {settings.worlds} worlds, MLP 64-64"
    yield Figure(name, rate, "agent-steps/s")


def _rolling(scene: Scene, spawn: SpawnModel, policy: Policy) -> Callable[[], object]:
    return lambda: rollout(scene, spawn, policy, seed=0)


def _sampling(spawn: SpawnModel, scene: Scene) -> Callable[[], object]:
    rng = np.random.default_rng(0)
    return lambda: spawn.sample(10_000 * scene.dt_s, scene, rng)


def _fitting() -> Iterator[Figure]:
    """Figures of one ntpp-gmm fit to each imported recording; none without torch."""
    if find_spec("torch") is None:
        return
    from crowdbench.spawn.ntpp import training as ntpp_training

    for scene in map(load_scene, ("eth-v0", "plaza-v0", "gc-v0")):
        if not has_recording(scene):
            continue
        crowd, areas = recording_of(scene), read_areas(scene)
        arrivals = arrivals_of(crowd, blocks_of(crowd, scene), len(areas.spawn))
        took_s = _once_s(partial(ntpp_training.fit, arrivals, areas, scene, seed=0))
        yield Figure(f"ntpp-gmm, one fit to {scene.id}", took_s, "s")


def _fitting_plans() -> Iterator[Figure]:
    """Figures of a fit of waves, companions, ways and stops to each large recording."""
    for scene in map(load_scene, ("plaza-v0", "gc-v0")):
        if not has_recording(scene):
            continue
        crowd, areas = recording_of(scene), read_areas(scene)
        blocks = blocks_of(crowd, scene)
        arrivals = arrivals_of(crowd, blocks, len(areas.spawn))
        for name, fit in (
            ("cox-gmm", partial(CoxGMM.fit, arrivals, areas)),
            ("plans", partial(fit_plans, crowd, blocks, areas)),
            ("plans adjusted to cox-gmm", partial(_adjust_plans, crowd, blocks, areas, scene)),
        ):
            yield Figure(f"{name}, one fit to {scene.id}", _once_s(fit), "s")


def _adjust_plans(crowd: Trajectories, blocks: TimeBlocks, areas: Areas, scene: Scene) -> None:
    plans = read_plans(scene, areas, SPLITS[0])
    model: Any = CoxGMM.read(scene, areas)
    adjustment(model, plans, crowd, blocks, scene)


def _scoring(reference: Reference, crowds: list[Trajectories]) -> Callable[[], object]:
    return lambda: [reference.score(crowd) for crowd in crowds]


def _ranking(
    scene: Scene, reference: Reference, crowds: list[Trajectories], *, entries: int
) -> Callable[[], object]:
    """A function that computes energy scores with resamples, scores and ranks of `entries`."""
    fits, each = scene.protocol.fits, scene.protocol.rollouts_per_fit
    statistics = [summarise(c, reference.blocks, reference.place) for c in crowds]
    draws = draws_of(scene, reference, "full")
    metrics = [m for m in metrics_for(reference.blocks) if m.family not in WALK]

    def scores(entry: int) -> Score:
        chosen = np.random.default_rng(entry).integers(len(crowds), size=(fits, each))
        found = []
        for m in metrics:
            groups = [[statistics[k][m.name] for k in fit] for fit in chosen]
            es = energy(m, reference.statistics[m.name], groups, reference.blocks, draws)
            if es is not None:
                found.append(score_of(es, Energy(0.0, np.zeros(RESAMPLES)), es))
        together = combined([s for s in found if s is not None])
        assert together is not None
        return together

    return lambda: ranks([scores(entry) for entry in range(entries)])


def _once_s(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def _best_rate(chunk: Callable[[], int]) -> float:
    """Highest number of steps per second over chunks of work, after a first one that compiles."""
    chunk()
    best, until = 0.0, time.perf_counter() + MEASURE_S
    while time.perf_counter() < until:
        began = time.perf_counter()
        steps = 0
        while time.perf_counter() - began < CHUNK_S:
            steps += chunk()
        best = max(best, steps / (time.perf_counter() - began))
    return best


def _least_s(work: Callable[[], object]) -> float:
    work()
    least, until = float("inf"), time.perf_counter() + MEASURE_S
    while time.perf_counter() < until:
        began = time.perf_counter()
        work()
        least = min(least, time.perf_counter() - began)
    return least


def _import_s() -> float:
    code = "import time; t = time.perf_counter(); import crowdbench; print(time.perf_counter() - t)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)
