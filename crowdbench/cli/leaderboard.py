"""`crowdbench leaderboard`: verify submissions and show entries."""

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import Parameter

from crowdbench.cli.options import EngineName, Workers
from crowdbench.cli.printing import progress_bar
from crowdbench.cli.running import new_app
from crowdbench.errors import CrowdbenchError, SettingError
from crowdbench.progress import heard_by
from crowdbench.report.text.terminal import print_facts, print_table
from crowdbench.run.processes import LOCAL

if TYPE_CHECKING:
    from crowdbench.leaderboard.sandbox.parent import Limits
    from crowdbench.leaderboard.verification.entry import Entry

app = new_app("leaderboard", "Verify submissions and show entries.")


@Parameter(name="*")
@dataclass(frozen=True)
class SandboxLimits:
    """Limits of a submission's verification, as options of a command."""

    hours: float = 24.0
    """time limit per submission, in hours"""
    memory_gib: float = 12.0
    """memory limit per submission, in GiB"""

    def checked(self) -> "Limits":
        """The limits of a sandbox.

        Raises:
            SettingError: one of them is out of range.
        """
        from crowdbench.leaderboard.sandbox.parent import Limits

        for option, value in (("--hours", self.hours), ("--memory-gib", self.memory_gib)):
            if not 0 < value < 1e6:
                raise SettingError(option, got=f"{value}", expected="a number above 0")
        return Limits(wall_s=3600 * self.hours, memory_bytes=int(self.memory_gib * 2**30))


@app.command
def verify(
    submissions: list[Path],
    /,
    *,
    out: Path,
    workers: Workers = None,
    engine: EngineName = LOCAL,
    exam: bool = False,
    replace: bool = False,
    key: str = "",
    at_most: SandboxLimits = SandboxLimits(),
) -> None:
    """Roll out and score submissions in a sandbox and write their entries.

    Args:
        submissions: folders of submissions
        exam: also put their policies through the exam (some minutes; it does not rank)
        replace: overwrite entries with the same ids by the same authors
        key: key of the perturbed arrivals, as in an entry that is verified again (default: a secret
            one, which is written into the entry)
        out: output folder of ID.json.gz, ID.run.json and the rollouts (work/)
    """
    from crowdbench.leaderboard.verification import verify as verification
    from crowdbench.run.executor import is_local

    limits = at_most.checked()
    found: dict[str, verification.Verified | CrowdbenchError] = {}
    if not is_local():  # all at once, each by one process of the cluster
        with progress_bar("submissions"):
            each = verification.verify_each(
                submissions, out, workers=workers, limits=limits, exam=exam, replace=replace
            )
            found = {f"{submission}": verified for submission, verified in each}
    made: set[str] = set()

    def one(submission: str) -> "Entry":
        verified = found.get(submission) or verification.verify(
            Path(submission),
            out,
            workers=workers,
            limits=limits,
            taken=made,
            exam=exam,
            replace=replace,
            key=_checked_key(key),
        )
        if isinstance(verified, CrowdbenchError):
            raise verified
        entry, ran = verified
        made.add(entry.id)
        if ran.network != "none":
            print(f"crowdbench: network {ran.network}", file=sys.stderr)
        if ran.files != "isolated":
            print(f"crowdbench: files {ran.files}", file=sys.stderr)
        return entry

    in_turn([f"{submission}" for submission in submissions], one)
    print(f"entries written to {out}")


@app.command
def show(entry: str, /) -> None:
    """Print an entry of the leaderboard.

    Args:
        entry: id of an entry that comes with crowdbench, or an entry's file
    """
    from crowdbench.leaderboard.verification import entry as entries
    from crowdbench.leaderboard.verification.soundness import check_entry

    path = Path(entry)
    if not path.is_file():
        shipped = entries.shipped_leaderboard() / "entries"
        path = entries.find_entry(entry, shipped, otherwise="a file, or ")
    known = entries.read_entry(path)
    check_entry(known, path)
    print_entry(known)
    _print_details(known)


def _checked_key(key: str) -> str:
    if not re.fullmatch("[0-9a-f]{0,32}", key):
        raise SettingError("--key", got=repr(key), expected="up to 32 digits of 0-9a-f")
    return key


def in_turn(names: Sequence[str], one: "Callable[[str], Entry]") -> None:
    """Process the items in turn and print their entries; at the end, raise if any was rejected."""
    refused = []
    for name in names:
        try:
            # Each bar of rollouts has the name of its submission.
            with progress_bar(name) as bar, heard_by(lambda _, *steps, bar=bar: bar(*steps)):
                entry = one(name)
        except CrowdbenchError as error:
            if len(names) == 1:
                raise
            print(f"crowdbench: {error}", file=sys.stderr)
            refused.append(name)
        else:
            print_entry(entry)
    if refused:
        got = f"{len(refused)} of {len(names)} rejected ({', '.join(refused)})"
        hint = "The reasons are listed above."
        raise SettingError("leaderboard", got=got, expected="none", hint=hint)


def print_entry(entry: "Entry") -> None:
    """Print the scores of an entry, its copy index, and what readers should know about them."""
    from crowdbench.leaderboard.scores import View, gate_notes, scores
    from crowdbench.leaderboard.submission.errors import plain
    from crowdbench.leaderboard.verification.flags import trip_limit
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
        rows = [
            (
                metric,
                cell(found.recorded),
                cell(found.simulated),
                plain(found.unit),
                cell(found.distance, plainly),
                cell(found.score, plainly) if found.scored else "not scored",
                f"[{', '.join(map(plainly, found.interval))}]" if found.interval else "",
            )
            for metric, found in scene.metrics.items()
        ]
        print_table(f"{name}: {scene.persons} persons", *heads, rows=rows)
    for earlier in entry.history:
        overall = cell(earlier.overall, plainly)
        print(f"scorer {earlier.scorer}: {overall} ({plain(earlier.reason)})")
