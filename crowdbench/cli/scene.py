"""`crowdbench scene`: create a scene from your own recording, or check a scene."""

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.data import add_mending, fetch_and_import, is_imported, mended
from crowdbench.cli.printing import new_console, new_table, print_facts, progress_bar
from crowdbench.cli.workers import add_engine
from crowdbench.errors import SceneError, SettingError

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.run.rollout_jobs import Progress


def add(commands: "Commands") -> None:
    """Add these commands to the command line."""
    scene = commands.add_parser(
        "scene", help="create a scene from your own recording, or check a scene"
    )
    of_scene = scene.add_subparsers(required=True, metavar="COMMAND")
    create = of_scene.add_parser(
        "create", help="create a scene: areas, models, anchors and scored metrics (minutes)"
    )
    create.add_argument("name", metavar="NAME-v0", help="id of the new scene, lower case")
    create.add_argument(
        "--recording",
        required=True,
        metavar="PATH",
        help="the recording; with --like, the name of one (fetched if it is not imported)",
    )
    create.add_argument(
        "--like",
        metavar="SCENE",
        help="scene of the same place: its bounds, walls and settings are used, for example those "
        "of forum-v0 for --recording forum-14jul",
    )
    create.add_argument(
        "--format",
        metavar="FORMAT",
        help="format of the recording. obsmat: format of ETH and UCY; gc, forum: formats of Grand "
        "Central and the Forum; csv: a table with person_id, frame or time_s, x, y; trajnet: "
        "TrajNet++; jupedsim: format that PedPy reads",
    )
    create.add_argument(
        "--dt-s",
        type=float,
        metavar="SECONDS",
        help="time between two rows of a person; required for obsmat and csv",
    )
    add_mending(create)
    create.add_argument(
        "--walls", type=Path, metavar="FILE", help="wall polygons in GeoJSON or WKT, in metres"
    )
    create.add_argument("--title", default="", help="title of the scene in pictures")
    create.add_argument(
        "--out", type=Path, metavar="DIR", help="folder to create (default: ./NAME-v0)"
    )
    create.add_argument(
        "--fits", type=int, metavar="N", help="ntpp-gmm fits for each split (default: 5)"
    )
    create.add_argument(
        "--rollouts-per-fit",
        type=int,
        metavar="N",
        help="rollouts per fit in the protocol (default: 3 to 10, depending on the length of the "
        "recording)",
    )
    add_engine(create)
    create.set_defaults(run=_create)

    check = of_scene.add_parser("check", help="list the parts of a scene and their problems")
    check.add_argument("scene", help="id of a scene, or its folder")
    check.set_defaults(run=_check)


@contextmanager
def _timed(what: str) -> "Iterator[Progress]":
    began = time.perf_counter()
    with progress_bar(what) as progress:
        yield progress
    print(f"{what:<12} {time.perf_counter() - began:6.1f} s", flush=True)


def _create(args: argparse.Namespace) -> None:
    from crowdbench.data.recordings.describe import describe
    from crowdbench.registry import ANY_PLACE
    from crowdbench.scene import load_scene
    from crowdbench.scene_building import check_new, create_like, create_scene

    shared = {
        "title": args.title,
        "out": args.out,
        "fits": args.fits,
        "rollouts_per_fit": args.rollouts_per_fit,
        "workers": args.workers,
        "stage": _timed,
    }
    if args.like is not None:
        _check_like(args)
        check_new(args.name, args.out or Path(args.name), args.fits, args.rollouts_per_fit)
        load_scene(args.like)  # what is wrong is said before anything is fetched
        if not is_imported(args.recording):
            fetch_and_import(args.recording)
        created = create_like(args.name, args.like, args.recording, **shared)
    else:
        if args.format is None:
            raise SettingError(
                "crowdbench scene create",
                got="neither --format nor --like",
                expected="the format of the recording, or a scene of the same place",
            )
        created = create_scene(
            args.name,
            Path(args.recording),
            layout=args.format,
            dt_s=args.dt_s,
            gaps=args.gaps,
            offset_s=args.offset_s,
            walls=args.walls,
            **shared,
        )
    scene, crowd = created.scene, created.recording
    print()
    print_facts(f"recording {crowd.scene}", mended(crowd, args) | describe(crowd))
    print_facts(scene.id, created.facts)
    whole = (scene.folder / "ntpp-gmm.safetensors").exists()
    models = f"--policy social-force {ANY_PLACE}" + ("" if whole else " --spawn renewal-gmm")
    print(f"Check place.png and time.png there. Next: crowdbench evaluate {scene.asked} {models}")
    if not whole:
        print('This scene has no ntpp-gmm, the default of environments: pass spawn="renewal-gmm".')


def _check_like(args: argparse.Namespace) -> None:
    for option in ("format", "dt_s", "gaps", "offset_s", "walls"):
        if getattr(args, option) is not None:
            name = f"--{option.replace('_', '-')}"
            raise SettingError(
                "crowdbench scene create",
                got=f"{name} and --like",
                expected=f"--like without {name}, which the other scene determines",
            )


def _check(args: argparse.Namespace) -> None:
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
        raise SceneError(
            args.scene, got=number, expected="none", hint="The problems are listed above."
        )
