"""The compiled kernels do what their source says, on any number of threads and worlds."""

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from crowds_of_kernels import BLOCKS, SIZES, actions, people
from msgspec import structs

from crowdbench.compilation import PARALLEL_FROM
from crowdbench.policies import SocialForce, SpeedModel, StateView
from crowdbench.simulation import Simulation

FRAMES = 60
MANY = 24  # worlds


def history(
    *seeds: int, observation: str = "lidar-2", body_radius_m: float = 0.0
) -> list[list[bytes]]:
    """Every array of every world after each step, as bytes."""
    settings = replace(SIZES, observation=observation)
    motion = structs.replace(BLOCKS.motion, body_radius_m=body_radius_m)
    scene = replace(BLOCKS, motion=motion)
    simulation = Simulation(scene, worlds=len(seeds), settings=settings)
    simulation.reset([people(seed) for seed in seeds], horizon=FRAMES)
    worlds: list[list[bytes]] = [[] for _ in seeds]
    for number in range(FRAMES):
        observation = simulation.observe()
        slots = simulation.slots
        there = slots.alive | (slots.ended != 0)
        for w in range(len(seeds)):
            arrays = [*slots, *simulation.clock, np.where(there[..., None], observation, 0)]
            worlds[w].append(b"".join(array[w].tobytes() for array in arrays))
        simulation.step(actions(simulation, seeds, number))
    return worlds


def walkers() -> bytes:
    """Actions of a small crowd by both policies with kernels of their own."""
    simulation = Simulation(BLOCKS, worlds=2, settings=SIZES)
    simulation.reset([people(1), people(2)], horizon=FRAMES)
    seen, acted = StateView.of(simulation), b""
    for policy in (SocialForce(), SpeedModel()):
        policy.reset(BLOCKS, np.random.default_rng(0))
        acted += policy.act(seen).tobytes()
    return acted


def digest(worlds: int) -> str:
    """Of histories with both kernels of observations, with and without bodies, and of forces."""
    seeds = range(1, worlds + 1)
    worlds_of = [
        history(*seeds, observation="lidar-2"),
        history(*seeds, observation="social-1", body_radius_m=0.15),
    ]
    states = [state for of_one in worlds_of for world in of_one for state in world]
    return hashlib.sha256(b"".join(states) + walkers()).hexdigest()


SHARED = os.pathsep.join(map(str, Path(__file__).parents[:2]))
"""Where other processes find this module and what tests share."""


def digest_elsewhere(worlds: int, **environment: str) -> str:
    """The digest as another process computes it."""
    done = subprocess.run(
        [sys.executable, "-c", f"import test_kernels; print(test_kernels.digest({worlds}))"],
        env={**os.environ, "PYTHONPATH": SHARED, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_crowd_of_these_tests_meets_every_rule() -> None:
    simulation = Simulation(BLOCKS, settings=SIZES)
    simulation.reset([people(1)], horizon=FRAMES)
    outcomes, hits = set(), 0
    for number in range(FRAMES):
        simulation.step(actions(simulation, (1,), number))
        outcomes |= set(simulation.slots.ended.ravel().tolist())
        hits += int(simulation.slots.hit_wall.sum())
    waited = simulation.waited(0, simulation.slots.event[0], simulation.slots.born[0])
    assert hits > 0
    assert waited.max() > 0 or simulation.clock.no_slot[0] > 0
    assert outcomes == {0, 1, 2, 3, 4, 5}


def test_compiled_kernels_do_the_same_as_their_source() -> None:
    assert digest_elsewhere(2, NUMBA_DISABLE_JIT="1") == digest(2)


def test_many_worlds_are_many_enough_for_several_threads() -> None:
    simulation = Simulation(BLOCKS, worlds=MANY, settings=SIZES)
    simulation.reset([people(seed) for seed in range(MANY)], horizon=FRAMES)
    most = 0
    for number in range(FRAMES):
        simulation.step(actions(simulation, tuple(range(MANY)), number))
        most = max(most, int(simulation.slots.alive.sum()))
    assert most >= PARALLEL_FROM


@pytest.mark.long
def test_the_number_of_threads_changes_no_byte() -> None:
    one, four = (digest_elsewhere(MANY, NUMBA_NUM_THREADS=threads) for threads in "14")
    assert one == four


FIRST = {
    "nothing": "",
    "torch": "import torch; torch.rand(100_000).exp().sum()",
    "sklearn": "import sklearn.cluster",
    "numba": (
        "import numba, numpy as np\n"
        "@numba.njit(parallel=True)\n"
        "def f(x):\n"
        "    for i in numba.prange(len(x)):\n"
        "        x[i] += 1\n"
        "f(np.zeros(10))"
    ),
}


def compiled_elsewhere(first: str, **environment: str) -> list[str]:
    """Names of the kernels that many worlds are stepped by, without and with environment."""
    code = (
        f"{first}\nimport os\nbefore = dict(os.environ)\n"
        "from crowdbench import compilation\n"
        "original, names = compilation._dispatcher, set()\n"
        "def noted(*of):\n"
        "    names.add(original(*of).py_func.__name__)\n"
        "    return original(*of)\n"
        "compilation._dispatcher = noted\n"
        "import test_kernels\n"
        "test_kernels.history(*range(1, test_kernels.MANY + 1))\n"
        "assert dict(os.environ) == before\n"
        "print(*sorted(names))"
    )
    plain = {k: v for k, v in os.environ.items() if k != "NUMBA_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**plain, "PYTHONPATH": SHARED, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.long
@pytest.mark.parametrize("first", FIRST)
def test_kernels_run_on_one_thread_whatever_was_imported_before(first: str) -> None:
    # What runs on one thread waits for no other, and nothing of the user's has to be changed.
    names = compiled_elsewhere(FIRST[first], OMP_NUM_THREADS="2")
    assert names
    assert [name for name in names if not name.endswith("_alone")] == []


@pytest.mark.long
def test_kernels_run_on_several_threads_where_they_are_asked_for() -> None:
    names = compiled_elsewhere("", NUMBA_NUM_THREADS="2")
    assert any(name.endswith("_parallel") for name in names)


@pytest.mark.parametrize("observation", ["lidar-2", "social-1"])
def test_worlds_stepped_together_are_each_world_alone(observation: str) -> None:
    seeds = range(1, MANY + 1)
    alone = [history(seed, observation=observation)[0] for seed in seeds]
    assert history(*seeds, observation=observation) == alone


def test_worlds_of_other_seeds_differ() -> None:
    first, second = history(1, 2)
    assert first != second
