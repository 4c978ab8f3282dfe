"""`evaluate` and `score`: how good is a crowd?"""

import argparse
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_facts, progress_bar

if TYPE_CHECKING:
    from crowdbench.cards import Scorecard
    from crowdbench.cli.printing import Commands
    from crowdbench.trajectories import Trajectories


def add(commands: "Commands") -> None:
    """Add them to the command line."""
    evaluate = commands.add_parser(
        "evaluate", help="roll out crowds on a scene and compare them with its recording"
    )
    evaluate.add_argument("scene", help="id of a scene (see `crowdbench scenes`), or its folder")
    evaluate.add_argument(
        "--spawn",
        nargs="+",
        default=["poisson-gmm", "renewal-gmm", "ntpp-gmm"],
        metavar="MODEL",
        help="poisson-gmm, renewal-gmm, ntpp-gmm, block-replay, replay, a folder with the fits of "
        "one model, or pkg.module:Class (default: the first three)",
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
        "--seeds", type=int, help="rollouts per pair and fold (default: the scene's protocol)"
    )
    evaluate.add_argument("--workers", type=int, help="processes (default: one per core)")
    evaluate.add_argument("--out", type=Path, help="folder of the results (default: results/…)")
    evaluate.add_argument(
        "--view",
        action="store_true",
        help="open the viewer with the first rollout of each pair when all are made",
    )
    evaluate.set_defaults(run=_evaluate)

    score = commands.add_parser("score", help="score trajectories that any simulator made")
    score.add_argument("scene", help="id of a scene, or its folder")
    score.add_argument(
        "table", type=Path, help="CSV or Parquet with person_id, frame (or time_s), x, y"
    )
    score.set_defaults(run=_score)


def _evaluate(asked: argparse.Namespace) -> None:
    from crowdbench.evaluation import evaluate

    sys.path.insert(0, os.getcwd())  # one's own pkg.module:Class may lie beside
    if asked.view:  # found out before minutes of rollouts
        from crowdbench.viewer import check_screen

        check_screen()
    when = time.strftime("%Y%m%d-%H%M%S")
    out = asked.out or Path("results") / f"{Path(asked.scene).name}-{when}"
    with progress_bar("rollouts") as progress:
        card = evaluate(
            asked.scene,
            spawn=[f"{s}+{asked.scenario}" for s in asked.spawn] if asked.scenario else asked.spawn,
            policy=asked.policy,
            protocol=asked.protocol,
            seeds=asked.seeds,
            workers=asked.workers,
            out=out,
            progress=progress,
        )
    _print_card(card)
    if any(entry.spawn == entry.policy == "replay" for entry in card.entries):
        _print_replay(asked.scene, out)
    print(f"written to {out}: report.html, scorecard.json, run.json, rollouts/ and pictures")
    if asked.view:
        _show_first(card, asked.scene, out)


def _print_card(card: "Scorecard") -> None:
    from crowdbench.cards import rows, steered, walked
    from crowdbench.metrics import FAMILIES, METRICS, WALK
    from crowdbench.report.words import STEERED, interval, number

    table = rows(card)
    print(
        f"\n{card.scene}, protocol {card.protocol}: {card.horizon_s:.0f} s, {card.blocks} time "
        f"blocks, {card.rollouts} rollouts of each pair"
        f"{' in each fold' if card.protocol == 'heldout' else ''}."
    )
    if not card.scored:
        print("No metric of this scene is scored yet: run `crowdbench power`.")
    console = new_console(140)
    wide = console.width >= 135  # room for the interval of the first four families too
    heads = [f.replace("interaction", "inter-\naction") for f in FAMILIES]
    scores = new_table("spawn × policy", *heads[:4], "crowd", *heads[4:], "overall", "rank")
    for column in (scores.columns[0], scores.columns[5], scores.columns[8]):
        column.no_wrap = True
    for k, row in enumerate(table):
        if row.kind == "anchor" and table[k - 1].kind == "entry":
            scores.add_section()
        missing = row.kind == "entry" and row.walk is None and not walked(card)
        scores.add_row(
            f"{row.spawn} × {row.policy}",
            *[number(row.families.get(f)) for f in FAMILIES[:4]],
            interval(row.crowd) if wide else number(row.crowd),
            *(["needs", "recording"] if missing else map(number, map(row.families.get, WALK))),
            interval(row.overall),
            "" if row.rank is None else f"{row.rank}",
        )
    console.print(scores)
    print(
        "Scores: 0 is the anchor (poisson-gmm × straight; in motion and interaction straight\n"
        "walkers under the recorded arrivals), 1 what the true process gets on average; [95 %].\n"
        "crowd: mean of the first four families. Equal ranks cannot be told apart (5 %, Holm).\n"
        "Below the line: anchors; replay has the recording by heart, block-replay pieces of it.\n"
    )
    if any(steered(entry.spawn) for entry in card.entries):
        new_console().print(STEERED, "\n")
    entries = [e for e in card.entries if e.spawn != "replay"] or card.entries
    distances = new_table("distance", "", "recorded", *[f"{k}" for k in range(1, len(entries) + 1)])
    known = entries[0].metrics
    for name, first in ((m.name, known[m.name]) for m in METRICS if m.name in known):
        mark = "scored" if name in card.scored else ""
        value = "" if first.recorded is None else f"{first.recorded:.2f} {first.unit}"
        cells = [e.metrics[name].distance for e in entries]
        distances.add_row(
            name.replace("_", " "),
            mark,
            value,
            *["–" if c is None else f"{c:.3f}" for c in cells],
        )
    console.print(distances)
    print(
        "Plain distances to the recording, mean over the rollouts; 0 is equal. "
        + ", ".join(f"{k} {e.spawn} × {e.policy}" for k, e in enumerate(entries, 1))
        + "\n"
    )


def _print_replay(scene: str, out: Path) -> None:
    """Say where the replay differs from the recording, and what the arrival rule would change."""
    from crowdbench.registry import recording_of
    from crowdbench.replay_check import arrival_rule_changes, compare_replay
    from crowdbench.scene import load_scene
    from crowdbench.tables import read_own

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
    from crowdbench.tables import read_own
    from crowdbench.viewer import show

    scene = load_scene(named)
    against = recording_of(scene) if has_recording(scene) else None
    first: dict[tuple[str, str], Trajectories] = {}
    for path in sorted((out / "rollouts").glob("*_0.parquet")):
        crowd = read_own(path)
        first.setdefault((crowd.provenance["spawn"], crowd.provenance["policy"]), crowd)
    for entry in card.entries:
        show(first[entry.spawn, entry.policy], scene, against=against)


def _score(asked: argparse.Namespace) -> None:
    from crowdbench.reference import score
    from crowdbench.scene import load_scene
    from crowdbench.tables import read

    scene = load_scene(asked.scene)
    crowd = read(asked.table, scene=scene.id, dt_s=scene.dt_s)
    results = score(scene, crowd)
    table = new_table("metric", "distance", "recorded mean", "your mean", "your n")
    for name, r in results.items():
        table.add_row(
            name.replace("_", " "),
            f"{r.distance:.3f}",
            f"{r.recorded:.2f} {r.unit}",
            f"{r.simulated:.2f} {r.unit}",
            f"{r.n}",
        )
    new_console().print(f"\n{asked.table.name} on {scene.id}: {len(crowd)} persons")
    new_console().print(table)
