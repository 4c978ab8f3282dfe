"""Studies that train policies: `ablation`, `across`, `compare-observations` and others."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from crowdbench.cli.options import EngineName, SceneName, Workers
from crowdbench.run.processes import LOCAL


def ablation(
    scene: SceneName, /, *, out: Path | None = None, workers: Workers = None,
    engine: EngineName = LOCAL,
) -> None:  # fmt: skip
    """Print the page on what each part of `anticipate` contributes (hours).

    Args:
        out: output folder (default: results/ablation-SCENE)
    """
    from studies.ablation import write_ablation

    print(write_ablation(scene, out=out, workers=workers))


def across(
    scenes: Sequence[str] = (), /, *, out: Path | None = None, workers: Workers = None,
    engine: EngineName = LOCAL,
) -> None:  # fmt: skip
    """Print the page on how `anticipate` walks where it was not trained (hours).

    Args:
        scenes: scenes with one maximum speed (default: five)
        out: output folder
    """
    from studies.across import OUT, SCENES, write_across

    print(write_across(scenes or SCENES, out=out or OUT, workers=workers))


def compare_observations(
    scene: SceneName,
    /,
    *,
    spawn: str = "cox-plans",
    seeds: int = 3,
    frames: int = 640_000,
    out: Path = Path("results/observations"),
) -> None:
    """Train PPO with lidar-2 and social-1, and score both (hours).

    Args:
        spawn: spawn model
        seeds: number of trainings with each observation
        frames: frames of each training
        out: output folder
    """
    from studies.compare_observations import compare

    for line in compare(scene, spawn=spawn, seeds=seeds, frames=frames, out=out):
        print(line, flush=True)


def without_reward_parts(
    scene: SceneName, /, *, spawn: str = "cox-plans", frames: int = 640_000
) -> None:
    """Train PPO without each part of the reward (hours).

    Args:
        spawn: spawn model
        frames: frames of each training
    """
    from studies.without_reward_parts import rows

    for line in rows(scene, spawn=spawn, frames=frames):
        print(line, flush=True)


def runners(
    scene: SceneName,
    /,
    *,
    route: Literal["plain", "sb3"] = "plain",
    steps: int = 200_000,
    gamma: float = 0.99,
    seed: int = 0,
) -> None:
    """Check that PPO learns to walk with the default reward (minutes).

    Args:
        route: way of training
        steps: number of steps of single persons
        gamma: discount
        seed: random seed
    """
    from studies.runners import train_and_walk

    good = []
    for line, well in train_and_walk(scene, route, steps=steps, gamma=gamma, seed=seed):
        print(line, flush=True)
        good.append(well)
    if not all(good):
        raise SystemExit(1)


def training_speed(
    *,
    scene: SceneName = "gc-v0",
    seconds: float = 3.0,
    observation: str | None = None,
    spawn: str | None = None,
    device: str | None = None,
    horizon_s: float | None = None,
    worlds: int | None = None,
    max_alive: int | None = None,
    batch_frames: int | None = None,
    minibatch: int | None = None,
    collectors: int | None = None,
    hidden: int | None = None,
) -> None:
    """Measure how fast the parts of PPO's training are (a minute).

    The defaults are those of `crowdbench.baselines.ppo`.

    Args:
        seconds: time for each part
        observation: what persons see
        spawn: spawn model
        device: where the network learns
        horizon_s: length of an episode in seconds
        worlds: number of worlds
        max_alive: number of slots per world
        batch_frames: frames of a batch
        minibatch: frames of a minibatch
        collectors: processes that collect
        hidden: width of the hidden layers
    """
    given = {name: value for name, value in locals().items() if value is not None}
    from dataclasses import fields, replace

    from studies.training_speed import SETTINGS, measure

    names = {field.name for field in fields(SETTINGS)}
    asked = {name: value for name, value in given.items() if name in names}
    for line in measure(scene, replace(SETTINGS, **asked), seconds):
        print(line, flush=True)
