"""`crowdbench spawn`: test a scene's spawn models, or write a sample of one of them."""

import argparse
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_note
from crowdbench.errors import SettingError

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.scene import Scene


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    spawn = commands.add_parser(
        "spawn",
        help="test a scene's spawn models, or write the arrivals of one of them",
    )
    spawn.add_argument("scene", help="id of a scene, or its folder")
    spawn.add_argument(
        "--sample",
        type=Path,
        metavar="FILE",
        help="write one sample of --model to a CSV or Parquet file, for other simulators",
    )
    spawn.add_argument(
        "--model",
        help="spawn model of --sample (default: ntpp-gmm)",
    )
    spawn.add_argument("--seed", type=int, help="random seed of --sample (default: 0)")
    spawn.add_argument(
        "--horizon-s",
        type=float,
        metavar="S",
        help="length of --sample in seconds (default: that of the recording)",
    )
    spawn.set_defaults(run=_spawn)


def _spawn(args: argparse.Namespace) -> None:
    if args.sample is not None:
        _sample(args)
    elif any(option is not None for option in (args.model, args.seed, args.horizon_s)):
        raise SettingError(
            "--model, --seed and --horizon-s", got="no --sample", expected="--sample FILE"
        )
    else:
        _test(args)


def _sample(args: argparse.Namespace) -> None:
    from crowdbench.scene import load_scene

    sys.path.insert(0, os.getcwd())  # so that pkg.module:Class is found in the working directory
    scene, seed, horizon_s = load_scene(args.scene), args.seed or 0, args.horizon_s
    if seed < 0:
        raise SettingError("--seed", got=f"{seed}", expected="0 or more")
    if horizon_s is not None and not 0 < horizon_s < math.inf:
        raise SettingError("--horizon-s", got=f"{horizon_s:g}", expected="a number above 0")
    write_sample(scene, args.model or "ntpp-gmm", args.sample, seed=seed, horizon_s=horizon_s)


def write_sample(
    scene: "Scene", name: str, out: Path, *, seed: int = 0, horizon_s: float | None = None
) -> None:
    """Write a sample of a spawn model of `horizon_s` seconds (default: as long as the recording).

    Raises:
        SettingError, WeightsError, RecordingError: as `spawn_model`.
        OutputError: `out` cannot be written.
    """
    from crowdbench.registry import GENERATED, spawn_model
    from crowdbench.run.episode import arrivals
    from crowdbench.spawn.steering.scenario import split_scenario
    from crowdbench.spawn.table import write_events

    model = spawn_model(name, scene)
    frames = scene.recording.frames if horizon_s is None else scene.frames(horizon_s)
    events = arrivals(model, scene, seed=seed, world=0, warm_up=0, frames=frames)
    write_events(events, out)
    print(f"written to {out}: {len(events)} people of {model.name}, {frames * scene.dt_s:g} s")
    copied = split_scenario(name)[0] in ("replay", "block-replay")
    if copied and scene.recording.name not in GENERATED:
        print_note("The recording remains subject to its owners' terms: do not publish this file.")


def _test(args: argparse.Namespace) -> None:
    from crowdbench.scene import load_scene
    from crowdbench.scene_building.spawn_diagnostics import check_models, trained_networks
    from crowdbench.spawn.times.rescaling import KolmogorovSmirnov

    def ks(found: KolmogorovSmirnov | None) -> str:
        return "" if found is None else f"{found.statistic:.3f} ({found.p:.2g})"

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.3f}"

    scene = load_scene(args.scene)
    found = list(check_models(scene))
    likelihood = new_table(
        "nats per person", "full", "held out", "fresh", "persons", "first 25 frames"
    )
    rescaling = new_table("KS (p)", "gaps", "group sizes", "own gaps", "own sizes")
    for c in found:
        cells = (c.full, c.heldout, c.fresh, c.persons, c.first)
        likelihood.add_row(c.model, *map(number, cells))
        if c.gaps is not None:
            tests = (c.gaps, c.sizes, c.own_gaps, c.own_sizes)
            rescaling.add_row(c.model, *map(ks, tests))
    console = new_console()
    console.print(likelihood)
    print_note(
        "Log-likelihood of the arrivals per area and grid point, in nats per person, averaged over "
        "the fits. full: of the recording. held out: of each fold, by models fitted to the other "
        "folds. fresh: of ten new hours, where the true process is known. persons: sampled people "
        "per recorded person. first 25 frames: arrivals relative to the average."
    )
    console.print(rescaling)
    print_note(
        "Time rescaling: Kolmogorov-Smirnov statistic of the recorded gaps between arrivals and of "
        "group sizes under each model. own: the same for ten hours of the model's own samples. A "
        "small p indicates a misfit."
    )
    if any(c.model == "ntpp-gmm" for c in found):
        print_note(str(trained_networks(scene)))
