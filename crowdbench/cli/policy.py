"""`crowdbench policy`: export a network as a policy file, or show the card of a file."""

import argparse
import importlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crowdbench.cli.printing import print_facts
from crowdbench.errors import SettingError, to_install

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add these commands to the command line."""
    policy = commands.add_parser(
        "policy", help="export a trained policy to an ONNX file, or show such a file"
    )
    of_policy = policy.add_subparsers(required=True, metavar="COMMAND")
    export = of_policy.add_parser("export", help="write a torch network as an ONNX file")
    export.add_argument(
        "network",
        metavar="pkg.module:NAME|MODEL.zip",
        help="a torch.nn.Module, or a class or function without arguments that returns one; or a "
        "zip that Stable-Baselines3 or sb3-contrib saved. Reading a zip runs code of its pickles: "
        "only export your own",
    )
    export.add_argument("file", type=Path, metavar="FILE.onnx", help="file to write")
    export.add_argument("--name", required=True, help="name of the policy in tables")
    export.add_argument(
        "--scene",
        required=True,
        help="id of the scene it was trained on (plaza-v0 if it was trained on none)",
    )
    export.add_argument(
        "--split",
        default="full",
        help="split of the recording it was trained on: full, fold0, fold1 or fold2 (default: "
        "full)",
    )
    export.add_argument(
        "--observation",
        help="observation of the policy: lidar-1, lidar-2, lidar-3 or social-1 (default: lidar-2)",
    )
    export.add_argument("--rays", type=int, default=32, help="number of rays (default: 32)")
    export.add_argument(
        "--ray-range-m",
        type=float,
        default=10.0,
        help="range of the rays in metres (default: 10)",
    )
    export.add_argument(
        "--noise",
        type=int,
        default=0,
        metavar="Z",
        help="standard normal numbers that the network takes per person and step (default: 0). "
        "For a zip: 0 for the mean action, 2 to sample it",
    )
    export.add_argument(
        "--memory",
        type=int,
        default=0,
        metavar="M",
        help="size of the state that the network takes and returns (default: 0). Found in a zip",
    )
    export.add_argument(
        "--style",
        type=int,
        default=0,
        metavar="S",
        help="number of random numbers that are drawn once per person (default: 0)",
    )
    export.add_argument(
        "--interval",
        type=int,
        default=1,
        metavar="FRAMES",
        help="frames between two decisions for a person (default: 1)",
    )
    export.add_argument("--command", default="", help="training command, to be stored in the file")
    export.set_defaults(run=_export)
    show = of_policy.add_parser("show", help="check an ONNX file and print its card")
    show.add_argument("file", type=Path, metavar="FILE.onnx")
    show.set_defaults(run=_show)


def _export(args: argparse.Namespace) -> None:
    from crowdbench.policies import PolicyCard
    from crowdbench.policies.export import export_policy, revision
    from crowdbench.scene import load_scene
    from crowdbench.simulation.observations import OBSERVATION

    network = _network(args)
    card = PolicyCard(
        name=args.name,
        observation=args.observation or OBSERVATION,
        rays=args.rays,
        ray_range_m=args.ray_range_m,
        scene=load_scene(args.scene).id,
        split=args.split,
        memory=args.memory,
        style=args.style,
        interval=args.interval,
        command=args.command,
        revision=revision(Path()),
    )
    card.checked(args.file)
    export_policy(network, args.file, card, noise=args.noise)
    print(f"written to {args.file}")


def _network(args: argparse.Namespace) -> Any:
    """Network that the command names. That of a zip sets the size of the memory.

    Raises:
        SettingError: a package is not installed, or options do not fit the network.
        WeightsError: a zip is not that of a policy that can be exported.
    """
    sys.path.insert(0, os.getcwd())  # a zip may name classes of the user's own
    if not args.network.endswith(".zip"):
        return _imported(args.network)
    from crowdbench.policies.sb3 import read_sb3

    for name in ("memory", "style"):
        if getattr(args, name):
            raise SettingError(
                f"--{name}",
                got=str(getattr(args, name)),
                expected="no such option for a zip of Stable-Baselines3",
                hint="The size of a memory is found in the zip; styles are not known there.",
            )
    network = read_sb3(Path(args.network), noise=args.noise)
    args.memory = network.memory
    if network.normalized:
        print(
            "crowdbench: the model was trained in a VecNormalize, whose statistics are not in the "
            "zip. If it normalised observations, the file will not walk as the model does.",
            file=sys.stderr,
        )
    return network


def _imported(path: str) -> Any:
    """Network named by `pkg.module:NAME`.

    Raises:
        SettingError: torch is not installed, or the name is not that of a network.
    """
    try:
        import torch
    except ImportError as error:
        raise SettingError(
            "policy export",
            got="no torch",
            expected="torch to be installed",
            hint=to_install("fit"),
        ) from error
    module, _, name = path.partition(":")
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise SettingError(
            "network",
            got=f"{path!r} ({error})",
            expected="a pkg.module:NAME that can be imported",
        ) from error
    made = found() if callable(found) and not isinstance(found, torch.nn.Module) else found
    if not isinstance(made, torch.nn.Module):
        raise SettingError(
            "network", got=f"{path!r}, a {type(made).__name__}", expected="a torch.nn.Module"
        )
    return made


def _show(args: argparse.Namespace) -> None:
    from crowdbench.policies import OnnxPolicy

    policy = OnnxPolicy(args.file)
    card = policy.card
    rays = f", {card.rays} rays of {card.ray_range_m:g} m" if card.with_rays else ""
    facts = {
        "trained on": card.trained_on,
        "observation": f"{card.observation}{rays} ({card.inputs} numbers)",
        "action": card.action,
        "noise": f"{policy.noise} normal numbers per person and step" if policy.noise else "none",
        "memory": f"{card.memory} numbers per person" if card.memory else "none",
        "style": f"{card.style} normal numbers per person" if card.style else "none",
        "decisions": f"every {card.interval} frames" if card.interval > 1 else "every frame",
        "command": card.command or "not stated",
        "revision": card.revision or "not stated",
        "size": f"{args.file.stat().st_size / 1000:.0f} kB",
    }
    print_facts(card.name, facts)
