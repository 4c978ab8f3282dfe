"""`crowdbench evaluate`: roll out spawn models and policies on a scene and score them."""

import argparse
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import add_json_option, json_written, print_facts, progress_bar
from crowdbench.cli.score_tables import print_card
from crowdbench.cli.workers import add_engine

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.data.table import Trajectories
    from crowdbench.scoring.scorecard import Scorecard


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    evaluate = commands.add_parser(
        "evaluate", help="roll out crowds on a scene and compare them with its recording"
    )
    evaluate.add_argument("scene", help="id of a scene (see `crowdbench scenes`), or its folder")
    evaluate.add_argument(
        "--spawn",
        nargs="+",
        default=["poisson-gmm", "renewal-gmm", "ntpp-gmm"],
        metavar="MODEL",
        help="spawn models: poisson-gmm, poisson-groups, renewal-gmm, ntpp-gmm, cox-gmm, "
        "poisson-paper and ntpp-paper (single people); poisson-plans, ntpp-plans and cox-plans "
        "(people with companions and stops); block-replay, replay; a folder with the fits of one "
        "model, or pkg.module:Class (default: poisson-gmm renewal-gmm ntpp-gmm)",
    )
    evaluate.add_argument(
        "--policy",
        nargs="+",
        metavar="POLICY",
        default=["straight", "social-force"],
        help="policies: straight, social-force, random, anticipate-any, replay and recorded-paths "
        "(these two with the spawn model replay), those that come with the scene, FILE.onnx, a "
        "folder with such a file for each fold, or pkg.module:Class (default: straight "
        "social-force)",
    )
    evaluate.add_argument(
        "--metric",
        nargs="+",
        default=[],
        metavar="METRIC",
        help="additional metrics of your own, pkg.module:Class (see `crowdbench metrics`)",
    )
    evaluate.add_argument(
        "--scenario",
        metavar="FILE.toml",
        help="scenario that changes rates, goals and areas of each spawn model without retraining",
    )
    evaluate.add_argument(
        "--protocol",
        choices=["full", "heldout"],
        default="full",
        help="full: fit and compare on the whole recording; heldout: compare on the folds that "
        "were held out from fitting (default: full)",
    )
    evaluate.add_argument(
        "--seeds",
        type=int,
        metavar="N",
        help="rollouts of each pair of spawn model and policy (in each fold). Scores need at least "
        "two rollouts per fit. With the usual 5 fits, use 10, 15, 20, …; fewer give only plain "
        "distances (default: as in the scene's protocol, 15 to 50)",
    )
    add_engine(evaluate)
    evaluate.add_argument(
        "--no-report", action="store_true", help="write the scorecard only, without report.html"
    )
    evaluate.add_argument(
        "--out", type=Path, help="output folder (default: results/SCENE-DATE-TIME)"
    )
    evaluate.add_argument(
        "--view",
        action="store_true",
        help="show the first rollout of each pair in the viewer at the end",
    )
    add_json_option(evaluate)
    evaluate.set_defaults(run=_evaluate)


def _evaluate(args: argparse.Namespace) -> None:
    from crowdbench.scoring.score_json import score_rows

    with json_written(args.json) as write:
        write(score_rows(_evaluated(args)))


def _evaluated(args: argparse.Namespace) -> "Scorecard":
    from crowdbench.crowds import evaluate
    from crowdbench.scene import load_scene

    sys.path.insert(0, os.getcwd())  # so that pkg.module:Class is found in the working directory
    if args.view:  # checked before minutes of rollouts
        from crowdbench.viewer import check_screen

        check_screen()
    when = time.strftime("%Y%m%d-%H%M%S")
    out = args.out or Path("results") / f"{Path(args.scene).name}-{when}"
    with progress_bar("rollouts") as progress:
        card = evaluate(
            args.scene,
            spawn=[f"{s}+{args.scenario}" for s in args.spawn] if args.scenario else args.spawn,
            policy=args.policy,
            metric=args.metric,
            protocol=args.protocol,
            seeds=args.seeds,
            workers=args.workers,
            out=out,
            report=not args.no_report,
            progress=progress,
        )
    print_card(card, load_scene(args.scene))
    if any(entry.spawn == entry.policy == "replay" for entry in card.entries):
        _print_replay(args.scene, out)
    report = "" if args.no_report else "report.html, "
    print(f"written to {out}: {report}scorecard.json, run.json and rollouts/")
    if args.view:
        _show_first(card, args.scene, out)
    return card


def _print_replay(scene: str, out: Path) -> None:
    """Print how the replay differs from the recording, and the effect of the arrival rule."""
    from crowdbench.data.storage import read_own
    from crowdbench.registry import recording_of
    from crowdbench.run.replay_check import arrival_rule_changes, compare_replay
    from crowdbench.scene import load_scene

    place = load_scene(scene)
    recording = recording_of(place)
    walked = read_own(out / "rollouts" / "replay_replay_full_0.parquet")
    print_facts("replay compared with the recording", compare_replay(recording, walked, place))
    print_facts("effect of the arrival rule", arrival_rule_changes(recording, place))
    print()


def _show_first(card: "Scorecard", named: str, out: Path) -> None:
    """Show the first rollout of each pair, next to the recording if it is available."""
    from crowdbench.data.storage import read_own
    from crowdbench.registry import has_recording, recording_of
    from crowdbench.scene import load_scene
    from crowdbench.viewer import show

    scene = load_scene(named)
    against = recording_of(scene) if has_recording(scene) else None
    first: dict[tuple[str, str], Trajectories] = {}
    for path in sorted((out / "rollouts").glob("*_0.parquet")):
        crowd = read_own(path)
        first.setdefault((crowd.provenance["spawn"], crowd.provenance["policy"]), crowd)
    for entry in card.entries:
        show(first[entry.spawn, entry.policy], scene, against=against)
