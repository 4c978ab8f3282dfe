"""`crowdbench spawn`: test a scene's spawn models, or write a sample of one of them."""

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_note
from crowdbench.errors import SettingError

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


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
        help="spawn model of --sample (default: ntpp-gmm); replay writes the recorded arrivals",
    )
    spawn.add_argument("--seed", type=int, help="random seed of --sample (default: 0)")
    spawn.set_defaults(run=_spawn)


def _spawn(args: argparse.Namespace) -> None:
    if args.sample is not None:
        _sample(args)
    elif args.model is not None or args.seed is not None:
        raise SettingError("--model and --seed", got="no --sample", expected="--sample FILE")
    else:
        _test(args)


def _sample(args: argparse.Namespace) -> None:
    from crowdbench.registry import GENERATED, spawn_model
    from crowdbench.rollouts.episode import arrivals
    from crowdbench.scene import load_scene
    from crowdbench.spawn.scenario import split_scenario
    from crowdbench.spawn.table import write_events

    sys.path.insert(0, os.getcwd())  # so that pkg.module:Class is found in the working directory
    scene, seed = load_scene(args.scene), args.seed or 0
    if seed < 0:
        raise SettingError("--seed", got=f"{seed}", expected="0 or more")
    name = args.model or "ntpp-gmm"
    model = spawn_model(name, scene)
    frames = scene.recording.frames
    events = arrivals(model, scene, seed=seed, world=0, warm_up=0, frames=frames)
    write_events(events, args.sample)
    print(f"written to {args.sample}: {len(events)} people of {model.name}, {scene.horizon_s:g} s")
    copied = split_scenario(name)[0] in ("replay", "block-replay")
    if copied and scene.recording.name not in GENERATED:
        print_note("The recording remains subject to its owners' terms: do not publish this file.")


def _test(args: argparse.Namespace) -> None:
    from crowdbench.scene import load_scene
    from crowdbench.scene_building.spawn_diagnostics import check_models, trained_networks
    from crowdbench.spawn.rescaling import KolmogorovSmirnov

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
