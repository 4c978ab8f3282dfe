"""Measures how fast `crowdbench.baselines.ppo` trains on this machine, and how long its parts take.

    NUMBA_NUM_THREADS=16 python tests/training_speed.py --device cuda --worlds 512 --max-alive 200

Every row counts steps of single persons per second: of the simulation alone, of the environment
with its copies, of collecting with a network, of learning, and of the whole loop. The last column
is the time per step as a share of that of the whole loop; each of the first three rows contains
those above it.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch

from crowdbench.baselines import ppo
from crowdbench.baselines.command import use_one_thread

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


def measured(scene: str, settings: ppo.Settings, seconds: float) -> Iterator[tuple[str, float]]:
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
        count = learn(self, batch, progress)  # type: ignore[arg-type]
        synchronize(device)
        took["learning"] += time.perf_counter() - began
        return count

    ppo.Learner.learn = timed  # type: ignore[method-assign]
    rounds = ppo.train(scene, settings)
    next(rounds), next(rounds)
    took["learning"], steps, began = 0.0, 0, time.perf_counter()
    while time.perf_counter() - began < 3 * seconds:
        steps += next(rounds).steps
    whole_s = time.perf_counter() - began
    rounds.close()
    ppo.Learner.learn = learn  # type: ignore[method-assign]
    yield "collecting with a network", steps / (whole_s - took["learning"])
    yield "learning", steps / took["learning"]
    yield WHOLE, steps / whole_s


def main() -> int:
    """Print a table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = ppo.Settings(spawn="cox-plans", observation="social-1", frames=10**12)
    parser.add_argument("--scene", default="gc-v0")
    parser.add_argument("--observation", default=default.observation)
    parser.add_argument("--spawn", default=default.spawn)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--horizon-s", type=float, default=default.horizon_s)
    parser.add_argument("--seconds", type=float, default=3.0)
    for name in ("worlds", "max_alive", "batch_frames", "minibatch", "collectors", "hidden"):
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=getattr(default, name))
    asked = vars(parser.parse_args())
    scene, seconds = asked.pop("scene"), asked.pop("seconds")
    use_one_thread()
    found = {}
    for name, speed in measured(scene, replace(default, **asked), seconds):
        print(f"  measured: {name}, {speed:,.0f} steps/s", flush=True)
        found[name] = speed
    for name, speed in found.items():
        print(f"{name:<30} {speed / 1e6:8.3f} M/s {found[WHOLE] / speed:6.0%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
