"""The command line: `crowdbench evaluate | score | fit | data | scenes | bench`.

A user's error is one message and exit code 2; an interrupt exits with 130.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench import __version__
from crowdbench.errors import CrowdbenchError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from crowdbench.evaluation import Scorecard


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; the return value is the exit code."""
    asked = _parser().parse_args(arguments)
    try:
        asked.run(asked)
    except CrowdbenchError as error:
        print(f"crowdbench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("crowdbench: interrupted", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="crowdbench", description="A benchmark of crowds that come and go."
    )
    parser.add_argument("--version", action="version", version=f"crowdbench {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    evaluate = commands.add_parser(
        "evaluate", help="roll out crowds on a scene and compare them with its recording"
    )
    evaluate.add_argument("scene", help="id of a scene (see `crowdbench scenes`), or its folder")
    evaluate.add_argument(
        "--spawn",
        nargs="+",
        default=["poisson-gmm"],
        metavar="MODEL",
        help="poisson-gmm, renewal-gmm, ntpp-gmm, block-replay, replay or pkg.module:Class "
        "(default: poisson-gmm)",
    )
    evaluate.add_argument(
        "--policy",
        nargs="+",
        metavar="POLICY",
        default=["straight", "social-force", "random"],
        help="straight, social-force, random, replay or pkg.module:Class "
        "(default: straight social-force random)",
    )
    evaluate.add_argument("--seeds", type=int, default=6, help="rollouts per pair (default: 6)")
    evaluate.add_argument("--workers", type=int, help="processes (default: one per core)")
    evaluate.add_argument("--out", type=Path, help="folder of the results (default: results/…)")
    evaluate.set_defaults(run=_evaluate)

    score = commands.add_parser("score", help="score trajectories that any simulator made")
    score.add_argument("scene", help="id of a scene, or its folder")
    score.add_argument(
        "table", type=Path, help="CSV or Parquet with person_id, frame (or time_s), x, y"
    )
    score.set_defaults(run=_score)

    fit = commands.add_parser(
        "fit", help="fit a scene's areas, spawn models and reference statistics"
    )
    fit.add_argument("scene", help="id of a scene, or its folder")
    fit.add_argument(
        "--clustering",
        default="default",
        help="settings of that name in scene.toml (default: default)",
    )
    fit.add_argument(
        "--models",
        nargs="+",
        metavar="MODEL",
        default=["poisson-gmm", "renewal-gmm", "ntpp-gmm"],
        help="spawn models to fit (default: poisson-gmm renewal-gmm ntpp-gmm)",
    )
    fit.add_argument("--out", type=Path, help="folder to write to (default: the scene's)")
    fit.set_defaults(run=_fit)

    data = commands.add_parser("data", help="import, list and describe recordings")
    of_data = data.add_subparsers(required=True, metavar="COMMAND")
    bring = of_data.add_parser("import", help="read a recording and keep it for later use")
    bring.add_argument("name", help="name of a recording (see `crowdbench data list`)")
    bring.add_argument(
        "--source",
        type=Path,
        metavar="DIR",
        help="folder in OpenTraj's layout (default: $CROWDBENCH_DATA)",
    )
    bring.set_defaults(run=_import)
    listing = of_data.add_parser("list", help="list the known recordings")
    listing.set_defaults(run=_list)
    describe = of_data.add_parser("describe", help="print a recording's figures")
    describe.add_argument("name", help="name of a recording")
    describe.set_defaults(run=_describe)

    scenes = commands.add_parser("scenes", help="list the scenes")
    scenes.set_defaults(run=_scenes)

    bench = commands.add_parser("bench", help="measure how fast crowdbench is here")
    bench.add_argument("--json", type=Path, metavar="FILE", help="also write the figures there")
    bench.set_defaults(run=_bench)
    return parser


def _console() -> "Console":
    from rich.console import Console

    # A pipe has no width; tables need about this much.
    return Console(highlight=False, width=None if sys.stdout.isatty() else 100)


def _table(*columns: str) -> "Table":
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", overflow="fold")
    return table


def _pairs(title: str, facts: dict[str, str]) -> None:
    """Print facts as `name  value`, one a line."""
    width = max(len(name) for name in facts)
    print(title)
    for name, value in facts.items():
        print(f"  {name:<{width}}  {value}")


@contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar, shown from the first time on that it is told how much is done."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn(what),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    bar = Progress(*columns, console=_console())
    task = bar.add_task(what)

    def progress(done: int, total: int) -> None:
        bar.start()  # not before everything asked for was found
        bar.update(task, completed=done, total=total)

    try:
        yield progress
    finally:
        if bar.live.is_started:  # else it would print an empty line
            bar.stop()


def _evaluate(asked: argparse.Namespace) -> None:
    from crowdbench.evaluation import evaluate

    sys.path.insert(0, os.getcwd())  # one's own pkg.module:Class may lie beside

    when = time.strftime("%Y%m%d-%H%M%S")
    out = asked.out or Path("results") / f"{Path(asked.scene).name}-{when}"
    with _bar("rollouts") as progress:
        card = evaluate(
            asked.scene,
            spawn=asked.spawn,
            policy=asked.policy,
            seeds=asked.seeds,
            workers=asked.workers,
            out=out,
            progress=progress,
        )
    _print_card(card)
    if any(entry.spawn == entry.policy == "replay" for entry in card.entries):
        _print_replay(asked.scene, out)
    print(
        f"written to {out}: scorecard.json, run.json, rollouts/, agents_over_time.png,\n"
        "inter_spawn.png, dwell.png, paths.png"
    )


def _print_card(card: "Scorecard") -> None:
    import statistics

    names = list(card.entries[0].metrics)
    table = _table("spawn × policy", "persons", "goal", *[n.replace("_", " ") for n in names])
    for entry in card.entries:
        cells = []
        for name in names:
            each = entry.metrics[name].distances
            spread = f" ± {statistics.stdev(each):.3f}" if len(each) > 1 else ""
            cells.append(f"{entry.metrics[name].distance:.3f}{spread}")
        ended = sum(n for how, n in entry.outcomes.items() if how not in ("horizon", "recorded"))
        goal = f"{entry.outcomes.get('goal', 0) / ended:.0%}" if ended else "–"
        persons = f"{entry.persons / len(entry.seeds):.0f}"
        table.add_row(f"{entry.spawn} × {entry.policy}", persons, goal, *cells)
    means = (
        f"{name.replace('_', ' ')} {m.recorded:.2f} {m.unit}"
        for name, m in card.entries[0].metrics.items()
    )
    print(
        f"\n{card.scene}: {card.horizon_s:.0f} s, {card.blocks} time blocks. "
        f"Recorded means: {', '.join(means)}."
    )
    _console().print(table)
    print(
        "Distances to the recording: Wasserstein-1 divided by the recorded mean, mean ± standard\n"
        "deviation over the rollouts; 0 is equal. persons: per rollout. goal: share of the ended\n"
        "lives that reached it.\n"
    )


def _print_replay(scene: str, out: Path) -> None:
    """Say where the replay differs from the recording, and what the arrival rule would change."""
    from crowdbench.registry import recording_of
    from crowdbench.replay_check import arrival_rule_changes, compare_replay
    from crowdbench.scene import load_scene
    from crowdbench.tables import read_own

    place = load_scene(scene)
    recording = recording_of(place)
    walked = read_own(out / "rollouts" / "replay_replay_0.parquet")
    _pairs("replay against the recording", compare_replay(recording, walked, place))
    _pairs("what the arrival rule would change", arrival_rule_changes(recording, place))
    print()


def _score(asked: argparse.Namespace) -> None:
    from crowdbench.reference import score
    from crowdbench.scene import load_scene
    from crowdbench.tables import read

    scene = load_scene(asked.scene)
    crowd = read(asked.table, scene=scene.id, dt_s=scene.dt_s)
    results = score(scene, crowd)
    table = _table("metric", "distance", "recorded mean", "your mean", "your n")
    for name, r in results.items():
        table.add_row(
            name.replace("_", " "),
            f"{r.distance:.3f}",
            f"{r.recorded:.2f} {r.unit}",
            f"{r.simulated:.2f} {r.unit}",
            f"{r.n}",
        )
    _console().print(f"\n{asked.table.name} on {scene.id}: {len(crowd)} persons")
    _console().print(table)


def _fit(asked: argparse.Namespace) -> None:
    from crowdbench.fit import fit_scene
    from crowdbench.registry import recording
    from crowdbench.scene import load_scene

    scene = load_scene(asked.scene)
    crowd = recording(scene.recording.name)
    with _bar("fits") as progress:
        found = fit_scene(
            scene,
            crowd,
            clustering=asked.clustering,
            models=asked.models,
            out=asked.out,
            progress=progress,
        )
    _pairs(scene.id, found)


def _import(asked: argparse.Namespace) -> None:
    from crowdbench.recordings.catalogue import SOURCES, cached
    from crowdbench.recordings.describe import describe
    from crowdbench.registry import import_recording

    crowd = import_recording(asked.name, asked.source)
    _pairs(asked.name, describe(crowd) | {"kept at": str(cached(asked.name))})
    if asked.name in SOURCES:
        print(f"It stays under its owners' terms. Cite: {SOURCES[asked.name].cite}.")


def _list(asked: argparse.Namespace) -> None:
    from crowdbench.recordings.catalogue import SOURCES, cached
    from crowdbench.registry import RECORDINGS

    for name in RECORDINGS:
        state = "imported" if cached(name).exists() else "not imported"
        origin = SOURCES[name].address if name in SOURCES else "generated"
        if origin == "generated":
            state = "always there"
        print(f"{name:<8} {state:<13} {origin}")


def _describe(asked: argparse.Namespace) -> None:
    from crowdbench.recordings.describe import describe
    from crowdbench.registry import recording

    _pairs(asked.name, describe(recording(asked.name)))


def _scenes(asked: argparse.Namespace) -> None:
    from crowdbench.scene import list_scenes, load_scene

    for name in list_scenes():
        print(f"{name:<10} {load_scene(name).title}")


def _bench(asked: argparse.Namespace) -> None:
    from crowdbench.bench import measure
    from crowdbench.files import write_json

    figures = []
    for figure in measure():
        print(f"{figure.name:<44} {figure.text()}", flush=True)
        figures.append(figure)
    if asked.json:
        write_json(asked.json, {f.name: {"value": f.value, "unit": f.unit} for f in figures})


if __name__ == "__main__":
    sys.exit(main())
