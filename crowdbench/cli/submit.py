"""`crowdbench submit`: create and check a submission to the leaderboard."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import print_facts

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.leaderboard.verification.check import Checked


def add(commands: "Commands") -> None:
    """Add these commands to the command line."""
    submit = commands.add_parser("submit", help="create and check a leaderboard submission")
    of_submit = submit.add_subparsers(required=True, metavar="COMMAND")
    init = of_submit.add_parser("init", help="create the folder of a new submission to fill in")
    init.add_argument("folder", type=Path, metavar="DIR", help="folder to create")
    init.add_argument(
        "--track",
        choices=["walk", "spawn", "crowd"],
        required=True,
        help="walk: a policy with the recorded arrivals; spawn: a spawn model with straight "
        "walkers; crowd: a spawn model and a policy",
    )
    init.add_argument(
        "--name", default="", help="name on the leaderboard (default: the name of DIR)"
    )
    init.add_argument(
        "--policy",
        type=Path,
        nargs="+",
        default=[],
        metavar="PATH",
        help="networks to copy: for each scene a folder with fold0.onnx, fold1.onnx and "
        "fold2.onnx, or one FILE.onnx that was trained on none of the scenes",
    )
    init.add_argument(
        "--scene",
        nargs="+",
        default=[],
        metavar="SCENE",
        help="scenes of the submission (default: those of the policies, else eth-v0 gc-v0 "
        "forum-v0)",
    )
    init.set_defaults(run=_init)
    check = of_submit.add_parser("check", help="check a submission and list all its problems")
    check.add_argument("submission", type=Path, metavar="DIR", help="folder of a submission")
    check.set_defaults(run=_check)


def _init(args: argparse.Namespace) -> None:
    from crowdbench.leaderboard.submission.template import start_submission

    scenes = start_submission(
        args.folder, args.track, name=args.name, scenes=args.scene, policies=args.policy
    )
    print(f"{args.folder}: track {args.track} on {', '.join(scenes)}")
    print(
        f"Fill in {args.folder / 'submission.toml'} as described in {args.folder / 'README.md'}. "
        f"Next: crowdbench submit check {args.folder}"
    )


def _check(args: argparse.Namespace) -> None:
    from crowdbench.leaderboard.verification.check import check

    _print(check(args.submission))


def _print(submission: "Checked") -> None:
    declared = submission.declared
    counted = {
        "networks": submission.networks,
        "files of fits": submission.fits,
        "rollouts": submission.rollouts,
    }
    models = [declared.shipped_spawn, declared.shipped_policy]
    models += [f"{what}: {count}" for what, count in counted.items() if count]
    print_facts(
        declared.name,
        {
            "id": submission.id,
            "track": f"{declared.track}, {declared.kind}, trained: {declared.training.protocol}",
            "scenes": ", ".join(declared.scenes),
            "models": ", ".join(filter(None, models)),
            "status": f"{submission.status}: {submission.why}",
        },
    )
