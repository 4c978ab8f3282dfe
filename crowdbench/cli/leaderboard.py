"""`crowdbench leaderboard`: verify submissions, build pages, rescore entries, measure limits."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from crowdbench.cli.printing import new_console, new_table, progress_bar
from crowdbench.cli.workers import add_engine, add_workers
from crowdbench.errors import CrowdbenchError, SettingError
from crowdbench.run.parallel import is_local

if TYPE_CHECKING:
    from crowdbench.cli.printing import Commands
    from crowdbench.leaderboard.sandbox.parent import Limits
    from crowdbench.leaderboard.verification.entry import Entry
    from crowdbench.run.rollout_jobs import Progress

Named = TypeVar("Named", Path, str)


def add(commands: "Commands") -> None:
    """Add these commands to the command line."""
    leaderboard = commands.add_parser(
        "leaderboard", help="verify submissions, build the pages, rescore entries, measure limits"
    )
    of_leaderboard = leaderboard.add_subparsers(required=True, metavar="COMMAND")
    _add_verify(of_leaderboard)
    _add_build(of_leaderboard)
    _add_rescore(of_leaderboard)
    _add_limits_of_trips(of_leaderboard)


def _add_verify(commands: "Commands") -> None:
    verify = commands.add_parser(
        "verify", help="roll out and score submissions in a sandbox and write their entries"
    )
    verify.add_argument(
        "submission", nargs="+", type=Path, help="folder of a submission"
    )
    verify.add_argument(
        "--out", type=Path, required=True, metavar="DIR",
        help="output folder of ID.json, ID.run.json and the rollouts (work/)",
    )  # fmt: skip
    add_engine(verify)
    _add_limits(verify)
    verify.set_defaults(run=_verify)


def _add_build(commands: "Commands") -> None:
    build = commands.add_parser("build", help="write the table and the pages of all entries")
    build.add_argument(
        "--root",
        type=Path,
        default=Path("leaderboard"),
        metavar="DIR",
        help="folder of the leaderboard, which contains entries/ (default: leaderboard)",
    )
    build.set_defaults(run=_build)


def _add_rescore(commands: "Commands") -> None:
    rescore = commands.add_parser(
        "rescore",
        help="verify entries again with the current scorer; earlier results stay in the history",
    )
    rescore.add_argument("entry", nargs="*", help="ids of entries (default: all)")
    rescore.add_argument(
        "--reason", required=True, metavar="TEXT", help="reason to state in the entry's history"
    )
    rescore.add_argument(
        "--root", type=Path, default=Path("leaderboard"), metavar="DIR",
        help="folder of entries/ and submissions/ (default: leaderboard)",
    )  # fmt: skip
    rescore.add_argument(
        "--out", type=Path, default=Path("results/leaderboard"), metavar="DIR",
        help="output folder of ID.run.json and the rollouts (default: results/leaderboard)",
    )  # fmt: skip
    add_workers(rescore)
    _add_limits(rescore)
    rescore.set_defaults(run=_rescore)


def _add_limits_of_trips(commands: "Commands") -> None:
    limits = commands.add_parser(
        "limits",
        help="measure how many trips are like recorded ones without copying, and write the limits "
        "of the flag `copied trips`",
    )
    limits.add_argument("scene", nargs="*", help="ids of scenes (default: all)")
    limits.set_defaults(run=_limits_of_trips)


def _add_limits(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--hours",
        type=float,
        default=24.0,
        help="time limit per submission, in hours (default: 24)",
    )
    parser.add_argument(
        "--memory-gib",
        type=float,
        default=12.0,
        help="memory limit per submission, in GiB (default: 12)",
    )


def _limits(args: argparse.Namespace) -> "Limits":
    from crowdbench.leaderboard.sandbox.parent import Limits

    for name in ("hours", "memory_gib"):
        if not 0 < getattr(args, name) < 1e6:
            raise SettingError(
                f"--{name.replace('_', '-')}",
                got=f"{getattr(args, name)}",
                expected="a number above 0",
            )
    return Limits(wall_s=3600 * args.hours, memory_bytes=int(args.memory_gib * 2**30))


def _verify(args: argparse.Namespace) -> None:
    from crowdbench.leaderboard.verification.verify import verify

    limits = _limits(args)
    if not is_local():
        _verify_on_cluster(args, limits)
        return
    made: set[str] = set()

    def one(submission: Path, progress: "Progress") -> "Entry":
        entry, ran = verify(
            submission,
            args.out,
            workers=args.workers,
            limits=limits,
            progress=progress,
            taken=made,
        )
        made.add(entry.id)
        if ran.network != "none":
            print(f"crowdbench: network {ran.network}", file=sys.stderr)
        return entry

    _each(args.submission, one)
    print(f"entries written to {args.out}")


def _verify_on_cluster(args: argparse.Namespace, limits: "Limits") -> None:
    """Verify all submissions at once, each by one process of the cluster."""
    from crowdbench.leaderboard.verification.cluster import verify_each

    refused = []
    with progress_bar("submissions") as progress:
        found = list(
            verify_each(
                args.submission, args.out, workers=args.workers, limits=limits, progress=progress
            )
        )
    for submission, verified in found:
        if isinstance(verified, CrowdbenchError):
            print(f"crowdbench: {verified}", file=sys.stderr)
            refused.append(f"{submission}")
        else:
            print_entry(verified[0])
    _check_refused(refused, len(found))
    print(f"entries written to {args.out}")


def _build(args: argparse.Namespace) -> None:
    from crowdbench.leaderboard.pages import build
    from crowdbench.leaderboard.pages.standings import entry_paths

    written = build(args.root)
    entries = len(entry_paths(args.root / "entries"))
    number = f"{entries} {'entry' if entries == 1 else 'entries'}"
    if shipped := len(written) - 2 - entries:
        number += f" of yours and {shipped} that ship with crowdbench"
    print(f"{number}: written to {args.root}: README.md, index.html and pages/")


def _rescore(args: argparse.Namespace) -> None:
    from crowdbench.leaderboard.verification.rescore import entry_ids, rescore

    limits = _limits(args)

    def one(entry: str, progress: "Progress") -> "Entry":
        return rescore(
            entry,
            args.root,
            reason=args.reason,
            out=args.out,
            workers=args.workers,
            limits=limits,
            progress=progress,
        )

    named = args.entry or entry_ids(args.root)
    if not named:
        raise SettingError(
            f"{args.root}/entries",
            got="no entries",
            expected="at least one",
            hint="Set the folder of the leaderboard with --root.",
        )
    _each(named, one)


def _limits_of_trips(args: argparse.Namespace) -> None:
    from crowdbench.leaderboard.verification.trip_limits import HONEST, measure, trip_limit, write
    from crowdbench.scene import list_scenes, load_scene

    unknown = sorted(set(args.scene) - set(list_scenes()))
    if unknown:
        raise SettingError(
            "leaderboard limits",
            got=f"scene {', '.join(unknown)}",
            expected=f"scenes of crowdbench ({', '.join(list_scenes())})",
        )
    measured = {name: measure(load_scene(name)) for name in args.scene or list_scenes()}
    path = write(measured)
    table = new_table("copied trips", *HONEST, "limit")
    for name, shares in measured.items():
        each = [f"{100 * share:.2f} %" for share in shares.values()]
        table.add_row(name, *each, f"{100 * trip_limit(name):.1f} %")
    new_console().print(table)
    print(f"written to {path}. `crowdbench leaderboard build` flags by these limits.")


def _each(named: Sequence[Named], one: "Callable[[Named, Progress], Entry]") -> None:
    """Process the items in turn; a rejected one does not stop the others."""
    refused = []
    for name in named:
        try:
            with progress_bar(f"{name}") as progress:
                entry = one(name, progress)
        except CrowdbenchError as error:
            if len(named) == 1:
                raise
            print(f"crowdbench: {error}", file=sys.stderr)
            refused.append(f"{name}")
        else:
            print_entry(entry)
    _check_refused(refused, len(named))


def _check_refused(refused: Sequence[str], total: int) -> None:
    if refused:
        raise SettingError(
            "leaderboard",
            got=f"{len(refused)} of {total} rejected ({', '.join(refused)})",
            expected="none",
            hint="The reasons are listed above.",
        )


def print_entry(entry: "Entry") -> None:
    """Print the scores of an entry, its copy index, and what readers should know about them."""
    from crowdbench.leaderboard.pages.standings import View, gate_notes, scores
    from crowdbench.leaderboard.pages.text import copied_share
    from crowdbench.leaderboard.submission.errors import plain
    from crowdbench.leaderboard.verification.trip_limits import trip_limit
    from crowdbench.metrics import FAMILIES
    from crowdbench.report.text.words import interval, number

    families = [f for f in FAMILIES if any(f in s.families for s in entry.scenes.values())]
    copies = ("copied arrivals", "copied trips")
    table = new_table(f"{entry.id} ({entry.status})", *families, "score", *copies)
    found = scores(entry)
    for name, scene in entry.scenes.items():
        copy = scene.copy
        table.add_row(
            name,
            *[number(found.get(View(f, name))) for f in families],
            interval(found.get(View(scene=name))),
            "–" if copy.arrivals is None else f"{copy.arrivals:.2f}",
            copied_share(copy.trips, trip_limit(name)).replace("\u00a0", " "),
        )
    new_console().print(table)
    for name, note in gate_notes(entry).items():
        print(f"{name}: {note}")
    for flag in entry.flags:
        print(f"{flag.what}: {plain(flag.text)}")
