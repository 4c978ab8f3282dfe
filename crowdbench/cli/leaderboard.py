"""`crowdbench leaderboard`: verify submissions, show entries, and score them again."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias, TypeVar

from cyclopts import Parameter

from crowdbench.cli.options import EngineName, Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.cli.running import new_app
from crowdbench.errors import CrowdbenchError, SettingError, did_you_mean
from crowdbench.report.text.terminal import print_facts, print_table
from crowdbench.run.processes import LOCAL

if TYPE_CHECKING:
    from crowdbench.leaderboard.sandbox.parent import Limits
    from crowdbench.leaderboard.verification.entry import Entry
    from crowdbench.run.rollout_jobs import Progress

Named = TypeVar("Named", Path, str)
Hours: TypeAlias = Annotated[float, Parameter(help="time limit per submission, in hours")]
MemoryGiB: TypeAlias = Annotated[
    float, Parameter("--memory-gib", help="memory limit per submission, in GiB")
]

app = new_app("leaderboard", "Verify submissions, show entries, and score them again.")


@app.command
def verify(
    submissions: list[Path],
    /,
    *,
    out: Path,
    workers: Workers = None,
    engine: EngineName = LOCAL,
    hours: Hours = 24.0,
    memory_gib: MemoryGiB = 12.0,
) -> None:
    """Roll out and score submissions in a sandbox and write their entries.

    Args:
        submissions: folders of submissions
        out: output folder of ID.json.gz, ID.run.json and the rollouts (work/)
    """
    from crowdbench.leaderboard.verification import verify as verification
    from crowdbench.leaderboard.verification.cluster import verify_each
    from crowdbench.run.executor import is_local

    limits = _limits(hours, memory_gib)
    if is_local():
        made: set[str] = set()

        def one(submission: Path, progress: "Progress") -> "Entry":
            entry, ran = verification.verify(
                submission, out, workers=workers, limits=limits, progress=progress, taken=made
            )
            made.add(entry.id)
            if ran.network != "none":
                print(f"crowdbench: network {ran.network}", file=sys.stderr)
            return entry

        judged = _in_turn(submissions, one)
    else:  # all at once, each by one process of the cluster
        with progress_bar("submissions") as progress:
            found = list(
                verify_each(submissions, out, workers=workers, limits=limits, progress=progress)
            )
        judged = iter([(path, v if isinstance(v, CrowdbenchError) else v[0]) for path, v in found])
    _print_entries(judged, len(submissions))
    print(f"entries written to {out}")


@app.command
def show(entry: str, /) -> None:
    """Print an entry of the leaderboard.

    Args:
        entry: id of an entry that comes with crowdbench, or an entry's file
    """
    from crowdbench.leaderboard.standings import shipped_leaderboard
    from crowdbench.leaderboard.verification.entry import entry_paths, read_entry
    from crowdbench.leaderboard.verification.soundness import check_entry

    path = Path(entry)
    if not path.is_file():
        shipped = entry_paths(shipped_leaderboard() / "entries")
        if entry not in shipped:
            raise SettingError(
                "leaderboard show",
                got=repr(entry),
                expected=f"a file, or one of {', '.join(shipped)}",
                hint=did_you_mean(entry, shipped),
            )
        path = shipped[entry]
    known = read_entry(path)
    check_entry(known, path)
    print_entry(known)
    _print_details(known)


@app.command
def rescore(
    entries: Sequence[str] = (),
    /,
    *,
    reason: str,
    root: Path = Path("leaderboard"),
    out: Path = Path("results/leaderboard"),
    workers: Workers = None,
    hours: Hours = 24.0,
    memory_gib: MemoryGiB = 12.0,
) -> None:
    """Verify entries again with the current scorer; earlier results stay in the history.

    Args:
        entries: ids of entries (default: all)
        reason: reason to state in the entries' history
        root: folder of entries/ and submissions/
        out: output folder of ID.run.json and the rollouts
    """
    from crowdbench.leaderboard.verification import rescore as rescoring
    from crowdbench.leaderboard.verification.entry import entry_paths

    limits = _limits(hours, memory_gib)

    def one(entry: str, progress: "Progress") -> "Entry":
        return rescoring.rescore(
            entry, root, reason=reason, out=out, workers=workers, limits=limits, progress=progress
        )

    named = entries or list(entry_paths(root / "entries"))
    if not named:
        raise SettingError(
            f"{root}/entries",
            got="no entries",
            expected="at least one",
            hint="Set the folder of the leaderboard with --root.",
        )
    _print_entries(_in_turn(named, one), len(named))


def _limits(hours: float, memory_gib: float) -> "Limits":
    from crowdbench.leaderboard.sandbox.parent import Limits

    for option, value in (("--hours", hours), ("--memory-gib", memory_gib)):
        if not 0 < value < 1e6:
            raise SettingError(option, got=f"{value}", expected="a number above 0")
    return Limits(wall_s=3600 * hours, memory_bytes=int(memory_gib * 2**30))


def _in_turn(
    named: Sequence[Named], one: "Callable[[Named, Progress], Entry]"
) -> Iterator[tuple[Named, "Entry | CrowdbenchError"]]:
    """Process the items in turn; yield the entry of each, or why it is rejected."""
    for name in named:
        judged: Entry | CrowdbenchError
        try:
            with progress_bar(f"{name}") as progress:
                judged = one(name, progress)
        except CrowdbenchError as error:
            judged = error
        yield name, judged


def _print_entries(judged: Iterable[tuple[Named, "Entry | CrowdbenchError"]], total: int) -> None:
    """Print entries; raise an error at the end if some of `total` items were rejected."""
    refused = []
    for name, found in judged:
        if not isinstance(found, CrowdbenchError):
            print_entry(found)
        elif total == 1:
            raise found
        else:
            print(f"crowdbench: {found}", file=sys.stderr)
            refused.append(f"{name}")
    if refused:
        raise SettingError(
            "leaderboard",
            got=f"{len(refused)} of {total} rejected ({', '.join(refused)})",
            expected="none",
            hint="The reasons are listed above.",
        )


def print_entry(entry: "Entry") -> None:
    """Print the scores of an entry, its copy index, and what readers should know about them."""
    from crowdbench.leaderboard.standings import View, gate_notes, scores
    from crowdbench.leaderboard.submission.errors import plain
    from crowdbench.leaderboard.verification.trip_limits import trip_limit
    from crowdbench.metrics import FAMILIES
    from crowdbench.report.text.words import NOTHING, interval, number, share

    families = [f for f in FAMILIES if any(f in s.families for s in entry.scenes.values())]
    found = scores(entry)
    rows = [
        (
            name,
            *(number(found.get(View(f, name))) for f in families),
            interval(found.get(View(scene=name))),
            NOTHING if scene.copy.arrivals is None else f"{scene.copy.arrivals:.2f}",
            NOTHING
            if scene.copy.trips is None
            else f"{share(scene.copy.trips)} (limit {share(trip_limit(name))})",
        )
        for name, scene in entry.scenes.items()
    ]
    heads = (*families, "score", "copied arrivals", "copied trips")
    print_table(f"{entry.id} ({entry.status})", *heads, rows=rows)
    for name, note in gate_notes(entry).items():
        print(f"{name}: {note}")
    for flag in entry.flags:
        print(f"{flag.what}: {plain(flag.text)}")


def _print_details(entry: "Entry") -> None:
    """Print what a submitter declares, and the results of each metric."""
    from crowdbench.leaderboard.submission.errors import plain
    from crowdbench.report.text.words import NOTHING, digits, plainly

    def cell(value: float | None, text: Callable[[float], str] = digits) -> str:
        return NOTHING if value is None else text(value)

    declared = entry.declared
    facts = {
        "track": f"{declared.track}, {declared.kind}, trained: {declared.training.protocol}",
        "authors": ", ".join(declared.authors),
        "link": declared.link,
        "licence": declared.licence,
        "scorer": f"{entry.scorer} (crowdbench {entry.crowdbench})",
    }
    print_facts(plain(declared.name), {name: plain(text) for name, text in facts.items()})
    heads = ("recorded", "simulated", "unit", "distance", "score", "interval")
    for name, scene in entry.scenes.items():
        rows = []
        for metric, found in scene.metrics.items():
            low, high = found.interval or (None, None)
            rows.append(
                (
                    metric,
                    cell(found.recorded),
                    cell(found.simulated),
                    plain(found.unit),
                    cell(found.distance, plainly),
                    cell(found.score, plainly) if found.scored else "not scored",
                    "" if low is None else f"[{cell(low, plainly)}, {cell(high, plainly)}]",
                )
            )
        print_table(f"{name}: {scene.persons} persons", *heads, rows=rows)
    for earlier in entry.history:
        overall = cell(earlier.overall, plainly)
        print(f"scorer {earlier.scorer}: {overall} ({plain(earlier.reason)})")
