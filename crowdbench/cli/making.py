"""`fit`, `spawn`, `anchors`, `power`, `results`, `walks` and `ablation`: for who makes a scene."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import new_console, new_table, print_facts, print_note, progress_bar

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands


def add(commands: "Commands") -> None:
    """Add them to the command line."""
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
        default=["poisson-gmm", "poisson-groups", "renewal-gmm", "ntpp-gmm"],
        help="spawn models to fit (default: poisson-gmm poisson-groups renewal-gmm ntpp-gmm)",
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
        "--seeds",
        type=int,
        metavar="N",
        help="rollouts of each crowd (in each fold); fewer than two of each of the scene's fits, "
        "as a rule 10, make no scores (default: the scene's protocol)",
    )
    results.set_defaults(run=_results)

    walks = commands.add_parser(
        "walks", help="write the page on how policies walk on some scenes, with pictures (minutes)"
    )
    walks.add_argument("scenes", nargs="+", metavar="SCENE", help="id of a scene, or its folder")
    walks.add_argument(
        "--policy",
        nargs="+",
        default=[],
        metavar="POLICY",
        help="policies besides random, straight, social-force and those that come with each scene",
    )
    walks.add_argument(
        "--out",
        type=Path,
        default=Path("docs"),
        metavar="DIR",
        help="folder of walks.md and its pictures (default: docs)",
    )
    walks.add_argument("--workers", type=int, help="processes (default: one per core)")
    walks.add_argument(
        "--seeds",
        type=int,
        metavar="N",
        help="rollouts of each policy (in each fold); fewer than two of each of the scene's fits "
        "make no scores of policies that leave anything to chance (default: two of each)",
    )
    walks.set_defaults(run=_walks)

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


def _fit(asked: argparse.Namespace) -> None:
    from crowdbench.registry import recording
    from crowdbench.scene import load_scene
    from crowdbench.scene_building.fit import fit_scene

    scene = load_scene(asked.scene)
    crowd = recording(scene.recording.name)
    with progress_bar("fits") as progress:
        facts = fit_scene(
            scene,
            crowd,
            clustering=asked.clustering,
            models=asked.models,
            out=asked.out,
            workers=asked.workers,
            progress=progress,
        )
    print_facts(scene.id, facts)
    print(f"Next, if arrivals or areas changed: crowdbench anchors {asked.out or asked.scene}")


def _spawn(asked: argparse.Namespace) -> None:
    from crowdbench.scene import load_scene
    from crowdbench.scene_building.spawn_diagnostics import check_models, trained_networks
    from crowdbench.spawn.rescaling import KolmogorovSmirnov

    def ks(found: KolmogorovSmirnov | None) -> str:
        return "" if found is None else f"{found.statistic:.3f} ({found.p:.2g})"

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.3f}"

    scene = load_scene(asked.scene)
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
        "Log-probability of the persons per area and grid point, means over the fits: of the "
        "recording, of each fold by models fitted to the others, of ten fresh hours (where the "
        "truth is known). persons: in samples, per recorded one. first 25 frames: per average."
    )
    console.print(rescaling)
    print_note(
        "Time rescaling: Kolmogorov-Smirnov statistic of the recording's gaps and group sizes "
        "under each model, and of ten hours of its own samples; a small p is a misfit."
    )
    if any(c.model == "ntpp-gmm" for c in found):
        print_note(str(trained_networks(scene)))


def _anchors(asked: argparse.Namespace) -> None:
    from crowdbench.evaluation.evaluate import make_anchors
    from crowdbench.leftovers import temporary_folder
    from crowdbench.scene import load_scene
    from crowdbench.scoring.scorecard import write_anchors

    scene = load_scene(asked.scene)
    with temporary_folder("anchors") as folder, progress_bar("rollouts") as progress:
        anchors = make_anchors(asked.scene, folder, workers=asked.workers, progress=progress)
    print(f"written to {write_anchors(anchors, scene.folder)}")


def _power(asked: argparse.Namespace) -> None:
    from crowdbench.evaluation.evaluate import power_study
    from crowdbench.leftovers import temporary_folder
    from crowdbench.scene import load_scene, write_scored

    scene = load_scene(asked.scene)
    with temporary_folder("power") as folder, progress_bar("rollouts") as progress:
        studies = power_study(asked.scene, folder, progress=progress)
    table = new_table("metric", "floor", "95 %", "anchor", "power", "")
    for s in studies:
        table.add_row(
            s.metric.replace("_", " "),
            f"{s.floor:.3f}",
            f"{s.threshold:.3f}",
            f"{s.anchor:.3f}",
            f"{s.power:.2f}",
            "scored" if s.counts else "",
        )
    new_console().print(table)
    print_note(
        "Energy scores on synthetic recordings: of the true process (floor: mean and 95th "
        "percentile) and of the anchor. power: how often the anchor's lies beyond the percentile; "
        "from 0.8 on a metric is scored, unless the recording knows only one value of it."
    )
    scored = [s.metric for s in studies if s.counts]
    print(f"scored = {scored}".replace("'", '"'))
    if asked.write:
        print(f"written to {write_scored(scene, scored)}")


def _results(asked: argparse.Namespace) -> None:
    from crowdbench.studies.results import write_results

    with progress_bar("rollouts") as progress:
        page = write_results(
            asked.scene,
            out=asked.out,
            seeds=asked.seeds,
            workers=asked.workers,
            progress=progress,
        )
    print(f"written to {page} and {page.with_suffix('')}/")


def _walks(asked: argparse.Namespace) -> None:
    from crowdbench.studies.walks import write_walks

    with progress_bar("rollouts") as progress:
        page = write_walks(
            asked.scenes,
            more=asked.policy,
            out=asked.out,
            seeds=asked.seeds,
            workers=asked.workers,
            progress=progress,
        )
    print(f"written to {page} and {page.with_suffix('')}/")


def _ablation(asked: argparse.Namespace) -> None:
    from crowdbench.studies.ablation import write_ablation

    with progress_bar("fits") as progress:
        page = write_ablation(asked.scene, out=asked.out, workers=asked.workers, progress=progress)
    print(f"written to {page} and {page.with_suffix('')}/")
