"""`crowdbench data`: fetch, import, list, describe and remove recordings."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.cli.printing import (
    new_console,
    new_table,
    print_facts,
    print_fitting,
    print_note,
    progress_bar,
)

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.data.table import Trajectories

GAPS = ("interpolate", "split")
FORMATS = ("obsmat", "gc", "forum", "csv", "trajnet", "jupedsim")


def add(commands: "Commands") -> None:
    """Add this command to the command line."""
    data = commands.add_parser("data", help="fetch, import, list, describe and remove recordings")
    of_data = data.add_subparsers(required=True, metavar="COMMAND")
    fetch = of_data.add_parser("fetch", help="download a published recording and import it")
    fetch.add_argument("name", help="name of a recording (see `crowdbench data list`)")
    fetch.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="download folder, in OpenTraj's layout (default: OpenTraj in $CROWDBENCH_HOME)",
    )
    fetch.set_defaults(run=_fetch)
    bring = of_data.add_parser("import", help="read a recording and store it for later use")
    bring.add_argument(
        "name",
        help="name of a recording (see `crowdbench data list`); with --format, a new name for "
        "your own recording",
    )
    bring.add_argument(
        "--source",
        type=Path,
        metavar="PATH",
        help="folder in OpenTraj's layout (default: $CROWDBENCH_DATA), or your own recording",
    )
    bring.add_argument(
        "--format",
        metavar="FORMAT",
        help=f"format of your own recording: {', '.join(FORMATS)}, or a format of an installed "
        "package (see `crowdbench scene create`)",
    )
    bring.add_argument(
        "--dt-s", type=float, metavar="SECONDS", help="time between two rows of a person"
    )
    add_mending(bring)
    bring.set_defaults(run=_import)
    remove = of_data.add_parser("remove", help="delete an imported recording")
    remove.add_argument("name", help="name of a recording")
    remove.set_defaults(run=_remove)
    listing = of_data.add_parser("list", help="list the known recordings")
    listing.set_defaults(run=_list)
    describe = of_data.add_parser("describe", help="print statistics of a recording")
    describe.add_argument("name", help="name of a recording")
    describe.set_defaults(run=_describe)


def add_mending(command: argparse.ArgumentParser) -> None:
    """Add the options that repair small faults of a recording."""
    command.add_argument(
        "--gaps",
        choices=GAPS,
        help="repair missing rows of a person: interpolate linearly, or split the person into two; "
        "both also interpolate rows that lie between frames (default: reject such files)",
    )
    command.add_argument(
        "--offset-s",
        type=float,
        metavar="SECONDS",
        help="time_s of the first frame of a table (default: 0)",
    )


def _fetch(args: argparse.Namespace) -> None:
    fetch_and_import(args.name, args.out)


def is_imported(name: str) -> bool:
    """Whether a recording is available without its files."""
    from crowdbench.data.recordings.catalogue import cached

    return name == "plaza" or cached(name).exists()


def fetch_and_import(name: str, out: Path | None = None) -> None:
    """Download a published recording and import it, with messages."""
    from crowdbench.data.recordings.catalogue import source
    from crowdbench.data.recordings.fetch import default_folder, fetch

    published = source(name)
    folder = out or default_folder()
    with progress_bar(name, of_bytes=True) as progress:
        fetched = fetch(name, folder, progress)
    how = f"fetched from {published.address}" if fetched else "already there"
    print(f"{folder / published.path}: {how}")
    _bring(name, folder)


def _import(args: argparse.Namespace) -> None:
    from crowdbench.data.recordings.catalogue import cached
    from crowdbench.data.recordings.describe import describe
    from crowdbench.data.recordings.own import import_own
    from crowdbench.errors import SettingError

    mending = {"gaps": args.gaps, "offset_s": args.offset_s}
    if args.format is None:
        given = [option for option, value in mending.items() if value is not None]
        if given:
            raise SettingError(
                "crowdbench data import",
                got=f"--{given[0].replace('_', '-')} without --format",
                expected="--format as well",
                hint="The option applies to your own recordings only.",
            )
        _bring(args.name, args.source)
        return
    if args.source is None:
        raise SettingError(
            "crowdbench data import", got="--format without --source", expected="--source PATH"
        )
    crowd = import_own(args.name, args.source, args.format, args.dt_s, **mending)
    facts = mended(crowd, args) | describe(crowd) | {"stored at": str(cached(args.name))}
    print_facts(args.name, facts)


def mended(crowd: "Trajectories", args: argparse.Namespace) -> dict[str, str]:
    """Repairs made by `--gaps`, as a fact to print; empty if the option was not given."""
    notes = crowd.provenance.get("notes", {})
    return {} if args.gaps is None else {"mended": notes.get("mended", "nothing; no faults found")}


def _remove(args: argparse.Namespace) -> None:
    from crowdbench.data.recordings.catalogue import remove_imported

    print(f"{remove_imported(args.name)}: removed")


def _bring(name: str, folder: Path | None) -> None:
    from crowdbench.data.recordings.catalogue import cached, known_sha256, source
    from crowdbench.data.recordings.describe import describe
    from crowdbench.registry import import_recording

    first = name != "plaza" and known_sha256(source(name)) is None
    crowd = import_recording(name, folder)
    print_facts(name, describe(crowd) | {"stored at": str(cached(name))})
    if first:
        print(
            f"SHA-256 {crowd.provenance['sha256']} stored at first use; the publisher states none."
        )
    if name != "plaza":
        print(f"The recording remains subject to its owners' terms. Cite: {source(name).cite}.")


def _list(args: argparse.Namespace) -> None:
    from crowdbench.data.recordings.catalogue import COMMIT, OWN_NAME, REPOSITORY, SOURCES, cached
    from crowdbench.registry import RECORDINGS
    from crowdbench.scene import list_scenes, load_scene

    scenes = {load_scene(scene).recording.name: scene for scene in list_scenes()}
    table = new_table("name", "scene", "state", "source")
    for column in table.columns:
        column.justify = "left"
    for name in RECORDINGS:
        state = "imported" if cached(name).exists() else "not imported"
        path = SOURCES[name].path if name in SOURCES else "generated"
        if path == "generated":
            state = "always available"
        table.add_row(name, scenes.get(name, ""), state, path)
    for file in sorted(cached("").parent.glob("*.parquet")):
        if OWN_NAME.fullmatch(file.stem) and file.stem not in RECORDINGS:
            table.add_row(file.stem, scenes.get(file.stem, ""), "imported", "your own")
    print_fitting([[table]], new_console())
    print(f"File paths are those of OpenTraj, {REPOSITORY}/tree/{COMMIT}")
    print_note(
        "`crowdbench data fetch` also accepts other days of the Forum, for example forum-14jul."
    )


def _describe(args: argparse.Namespace) -> None:
    from crowdbench.data.recordings.describe import describe
    from crowdbench.registry import recording

    print_facts(args.name, describe(recording(args.name)))
