"""How fast `crowdbench.baselines.ppo` trains on this machine, and how long its parts take.

    NUMBA_NUM_THREADS=16 python -m studies training-speed --device cuda --worlds 512 --max-alive 200

Every row counts steps of single persons per second: of the simulation alone, of the environment
with its copies, of collecting with a network, of learning, and of the whole loop. The last column
is the time per step as a share of that of the whole loop; each of the first three rows contains
those above it.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch

from crowdbench.baselines import ppo
from crowdbench.baselines.command import use_one_thread

SETTINGS = ppo.PpoSettings(spawn="cox-plans", observation="social-1", frames=10**12)
OPTIONS = ("worlds", "max_alive", "batch_frames", "minibatch", "collectors", "hidden")
"""Whole numbers among the settings that the command has options for."""
WHOLE = "whole loop"
CHUNK = 10
"""Number of frames between two looks at the clock."""


def synchronize(device: str) -> None:
    """Wait for what a GPU was asked to do."""
    if device.startswith("cuda"):
        torch.cuda.synchronize()


def rate(chunk: Callable[[], int], device: str, seconds: float) -> float:
    """Steps per second of `chunk`, which returns their number, after a first call."""
    chunk()
    synchronize(device)
    began, steps = time.perf_counter(), 0
    while time.perf_counter() - began < seconds:
        steps += chunk()
        synchronize(device)
    return steps / (time.perf_counter() - began)


def measured(scene: str, settings: ppo.PpoSettings, seconds: float) -> Iterator[tuple[str, float]]:
    """Names of parts and their steps of single persons per second."""
    device = settings.device
    env = ppo._environment(scene, replace(settings, collectors=1), None, "full", 0)
    now = env.reset()
    simulation = env._simulation
    ahead = np.full((settings.worlds, settings.max_alive, 2), (0.4, 0.0), np.float32)
    acted = torch.from_numpy(ahead).to(device)

    def anew() -> None:
        nonlocal now
        if simulation.clock.frame[0] + CHUNK > env.frames:
            now = env.reset()

    def core() -> int:
        anew()
        steps = 0
        for _ in range(CHUNK):
            steps += int(simulation.slots.alive.sum())
            simulation.step(ahead)
            simulation.observe()
        return steps

    def environment() -> int:
        nonlocal now
        anew()
        steps = 0
        for _ in range(CHUNK):
            steps += int(simulation.slots.alive.sum())
            now["agents", "action"] = acted
            now = env.step(now)["next"]
        return steps

    yield "simulation: step, observe", rate(core, device, seconds)
    if settings.collectors == 1:
        yield "environment: rewards, copies", rate(environment, device, seconds)

    took = {"collecting": 0.0, "learning": 0.0}
    learn = ppo.Learner.learn

    def timed(self: ppo.Learner, batch: object, progress: float) -> int:
        synchronize(device)
        began = time.perf_counter()
        count = learn(self, batch, progress)
        synchronize(device)
        took["learning"] += time.perf_counter() - began
        return count

    ppo.Learner.learn = timed
    rounds = ppo.train(scene, settings)
    next(rounds), next(rounds)
    took["learning"], steps, began = 0.0, 0, time.perf_counter()
    while time.perf_counter() - began < 3 * seconds:
        steps += next(rounds).steps
    whole_s = time.perf_counter() - began
    rounds.close()
    ppo.Learner.learn = learn
    yield "collecting with a network", steps / (whole_s - took["learning"])
    yield "learning", steps / took["learning"]
    yield WHOLE, steps / whole_s


def measure(scene: str, settings: ppo.PpoSettings, seconds: float) -> Iterator[str]:
    """Measure each part for `seconds`, the whole loop for three times as long; lines of a table."""
    use_one_thread()
    found = {}
    for name, speed in measured(scene, settings, seconds):
        yield f"  measured: {name}, {speed:,.0f} steps/s"
        found[name] = speed
    for name, speed in found.items():
        yield f"{name:<30} {speed / 1e6:8.3f} M/s {found[WHOLE] / speed:6.0%}"
