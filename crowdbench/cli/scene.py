"""`scene create` and `scene check`: a place of one's own."""

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.data import add_mending, mended
from crowdbench.cli.printing import new_console, new_table, print_facts, progress_bar

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.evaluation.rollout_jobs import Progress


def add(commands: "Commands") -> None:
    """Add them to the command line."""
    scene = commands.add_parser("scene", help="make a scene from a recording of your own, or check")
    of_scene = scene.add_subparsers(required=True, metavar="COMMAND")
    create = of_scene.add_parser(
        "create", help="make a scene: areas, models, anchors and scored metrics (minutes)"
    )
    create.add_argument("name", metavar="NAME-v0", help="the new scene's name, small letters")
    create.add_argument("--recording", type=Path, required=True, metavar="PATH")
    create.add_argument(
        "--format",
        metavar="FORMAT",
        required=True,
        help="obsmat: rows as of ETH and UCY; gc, forum: as of these places; csv: a table with "
        "person_id, frame or time_s, x, y; trajnet: TrajNet++; jupedsim: as PedPy reads it",
    )
    create.add_argument(
        "--dt-s",
        type=float,
        metavar="SECONDS",
        help="from one row of a person to the next; obsmat and csv do not say it themselves",
    )
    add_mending(create)
    create.add_argument(
        "--walls", type=Path, metavar="FILE", help="polygons in GeoJSON or WKT, in metres"
    )
    create.add_argument("--title", default="", help="what the place is called in pictures")
    create.add_argument(
        "--out", type=Path, metavar="DIR", help="the new folder (default: ./NAME-v0)"
    )
    create.add_argument(
        "--fits", type=int, metavar="N", help="fits of ntpp-gmm for each part (default: 5)"
    )
    create.add_argument(
        "--rollouts-per-fit",
        type=int,
        metavar="N",
        help="of the protocol (default: 3 to 10, by the length of the recording)",
    )
    create.add_argument("--workers", type=int, help="processes (default: one per core)")
    create.set_defaults(run=_create)

    check = of_scene.add_parser("check", help="tell what is there of a scene, and what is wrong")
    check.add_argument("scene", help="folder of a scene, or its id")
    check.set_defaults(run=_check)


@contextmanager
def _timed(what: str) -> "Iterator[Progress]":
    began = time.perf_counter()
    with progress_bar(what) as progress:
        yield progress
    print(f"{what:<12} {time.perf_counter() - began:6.1f} s", flush=True)


def _create(args: argparse.Namespace) -> None:
    from crowdbench.recordings.describe import describe
    from crowdbench.scene_building import create_scene

    created = create_scene(
        args.name,
        args.recording,
        layout=args.format,
        dt_s=args.dt_s,
        gaps=args.gaps,
        offset_s=args.offset_s,
        walls=args.walls,
        title=args.title,
        out=args.out,
        fits=args.fits,
        rollouts_per_fit=args.rollouts_per_fit,
        workers=args.workers,
        stage=_timed,
    )
    scene, crowd = created.scene, created.recording
    print()
    print_facts(f"recording {crowd.scene}", mended(crowd, args) | describe(crowd))
    print_facts(scene.id, created.facts)
    whole = (scene.folder / "ntpp-gmm.safetensors").exists()
    models = "" if whole else " --spawn renewal-gmm"
    print(f"Look at place.png and time.png there. Next: crowdbench evaluate {scene.asked}{models}")
    if not whole:
        print('Environments have ntpp-gmm by default; on this scene say spawn="renewal-gmm".')


def _check(args: argparse.Namespace) -> None:
    from crowdbench.errors import SceneError
    from crowdbench.scene_building import check_scene

    findings = list(check_scene(args.scene))
    table = new_table("part", "state")
    table.columns[1].justify, table.columns[1].no_wrap = "left", False
    for finding in findings:
        table.add_row(finding.part, finding.state)
    new_console().print(table)
    problems = [finding.problem for finding in findings if finding.problem is not None]
    for problem in problems:
        print(f"crowdbench: {problem}", file=sys.stderr)
    if problems:
        number = f"{len(problems)} problem{'s' * (len(problems) != 1)}"
        raise SceneError(args.scene, got=number, expected="none", hint="See above.")
