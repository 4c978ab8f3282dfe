"""Worlds on a CUDA device, or in numba's simulator of one, beside the same worlds on the CPU.

`python tests/cuda_worlds.py` prints the largest differences for each kind of world.
"""

import os
from dataclasses import replace

import numpy as np
from crowds_of_kernels import BLOCKS, SIZES, actions, people
from msgspec import structs

from crowdbench.simulation import Settings, Simulation, cuda
from crowdbench.simulation.cuda import CudaSimulation, cuda_module
from crowdbench.simulation.reward import Reward, Rewarder

KINDS = (
    ("lidar-2", 0.0, False),
    ("lidar-3", 0.15, True),
    ("social-1", 0.0, True),
    ("social-1", 0.15, False),
    ("social-1", 0.15, True),
)
"""Observation, radius of bodies in metres, and whether somebody is wider than a person."""
FRAMES = 30
SEEDS = (1, 2)


def difference(observation: str, body_radius_m: float, *, wide: bool = False) -> dict[str, float]:
    """The largest difference of each array between the CPU and the device, over all steps."""
    scene = replace(BLOCKS, motion=structs.replace(BLOCKS.motion, body_radius_m=body_radius_m))
    settings: Settings = replace(SIZES, observation=observation)
    cpu = Simulation(scene, worlds=len(SEEDS), settings=settings)
    cpu.reset([people(seed) for seed in SEEDS], horizon=FRAMES - 5)
    cpu.observe()
    rewarder, found = Rewarder(Reward()), dict[str, float]()
    device = CudaSimulation(cpu)
    for number in range(FRAMES):
        if wide and number == 3:  # a robot enters
            cpu.slots.wider[:, 0] = 0.2
            device.slots.wider.copy_to_device(cpu.slots.wider)
        act = actions(cpu, SEEDS, number)
        device.step(cuda_module().to_device(act))
        device.observe()
        device.pay()
        cpu.step(act)
        cpu.observe()
        there = cpu.slots.alive | (cpu.slots.ended != 0)
        pairs = {
            **{f"slots.{n}": (a, getattr(device.slots, n)) for n, a in cpu.slots._asdict().items()},
            **{f"clock.{n}": (a, getattr(device.clock, n)) for n, a in cpu.clock._asdict().items()},
            "queue.status": (cpu.queue.status, device.queue.status),
            "reward": (rewarder(cpu), device.reward_parts),
            **{
                name: (getattr(cpu, name)[there], getattr(device, name).copy_to_host()[there])
                for name in ("observation", "nearest", "remaining", "towards")
            },
        }
        for name, (here, away) in pairs.items():
            other = away if isinstance(away, np.ndarray) else away.copy_to_host()
            same = (here == other) | ((here != here) & (other != other))
            if not same.all():
                off = np.abs(here.astype(np.float64) - other.astype(np.float64))[~same]
                found[name] = max(found.get(name, 0.0), float(off.max()))
    return found


def main() -> None:
    """Compare and print."""
    for observation, body_radius_m, wide in KINDS:
        found = difference(observation, body_radius_m, wide=wide)
        what = f"{observation}, bodies of {body_radius_m} m{', a robot' if wide else ''}"
        print(f"{what}: {found or 'the same bytes'}", flush=True)


if __name__ == "__main__":
    if os.environ.get("NUMBA_ENABLE_CUDASIM") == "1":
        # Threads of the simulator are those of the operating system. Fewer than slots are enough.
        cuda.THREADS, cuda.MOST_THREADS = 16, 3
    main()
