"""`python -m studies.remake`, which `make results` runs."""

import sys
from collections.abc import Mapping, Sequence

from crowdbench.cli.running import new_app, run
from crowdbench.errors import SettingError, did_you_mean
from studies.remake import graph
from studies.remake.lock import LOCK, Line, read_lock
from studies.remake.pages import results

app = new_app("make results", "Make the generated files of the repository that are stale.")


@app.default
def remake(*, plan: bool = False, keep: str | None = None, only: Sequence[str] = ()) -> None:
    """Make the generated files of the repository that are stale.

    Args:
        plan: print what would be made and why
        keep: record why changes of code changed nothing
        only: names of results; others are neither made nor kept
    """
    if plan and keep is not None:
        raise SettingError("make results", got="--plan and --keep", expected="one of them")
    if keep is not None and not keep.strip():
        raise SettingError("--keep", got="no reason", expected="why the results are the same")
    if plan and only:
        raise SettingError("make results", got="--plan and --only", expected="one of them")
    declared = results()
    names = [result.name for result in declared]
    for name in only:
        if name not in names:
            hint = did_you_mean(name, names)
            raise SettingError("--only", got=name, expected="names that --plan prints", hint=hint)
    if plan:
        lines = read_lock(LOCK)
        _print(graph.plan(declared, lines), lines)
    elif keep is not None:
        kept = graph.keep(declared, LOCK, keep, only)
        print(f"kept {len(kept)} results: {', '.join(kept)}")
    else:
        graph.make(declared, LOCK, lambda text: print(text, flush=True), only)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is stale, or say what it is; returns the exit code."""
    return run(app, arguments)


def _print(steps: Mapping[str, tuple[list[str], list[str]]], lines: Mapping[str, Line]) -> None:
    known = []
    for name, (reasons, after) in steps.items():
        cpu_s = lines[name].cpu_s if name in lines else None
        known += [] if cpu_s is None else [cpu_s]
        cost = "CPU time unknown" if cpu_s is None else f"{cpu_s / 60:.1f} CPU minutes"
        why = ", ".join(reasons) or f"if {' or '.join(after)} changes"
        print(f"{name} ({cost}): {why}")
    if steps:
        total = f"{sum(known) / 60:.1f} CPU minutes, and {len(steps) - len(known)} unknown times"
        print(f"{len(steps)} to make: {total}")
    else:
        print("nothing to make")


if __name__ == "__main__":
    sys.exit(main())
