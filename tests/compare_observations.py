"""Does PPO walk better with `social-1` than with `lidar-2`? A check to run by hand.

    python tests/compare_observations.py --scene eth-v0 --out results/observations

trains `crowdbench.baselines.ppo` with each observation and several seeds on the whole recording,
under the same arrivals with stops and companions. It scores how the policies walk in the same time
blocks, under the recorded arrivals, which must be imported. Policies that exist in the folder are
not trained again; further options are those of `crowdbench.baselines.ppo`. The last lines have the
mean walk score of each observation.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from crowdbench import evaluate, load_scene
from crowdbench.baselines import ppo
from crowdbench.scoring.scorecard import Row, rows

OBSERVATIONS = ("lidar-2", "social-1")


def trained(scene: str, observation: str, seed: int, spawn: str, out: Path, more: list[str]) -> str:
    """Path of the policy, trained if it does not exist."""
    folder = out / f"{observation}-{seed}"
    path = folder / "full.onnx"
    if not path.exists():
        chosen = ["--scene", scene, "--observation", observation, "--spawn", spawn]
        code = ppo.main([*chosen, "--seed", str(seed), "--out", str(folder), *more])
        if code:
            sys.exit(code)
    return str(path)


def line(row: Row) -> str:
    """How one policy walks."""
    families = "  ".join(f"{name} {s.value:.2f}" for name, s in row.families.items())
    walk = "none" if row.walk is None else f"{row.walk.value:.2f}"
    fails = f"  fails {', '.join(row.fails)}" if row.fails else ""
    seen = f"{row.entry.speed_mps:.2f} m/s  {row.entry.at_goal:.1%} at goal"
    return f"walk {walk}  {families}  {seen}{fails}"


def main() -> None:
    """Train, evaluate and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="eth-v0")
    parser.add_argument("--spawn", default="cox-plans")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, required=True)
    args, more = parser.parse_known_args()
    paths = {
        trained(args.scene, observation, seed, args.spawn, args.out, more): (observation, seed)
        for observation in OBSERVATIONS
        for seed in range(args.seeds)
    }
    rollouts = 2 * load_scene(args.scene).protocol.fits  # the fewest that walk is scored with
    card = evaluate(
        args.scene, spawn="replay", policy=[*paths], seeds=rollouts, workers=1,
        out=args.out / "evaluation",
    )  # fmt: skip
    found: dict[str, list[float]] = {observation: [] for observation in OBSERVATIONS}
    for row in rows(card):
        if row.policy not in paths:
            continue
        observation, seed = paths[row.policy]
        print(f"{observation}, seed {seed}: {line(row)}")
        if row.walk is not None:
            found[observation].append(row.walk.value)
    if not all(found.values()):
        sys.exit("No walk scores: import the scene's recording, see docs/data.md.")
    for observation, walks in found.items():
        print(f"{observation}: mean walk {np.mean(walks):.3f}, each {np.round(walks, 3).tolist()}")


if __name__ == "__main__":
    main()
