"""`crowdbench evaluate`: spawn models and policies rolled out on a scene, and scored."""

import argparse
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import print_facts, progress_bar
from crowdbench.cli.score_tables import print_card

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.scoring.scorecard import Scorecard
    from crowdbench.trajectories.table import Trajectories


def add(commands: "Commands") -> None:
    """Add it to the command line."""
    evaluate = commands.add_parser(
        "evaluate", help="roll out crowds on a scene and compare them with its recording"
    )
    evaluate.add_argument("scene", help="id of a scene (see `crowdbench scenes`), or its folder")
    evaluate.add_argument(
        "--spawn",
        nargs="+",
        default=["poisson-gmm", "renewal-gmm", "ntpp-gmm"],
        metavar="MODEL",
        help="poisson-gmm, poisson-groups, renewal-gmm, ntpp-gmm, block-replay, replay, a folder "
        "with the fits of one model, or pkg.module:Class (default: poisson-gmm renewal-gmm "
        "ntpp-gmm)",
    )
    evaluate.add_argument(
        "--policy",
        nargs="+",
        metavar="POLICY",
        default=["straight", "social-force"],
        help="straight, social-force, random, replay, FILE.onnx, a folder of such files for each "
        "fold, or pkg.module:Class (default: straight social-force)",
    )
    evaluate.add_argument(
        "--metric",
        nargs="+",
        default=[],
        metavar="METRIC",
        help="metrics of your own beside all others, pkg.module:Class (see `crowdbench metrics`)",
    )
    evaluate.add_argument(
        "--scenario",
        metavar="FILE.toml",
        help="steer each spawn model by it: other rates, goals and areas, without retraining",
    )
    evaluate.add_argument(
        "--protocol",
        choices=["full", "heldout"],
        default="full",
        help="fit and compare on the whole recording, or on what was held out (default: full)",
    )
    evaluate.add_argument(
        "--seeds",
        type=int,
        metavar="N",
        help="rollouts of each pair (in each fold); a score needs at least two of each of the "
        "scene's fits, which are 5 as a rule: 10, 15, 20 and so on make scores, 1 to 9 only plain "
        "distances (default: the scene's protocol, 15 to 50)",
    )
    evaluate.add_argument("--workers", type=int, help="processes (default: one per core)")
    evaluate.add_argument("--out", type=Path, help="folder of the results (default: results/…)")
    evaluate.add_argument(
        "--view",
        action="store_true",
        help="open the viewer with the first rollout of each pair when all are made",
    )
    evaluate.set_defaults(run=_evaluate)


def _evaluate(args: argparse.Namespace) -> None:
    from crowdbench.evaluation.evaluate import evaluate
    from crowdbench.scene import load_scene

    sys.path.insert(0, os.getcwd())  # one's own pkg.module:Class may lie beside
    if args.view:  # found out before minutes of rollouts
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
            progress=progress,
        )
    print_card(card, load_scene(args.scene))
    if any(entry.spawn == entry.policy == "replay" for entry in card.entries):
        _print_replay(args.scene, out)
    print(f"written to {out}: report.html, scorecard.json, run.json, rollouts/ and pictures")
    if args.view:
        _show_first(card, args.scene, out)


def _print_replay(scene: str, out: Path) -> None:
    """Say where the replay differs from the recording, and what the arrival rule would change."""
    from crowdbench.evaluation.replay_check import arrival_rule_changes, compare_replay
    from crowdbench.registry import recording_of
    from crowdbench.scene import load_scene
    from crowdbench.trajectories.storage import read_own

    place = load_scene(scene)
    recording = recording_of(place)
    walked = read_own(out / "rollouts" / "replay_replay_full_0.parquet")
    print_facts("replay against the recording", compare_replay(recording, walked, place))
    print_facts("what the arrival rule would change", arrival_rule_changes(recording, place))
    print()


def _show_first(card: "Scorecard", named: str, out: Path) -> None:
    """Show the first rollout of each pair beside the recording, where that is at hand."""
    from crowdbench.registry import has_recording, recording_of
    from crowdbench.scene import load_scene
    from crowdbench.trajectories.storage import read_own
    from crowdbench.viewer import show

    scene = load_scene(named)
    against = recording_of(scene) if has_recording(scene) else None
    first: dict[tuple[str, str], Trajectories] = {}
    for path in sorted((out / "rollouts").glob("*_0.parquet")):
        crowd = read_own(path)
        first.setdefault((crowd.provenance["spawn"], crowd.provenance["policy"]), crowd)
    for entry in card.entries:
        show(first[entry.spawn, entry.policy], scene, against=against)
