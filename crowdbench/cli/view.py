"""`crowdbench view`: show a crowd in the viewer."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.data.table import Trajectories
    from crowdbench.scene import Scene


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    view = commands.add_parser("view", help="show a crowd in the rerun viewer")
    view.add_argument(
        "table",
        type=Path,
        metavar="ROLLOUT.parquet",
        help="a rollout; with --scene any CSV or Parquet with person_id, frame (or time_s), x, y",
    )
    view.add_argument(
        "--against",
        metavar="recording|TABLE",
        help="crowd to show next to it on the same clock: the scene's recording, or another table",
    )
    view.add_argument(
        "--scene", help="id of a scene, or its folder (default: the scene stated in the rollout)"
    )
    view.add_argument(
        "--person", type=int, metavar="ID", help="show the rays of this person's observation"
    )
    view.add_argument(
        "--save",
        type=Path,
        metavar="FILE.rrd",
        help="write a file for `rerun FILE.rrd` instead of opening the viewer",
    )
    view.set_defaults(run=_view)


def _view(args: argparse.Namespace) -> None:
    from crowdbench.data.storage import read_own
    from crowdbench.scene import load_scene
    from crowdbench.viewer import save, show

    if args.scene is None:
        crowd = read_own(args.table)
        scene = load_scene(crowd.scene)
    else:
        scene = load_scene(args.scene)
        crowd = _read(args.table, scene)
    against = None if args.against is None else _against(args.against, scene)
    if args.save:
        save(crowd, scene, args.save, against=against, person=args.person)
        print(f"written to {args.save}: open it with `rerun {args.save}`")
    else:
        show(crowd, scene, against=against, person=args.person)


def _against(named: str, scene: "Scene") -> "Trajectories":
    from crowdbench.registry import recording_of

    return recording_of(scene) if named == "recording" else _read(Path(named), scene)


def _read(path: Path, scene: "Scene") -> "Trajectories":
    from crowdbench.data.storage import read
    from crowdbench.viewer.place import areas_of

    crowd = read(path, scene=scene.id, dt_s=scene.dt_s)
    areas = areas_of(scene)  # people are coloured by area; tables of other programs have none
    return crowd if areas is None else areas.assign(crowd)
