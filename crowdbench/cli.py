"""The command line: `crowdbench evaluate | score | spawn | data | scenes | bench`, and for who
makes a scene `fit | anchors | power | results | ablation`.

A user's error is one message and exit code 2; an interrupt exits with 130.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench import __version__
from crowdbench.errors import CrowdbenchError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from crowdbench.cards import Scorecard


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
        default=["poisson-gmm", "renewal-gmm", "ntpp-gmm"],
        metavar="MODEL",
        help="poisson-gmm, renewal-gmm, ntpp-gmm, block-replay, replay or pkg.module:Class "
        "(default: the first three)",
    )
    evaluate.add_argument(
        "--policy",
        nargs="+",
        metavar="POLICY",
        default=["straight", "social-force"],
        help="straight, social-force, random, replay or pkg.module:Class "
        "(default: straight social-force)",
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
    evaluate.set_defaults(run=_evaluate)

    results = commands.add_parser(
        "results", help="write a scene's page of results, with pictures (minutes)"
    )
    results.add_argument("scene", help="id of a scene, or its folder")
    results.add_argument(
        "--out",
        type=Path,
        default=Path("docs/results"),
        metavar="DIR",
        help="folder of the page and its pictures (default: docs/results)",
    )
    results.add_argument("--workers", type=int, help="processes (default: one per core)")
    results.add_argument(
        "--seeds", type=int, help="rollouts per crowd and fold (default: the scene's protocol)"
    )
    results.set_defaults(run=_results)

    ablation = commands.add_parser(
        "ablation",
        help="study the windows and strides that ntpp-gmm is trained with (minutes to hours)",
    )
    ablation.add_argument("scene", help="id of a scene, or its folder")
    ablation.add_argument(
        "--out",
        type=Path,
        default=Path("docs/ablation"),
        metavar="DIR",
        help="folder of the page and its picture (default: docs/ablation)",
    )
    ablation.add_argument("--workers", type=int, help="processes (default: one per core)")
    ablation.set_defaults(run=_ablation)

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
    fit.add_argument("--workers", type=int, help="processes (default: one per core)")
    fit.add_argument("--out", type=Path, help="folder to write to (default: the scene's)")
    fit.set_defaults(run=_fit)

    spawn = commands.add_parser(
        "spawn", help="tell how well a scene's spawn models explain its recording"
    )
    spawn.add_argument("scene", help="id of a scene, or its folder")
    spawn.set_defaults(run=_spawn)

    anchors = commands.add_parser(
        "anchors", help="roll out what a scene's scores are measured by (minutes)"
    )
    anchors.add_argument("scene", help="id of a scene, or its folder")
    anchors.add_argument("--workers", type=int, help="processes (default: one per core)")
    anchors.set_defaults(run=_anchors)

    power = commands.add_parser(
        "power", help="find out which metrics can tell a scene's anchor from its recording"
    )
    power.add_argument("scene", help="id of a scene, or its folder")
    power.add_argument(
        "--write", action="store_true", help="make these the scored metrics of scene.toml"
    )
    power.set_defaults(run=_power)

    data = commands.add_parser("data", help="fetch, import, list and describe recordings")
    of_data = data.add_subparsers(required=True, metavar="COMMAND")
    fetch = of_data.add_parser(
        "fetch", help="download a recording from where it is published, and import it"
    )
    fetch.add_argument("name", help="name of a recording (see `crowdbench data list`)")
    fetch.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder to download to, in OpenTraj's layout (default: OpenTraj in $CROWDBENCH_HOME)",
    )
    fetch.set_defaults(run=_fetch)
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


def _console(width: int = 100) -> "Console":
    from rich.console import Console

    # A pipe has no width; tables need about this much.
    return Console(highlight=False, width=None if sys.stdout.isatty() else width)


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
def _progress(
    what: str, *, of_bytes: bool = False
) -> "Iterator[Callable[[int, int | None], None]]":
    """A bar that appears with the first call of what this yields: progress(done, total)."""
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn(what),
        BarColumn(),
        DownloadColumn() if of_bytes else MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    # Fits take minutes: the speed of the last half minute alone would mostly be unknown.
    bar = Progress(*columns, console=_console(), speed_estimate_period=600.0)
    task = bar.add_task(what)

    def progress(done: int, total: int | None) -> None:
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
    with _progress("rollouts") as progress:
        card = evaluate(
            asked.scene,
            spawn=asked.spawn,
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


def _print_card(card: "Scorecard") -> None:
    from crowdbench.cards import rows, walked
    from crowdbench.metrics import FAMILIES, METRICS, WALK
    from crowdbench.report.words import interval, number

    table = rows(card)
    print(
        f"\n{card.scene}, protocol {card.protocol}: {card.horizon_s:.0f} s, {card.blocks} time "
        f"blocks, {card.rollouts} rollouts of each pair"
        f"{' in each fold' if card.protocol == 'heldout' else ''}."
    )
    if not card.scored:
        print("No metric of this scene is scored yet: run `crowdbench power`.")
    console = _console(140)
    wide = console.width >= 135  # room for the interval of the first four families too
    heads = [f.replace("interaction", "inter-\naction") for f in FAMILIES]
    scores = _table("spawn × policy", *heads[:4], "crowd", *heads[4:], "overall", "rank")
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
    entries = [e for e in card.entries if e.spawn != "replay"] or card.entries
    distances = _table("distance", "", "recorded", *[f"{k}" for k in range(1, len(entries) + 1)])
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


def _power(asked: argparse.Namespace) -> None:
    import tempfile

    from crowdbench.evaluation import power_study
    from crowdbench.scene import load_scene, write_scored

    scene = load_scene(asked.scene)
    with tempfile.TemporaryDirectory() as folder, _progress("rollouts") as progress:
        studies = power_study(asked.scene, Path(folder), progress=progress)
    table = _table("metric", "floor", "95 %", "anchor", "power", "")
    for s in studies:
        table.add_row(
            s.metric.replace("_", " "),
            f"{s.floor:.3f}",
            f"{s.threshold:.3f}",
            f"{s.anchor:.3f}",
            f"{s.power:.2f}",
            "scored" if s.counts else "",
        )
    _console().print(table)
    print(
        "Energy scores on synthetic recordings: of the true process (floor: mean and 95th\n"
        "percentile) and of the anchor. power: how often the anchor's lies beyond the percentile;\n"
        "from 0.8 on a metric is scored, unless the recording knows only one value of it.\n"
    )
    scored = [s.metric for s in studies if s.counts]
    print(f"scored = {scored}".replace("'", '"'))
    if asked.write:
        print(f"written to {write_scored(scene, scored)}")


def _print_replay(scene: str, out: Path) -> None:
    """Say where the replay differs from the recording, and what the arrival rule would change."""
    from crowdbench.registry import recording_of
    from crowdbench.replay_check import arrival_rule_changes, compare_replay
    from crowdbench.scene import load_scene
    from crowdbench.tables import read_own

    place = load_scene(scene)
    recording = recording_of(place)
    walked = read_own(out / "rollouts" / "replay_replay_full_0.parquet")
    _pairs("replay against the recording", compare_replay(recording, walked, place))
    _pairs("what the arrival rule would change", arrival_rule_changes(recording, place))
    print()


def _results(asked: argparse.Namespace) -> None:
    from crowdbench.results import write_results

    with _progress("rollouts") as progress:
        page = write_results(
            asked.scene,
            out=asked.out,
            seeds=asked.seeds,
            workers=asked.workers,
            progress=progress,
        )
    print(f"written to {page} and {page.with_suffix('')}/")


def _ablation(asked: argparse.Namespace) -> None:
    from crowdbench.ablation import write_ablation

    with _progress("fits") as progress:
        page = write_ablation(asked.scene, out=asked.out, workers=asked.workers, progress=progress)
    print(f"written to {page} and {page.with_suffix('')}/")


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
    with _progress("fits") as progress:
        facts = fit_scene(
            scene,
            crowd,
            clustering=asked.clustering,
            models=asked.models,
            out=asked.out,
            workers=asked.workers,
            progress=progress,
        )
    _pairs(scene.id, facts)
    print(f"Next, if arrivals or areas changed: crowdbench anchors {asked.out or asked.scene}")


def _spawn(asked: argparse.Namespace) -> None:
    from crowdbench.scene import load_scene
    from crowdbench.spawn.rescaling import KolmogorovSmirnov
    from crowdbench.spawn_check import check_models

    def ks(found: KolmogorovSmirnov | None) -> str:
        return "" if found is None else f"{found.statistic:.3f} ({found.p:.2g})"

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.3f}"

    found = list(check_models(load_scene(asked.scene)))
    likelihood = _table(
        "nats per person", "full", "held out", "fresh", "persons", "first 25 frames"
    )
    rescaling = _table("KS (p)", "gaps", "group sizes", "own gaps", "own sizes")
    for c in found:
        cells = (c.full, c.heldout, c.fresh, c.persons, c.first)
        likelihood.add_row(c.model, *map(number, cells))
        if c.gaps is not None:
            tests = (c.gaps, c.sizes, c.own_gaps, c.own_sizes)
            rescaling.add_row(c.model, *map(ks, tests))
    console = _console()
    console.print(likelihood)
    print(
        "Log-probability of the persons per area and grid point, means over the fits: of the\n"
        "recording, of each fold by models fitted to the others, of ten fresh hours (where the\n"
        "truth is known). persons: in samples, per recorded one. first 25 frames: per average.\n"
    )
    console.print(rescaling)
    print(
        "Time rescaling: Kolmogorov-Smirnov statistic of the recording's gaps and group sizes\n"
        "under each model, and of ten hours of its own samples; a small p is a misfit.\n"
    )


def _anchors(asked: argparse.Namespace) -> None:
    import tempfile

    from crowdbench.cards import write_anchors
    from crowdbench.evaluation import make_anchors
    from crowdbench.scene import load_scene

    scene = load_scene(asked.scene)
    with tempfile.TemporaryDirectory() as temporary, _progress("rollouts") as progress:
        anchors = make_anchors(
            asked.scene, Path(temporary), workers=asked.workers, progress=progress
        )
    print(f"written to {write_anchors(anchors, scene.folder)}")


def _fetch(asked: argparse.Namespace) -> None:
    from crowdbench.recordings.catalogue import source
    from crowdbench.recordings.fetch import default_folder, fetch

    published = source(asked.name)
    folder = asked.out or default_folder()
    with _progress(asked.name, of_bytes=True) as progress:
        fetched = fetch(asked.name, folder, progress)
    how = f"fetched from {published.address}" if fetched else "already there"
    print(f"{folder / published.path}: {how}")
    _bring(asked.name, folder)


def _import(asked: argparse.Namespace) -> None:
    _bring(asked.name, asked.source)


def _bring(name: str, folder: Path | None) -> None:
    from crowdbench.recordings.catalogue import cached, known_sha256, source
    from crowdbench.recordings.describe import describe
    from crowdbench.registry import import_recording

    first = name != "plaza" and known_sha256(source(name)) is None
    crowd = import_recording(name, folder)
    _pairs(name, describe(crowd) | {"kept at": str(cached(name))})
    if first:
        print(
            f"SHA-256 {crowd.provenance['sha256']} noted at first use; the publisher states none."
        )
    if name != "plaza":
        print(f"It stays under its owners' terms. Cite: {source(name).cite}.")


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
    from crowdbench.files import replacing, write_json

    # That the file can be written is found out before a minute of measuring.
    with replacing(asked.json) if asked.json else nullcontext() as temporary:
        figures = []
        for figure in measure():
            print(f"{figure.name:<44} {figure.text()}", flush=True)
            figures.append(figure)
        if temporary is not None:
            write_json(temporary, {f.name: {"value": f.value, "unit": f.unit} for f in figures})


if __name__ == "__main__":
    sys.exit(main())
