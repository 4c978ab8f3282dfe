"""The graph of results: which are stale, why, and how they are made again.

A result is stale if its outputs are missing or changed, or if something that it is made from has
another hash than in the lock. It is made after those whose outputs it reads, and looked at again
then: if these gave the same bytes, it is not made.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

from crowdbench.errors import SettingError
from crowdbench.files import replacing, sha256
from studies.remake.lock import Line, file_hash, read_lock, write_lock

PROGRAMS = {
    "python": [sys.executable],
    "crowdbench": [sys.executable, "-m", "crowdbench"],
    "make": ["make"],
    "peers": [".venv-peers/bin/python", "-m", "examples.peers"],
}

AT_ONCE = 2
"""Number of results that are made at once. A command uses all cores where its work can be shared,
and the second one uses them while the first one cannot."""
AGAIN = "to be made again"
"""Words of a reason to keep a result that does not follow from its inputs any more."""


@dataclass(frozen=True)
class Result:
    """Files that are made from others."""

    name: str
    outputs: tuple[str, ...]
    """Patterns of paths in the repository."""
    commands: tuple[tuple[str, ...], ...]
    stdout: str = ""
    """The file that the last command prints."""
    by_hand: bool = False
    """Whether people copy what the commands print into the output; only its tables count then."""
    files: tuple[str, ...] = ()
    """Paths in the repository."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Hashes of what else it is made from, by name; that of the code is called `code`."""
    headline: Callable[[], dict[str, float]] = dict
    """The numbers that the lock shows."""

    def inputs(self) -> dict[str, str]:
        """Hashes of what it is made from, by name; networks of one folder have one."""
        groups: dict[str, list[str]] = {}
        for file in self.files:
            name = str(Path(file).parent) if file.endswith(".onnx") else file
            groups.setdefault(name, []).append(file)
        return {name: self._hash(each) for name, each in groups.items()} | dict(self.facts)

    def made(self) -> str:
        """Hash of the outputs; empty if one is missing."""
        found = [sorted(str(p) for p in Path().glob(pattern)) for pattern in self.outputs]
        return self._hash([path for each in found for path in each]) if all(found) else ""

    def _hash(self, paths: Sequence[str]) -> str:
        parts = (f"{Path(p).name} {file_hash(Path(p), self.by_hand)}" for p in paths)
        return sha256("\n".join(parts).encode())[:8]


def why_stale(result: Result, line: Line | None) -> list[str]:
    """What differs from the lock; nothing if the result is up to date."""
    if line is None:
        return ["it is not in the lock"]
    now, made = result.inputs(), result.made()
    names = [name for name in now | line.inputs if now.get(name) != line.inputs.get(name)]
    changed = ["its outputs" if made else "missing outputs"] if made != line.outputs else []
    return [*names, *changed]


def ordered(results: Sequence[Result]) -> Iterator[tuple[Result, list[str]]]:
    """The results, each after those whose outputs it reads, with the names of these."""
    maker = {
        path: result.name
        for result in results
        for pattern in result.outputs
        for path in (pattern, *map(str, Path().glob(pattern)))
    }
    needs = {r.name: sorted({maker[f] for f in r.files if f in maker}) for r in results}
    todo, done = {r.name: r for r in results}, set[str]()
    while todo:
        ready = [name for name in todo if done.issuperset(needs[name])]
        if not ready:
            raise SettingError("results", got=f"a circle among {', '.join(todo)}", expected="none")
        for name in ready:
            yield todo.pop(name), needs[name]
            done.add(name)


def plan(
    results: Sequence[Result], lines: Mapping[str, Line]
) -> dict[str, tuple[list[str], list[str]]]:
    """What would be made, in order: the reasons, and the results before it that are made.

    Without a reason it is made only if one of these changes.
    """
    steps: dict[str, tuple[list[str], list[str]]] = {}
    for result, needs in ordered(results):
        reasons = why_stale(result, lines.get(result.name))
        after = [name for name in needs if name in steps]
        if reasons or after:
            steps[result.name] = reasons, after
    return steps


def make(
    results: Sequence[Result],
    lock: Path,
    tell: Callable[[str], None],
    only: Collection[str] = (),
) -> None:
    """Make what is stale (of the names `only`, if there are any), and write the lock after each.

    Two results that do not need each other are made at once. What `tell` says is when one begins.

    Raises:
        SettingError: a command failed, its outputs are missing, or a page is to be written by hand.
            What is being made meanwhile is finished.
    """
    lines, waiting, failures = read_lock(lock), list[str](), list[SettingError]()
    todo = {result.name: (result, needs) for result, needs in ordered(results)}
    making: dict[Future[float], tuple[Result, dict[str, str]]] = {}

    def start(result: Result, needs: Sequence[str]) -> None:
        line, held = lines.get(result.name), [name for name in needs if name in waiting]
        if (only and result.name not in only) or not (reasons := why_stale(result, line)):
            return
        inputs = result.inputs()
        written = line is not None and inputs != line.inputs and result.made() != line.outputs
        if held or (result.by_hand and not written):
            waiting.append(result.name)
            commands = "; ".join(" ".join(command) for command in result.commands)
            by_hand = f"run {commands}, and write its numbers into {result.outputs[0]}"
            tell(f"{result.name}: {f'waits for {held}' if held else by_hand}")
        elif result.by_hand:
            record(result, inputs, None)
        else:
            tell(f"{result.name}: {', '.join(reasons)}")
            making[pool.submit(_run, result)] = result, inputs

    def record(result: Result, inputs: dict[str, str], cpu_s: float | None) -> None:
        if not (made := result.made()):
            raise SettingError(result.name, got="no output", expected=", ".join(result.outputs))
        lines[result.name] = Line(result.name, inputs, made, cpu_s, "", result.headline())
        write_lock(lines, lock)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        while todo or making:
            unmade = todo.keys() | {result.name for result, _ in making.values()}
            ready = [name for name, (_, needs) in todo.items() if unmade.isdisjoint(needs)]
            if ready and len(making) < AT_ONCE:
                start(*todo.pop(ready[0]))
                continue
            for done in wait(making, return_when=FIRST_COMPLETED).done:
                result, inputs = making.pop(done)
                try:
                    record(result, inputs, done.result())
                except SettingError as error:
                    failures.append(error)
                    todo.clear()  # what is being made is finished
    if failures:
        raise failures[0]
    if waiting:
        raise SettingError("results", got=f"not made: {', '.join(waiting)}", expected="none")
    write_lock({r.name: lines[r.name] for r in results if r.name in lines}, lock)


def _run(result: Result) -> float:
    """Run the commands of a result; their CPU time in seconds."""
    cpu_s = 0.0
    for k, command in enumerate(result.commands, 1):
        printing = result.stdout and k == len(result.commands)
        argv = [*PROGRAMS[command[0]], *command[1:]]
        with subprocess.Popen(argv, stdout=subprocess.PIPE if printing else None) as ran:
            printed = ran.stdout.read() if ran.stdout else b""
            _, status, used = os.wait4(ran.pid, 0)  # the times of this process and its workers
            ran.returncode = os.waitstatus_to_exitcode(status)
        cpu_s += used.ru_utime + used.ru_stime
        if ran.returncode:
            raise SettingError(
                result.name,
                got=f"exit code {ran.returncode} of {' '.join(command)}",
                expected="0",
                hint="Its message is above. What was made before is kept.",
            )
        if printing:
            with replacing(Path(result.stdout)) as temporary:
                temporary.write_bytes(printed)
    return round(cpu_s, 1)


def keep(
    results: Sequence[Result], lock: Path, reason: str, only: Collection[str] = ()
) -> list[str]:
    """Record that changes of code changed no result; returns the names of what was recorded.

    With `only`, results with other names stay as they are.

    A result that is not in the lock is recorded too, as made before. What was kept although it is
    to be made again (`AGAIN` in its reason) keeps that reason.

    Raises:
        SettingError: something else than code has changed; then nothing is recorded.
    """
    lines, refused, kept = read_lock(lock), list[str](), list[str]()
    for result in results:
        if only and result.name not in only:
            continue
        line, made = lines.get(result.name), result.made()
        reasons = why_stale(result, line) if line or made else ["missing outputs"]
        if wrong := [name for name in reasons if made == "" or (line and name != "code")]:
            refused.append(f"{result.name} ({', '.join(wrong)})")
        elif reasons:
            cpu_s, numbers = line.cpu_s if line else None, result.headline()
            why = line.kept if line and AGAIN in line.kept else reason
            lines[result.name] = Line(result.name, result.inputs(), made, cpu_s, why, numbers)
            kept.append(result.name)
    if refused:
        raise SettingError(
            "results to keep",
            got=f"other changes: {'; '.join(refused)}",
            expected="changes of code alone",
            hint="`make results` makes these again.",
        )
    write_lock({r.name: lines[r.name] for r in results if r.name in lines}, lock)
    return kept
