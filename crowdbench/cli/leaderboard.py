"""`crowdbench leaderboard`: verify submissions, and score entries again."""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias, TypeVar

from cyclopts import Parameter

from crowdbench.cli.options import EngineName, Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.cli.running import new_app
from crowdbench.errors import CrowdbenchError, SettingError
from crowdbench.report.text.terminal import print_table
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

app = new_app("leaderboard", "Verify submissions, and score entries again.")


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
        out: output folder of ID.json, ID.run.json and the rollouts (work/)
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

    limits = _limits(hours, memory_gib)

    def one(entry: str, progress: "Progress") -> "Entry":
        return rescoring.rescore(
            entry, root, reason=reason, out=out, workers=workers, limits=limits, progress=progress
        )

    named = entries or rescoring.entry_ids(root)
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
    from crowdbench.leaderboard.pages.standings import View, gate_notes, scores
    from crowdbench.leaderboard.pages.text import copied_share
    from crowdbench.leaderboard.submission.errors import plain
    from crowdbench.leaderboard.verification.trip_limits import trip_limit
    from crowdbench.metrics import FAMILIES
    from crowdbench.report.text.words import interval, number

    families = [f for f in FAMILIES if any(f in s.families for s in entry.scenes.values())]
    found = scores(entry)
    rows = [
        (
            name,
            *(number(found.get(View(f, name))) for f in families),
            interval(found.get(View(scene=name))),
            "–" if scene.copy.arrivals is None else f"{scene.copy.arrivals:.2f}",
            copied_share(scene.copy.trips, trip_limit(name)).replace("\u00a0", " "),
        )
        for name, scene in entry.scenes.items()
    ]
    heads = (*families, "score", "copied arrivals", "copied trips")
    print_table(f"{entry.id} ({entry.status})", *heads, rows=rows)
    for name, note in gate_notes(entry).items():
        print(f"{name}: {note}")
    for flag in entry.flags:
        print(f"{flag.what}: {plain(flag.text)}")
