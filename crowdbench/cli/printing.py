"""Printing for the command line: tables, facts, notes and progress bars."""

import argparse
import os
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"

_UNLIMITED = 10_000  # characters; wider than any table
_PARAGRAPH = 90


def new_console() -> "Console":
    """Console as wide as the terminal or `COLUMNS`; unlimited if the output goes to a file."""
    from rich.console import Console

    unlimited = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(highlight=False, width=_UNLIMITED if unlimited else None)


def new_table(*columns: str) -> "Table":
    """Empty table. The first column is left-aligned and the only one that may be folded."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for k, column in enumerate(columns):
        if k == 0:
            table.add_column(column, overflow="fold")
        else:
            table.add_column(column, justify="right", no_wrap=True)
    return table


def print_fitting(layouts: "Iterable[Sequence[Table]]", console: "Console") -> None:
    """Print the first layout whose tables fit the console without folding, else the last layout.

    Each layout is tried with two spaces between columns, then with one.
    """
    unlimited = console.options.update(width=_UNLIMITED)
    for tables, padding in product(layouts, (1, 0)):
        for table in tables:
            table.padding = (0, padding)
        needed = max(console.measure(table, options=unlimited).maximum for table in tables)
        if needed <= console.width:
            break
    for table in tables:
        console.print(table)


def print_note(text: str) -> None:
    """Print a paragraph, wrapped between words."""
    width = min(new_console().width, _PARAGRAPH)
    print(textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False))


def print_facts(title: str, facts: dict[str, str]) -> None:
    """Print a title and one line `name  value` per fact."""
    width = max(len(name) for name in facts)
    print(title)
    for name, value in facts.items():
        print(f"  {name:<{width}}  {value}")


@contextmanager
def progress_bar(
    what: str, *, of_bytes: bool = False
) -> "Iterator[Callable[[int, int | None], None]]":
    """Yield a function progress(done, total); its first call shows the progress bar.

    Other stages of the work in the block, see `crowdbench.progress`, get a bar each, below it.
    """
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        MofNCompleteColumn,
        Progress,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from crowdbench.progress import heard_by

    columns = (
        TextColumn("{task.description}", markup=False),  # it may be a path with brackets
        BarColumn(),
        DownloadColumn() if of_bytes else MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    # Fits take minutes. With the default period of 30 s, the speed would mostly be unknown.
    bar = Progress(*columns, console=new_console(), speed_estimate_period=600.0)
    tasks: dict[str, TaskID] = {}

    def listen(stage: str, done: int, total: int | None) -> None:
        bar.start()  # not earlier, because errors in the arguments are reported first
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=total)
        elif done == 0:  # a stage that occurs again, for another scene or protocol
            bar.reset(tasks[stage], total=total)
        bar.update(tasks[stage], completed=done, total=total)

    try:
        with heard_by(listen):
            yield partial(listen, what)
    finally:
        if bar.live.is_started:  # otherwise it would print an empty line
            bar.stop()


def add_json_option(command: argparse.ArgumentParser) -> None:
    """Add the option `--json` to a command that computes scores."""
    command.add_argument(
        "--json",
        metavar="FILE",
        help="also write the scores as JSON, or print nothing but JSON (-)",
    )


@contextmanager
def json_written(where: str | None) -> "Iterator[Callable[[object], None]]":
    """Yield a function that writes its argument as JSON to `where`, which may be None or `-`.

    For `-`, everything else that the block prints goes to standard error.
    """
    import contextlib

    import msgspec

    from crowdbench.files import write_json

    if where != "-":
        yield lambda value: None if where is None else write_json(Path(where), value)
        return
    found: list[object] = []
    with contextlib.redirect_stdout(sys.stderr):
        yield found.append
    for value in found:
        encoded = msgspec.json.encode(value, order="deterministic")
        print(msgspec.json.format(encoded, indent=1).decode())
