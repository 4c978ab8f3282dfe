"""Does PPO walk better with `social-1` than with `lidar-2`?

    python -m studies compare-observations eth-v0 --out results/observations

trains `crowdbench.baselines.ppo` with each observation and several seeds on the whole recording,
under the same arrivals with stops and companions. It scores how the policies walk in the same time
blocks, under the recorded arrivals, which must be imported. Policies that exist in the folder are
not trained again. The last lines have the mean walk score of each observation.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from crowdbench import evaluate, load_scene
from crowdbench.baselines import ppo
from crowdbench.registry import recording_of
from crowdbench.scoring.ranking import Row, rows

OBSERVATIONS = ("lidar-2", "social-1")


def trained(scene: str, observation: str, seed: int, spawn: str, frames: int, out: Path) -> str:
    """Path of the policy, trained if it does not exist."""
    folder = out / f"{observation}-{seed}"
    path = folder / "full.onnx"
    if not path.exists():
        chosen = ["--scene", scene, "--observation", observation, "--spawn", spawn]
        chosen += ["--seed", str(seed), "--frames", str(frames), "--out", str(folder)]
        if code := ppo.main(chosen):
            raise SystemExit(code)
    return str(path)


def line(row: Row) -> str:
    """How one policy walks."""
    families = "  ".join(f"{name} {s.value:.2f}" for name, s in row.families.items())
    walk = "none" if row.walk is None else f"{row.walk.value:.2f}"
    fails = f"  fails {', '.join(row.fails)}" if row.fails else ""
    seen = f"{row.entry.speed_mps:.2f} m/s  {row.entry.at_goal:.1%} at goal"
    return f"walk {walk}  {families}  {seen}{fails}"


def compare(scene: str, *, spawn: str, seeds: int, frames: int, out: Path) -> Iterator[str]:
    """Train and evaluate; lines on each policy, then on each observation.

    Raises:
        RecordingError: the recording is not imported.
    """
    place = load_scene(scene)
    recording_of(place)  # whether it is there is known before the trainings
    paths = {
        trained(scene, observation, seed, spawn, frames, out): (observation, seed)
        for observation in OBSERVATIONS
        for seed in range(seeds)
    }
    rollouts = 2 * place.protocol.fits  # the fewest that walk is scored with
    card = evaluate(
        scene, spawn="replay", policy=[*paths], seeds=rollouts, workers=1, out=out / "evaluation"
    )
    found: dict[str, list[float]] = {observation: [] for observation in OBSERVATIONS}
    for row in rows(card):
        if row.policy in paths:
            observation, seed = paths[row.policy]
            yield f"{observation}, seed {seed}: {line(row)}"
            if row.walk is not None:
                found[observation].append(row.walk.value)
    for observation, walks in found.items():
        each = np.round(walks, 3).tolist()
        yield f"{observation}: mean walk {np.mean(walks):.3f}, each {each}"
