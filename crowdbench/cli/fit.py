"""`crowdbench fit`: fit a scene's areas, spawn models and reference statistics."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import print_facts, progress_bar
from crowdbench.cli.workers import add_engine

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    fit = commands.add_parser(
        "fit", help="fit a scene's areas, spawn models and reference statistics"
    )
    fit.add_argument("scene", help="id of a scene, or its folder")
    fit.add_argument(
        "--clustering",
        default="default",
        help="name of the clustering settings in scene.toml (default: default)",
    )
    fit.add_argument(
        "--preprocess",
        choices=["paper"],
        help="drop people as the founding paper does, and print how many; needs --out",
    )
    fit.add_argument(
        "--models",
        nargs="*",
        metavar="MODEL",
        default=["poisson-gmm", "poisson-groups", "renewal-gmm", "cox-gmm", "ntpp-gmm"],
        help="spawn models to fit; an empty list fits only areas and reference statistics "
        "(default: poisson-gmm poisson-groups renewal-gmm cox-gmm ntpp-gmm)",
    )
    network = fit.add_argument_group("training of ntpp-gmm and ntpp-paper")
    network.add_argument("--window", type=int, help="length of a training window, frames")
    network.add_argument("--stride", type=int, help="frames from one training window to the next")
    network.add_argument("--epochs", type=int, help="(maximum) number of epochs")
    network.add_argument("--lr", type=float, help="learning rate")
    network.add_argument("--fits", type=int, help="number of fits (default: the scene's)")
    network.add_argument(
        "--published-code",
        action="store_true",
        help="train ntpp-paper as the paper's published code does, which differs from the paper",
    )
    network.add_argument(
        "--shared", action="store_true", help="train one network of ntpp-gmm for all areas"
    )
    add_engine(fit)
    fit.add_argument("--out", type=Path, help="output folder (default: the scene's folder)")
    fit.set_defaults(run=_fit)


def _fit(args: argparse.Namespace) -> None:
    from crowdbench.registry import recording
    from crowdbench.scene import load_scene
    from crowdbench.scene_building.fit import fit_scene

    scene = load_scene(args.scene)
    crowd = recording(scene.recording.name)
    training = {
        "window_frames": args.window,
        "stride_frames": args.stride,
        "epochs": args.epochs,
        "learning_rate": args.lr,
        "published_code": args.published_code or None,
        "shared": args.shared or None,
    }
    with progress_bar("fits") as progress:
        facts = fit_scene(
            scene,
            crowd,
            clustering=args.clustering,
            preprocess=args.preprocess,
            models=args.models,
            training={name: value for name, value in training.items() if value is not None},
            fits=args.fits,
            out=args.out,
            workers=args.workers,
            progress=progress,
        )
    print_facts(scene.id, facts)
    print(f"Next, if arrivals or areas changed: crowdbench anchors {args.out or args.scene}")
