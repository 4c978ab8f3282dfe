"""How the command line prints: tables, facts and bars."""

import argparse
import os
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"

_UNLIMITED = 10_000  # characters; tables are as wide as what is in them
_PARAGRAPH = 90


def new_console() -> "Console":
    """The terminal; a file, where lines are as long as they need to be; or as wide as `COLUMNS`."""
    from rich.console import Console

    unlimited = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(highlight=False, width=_UNLIMITED if unlimited else None)


def new_table(*columns: str) -> "Table":
    """An empty table, its first column to the left; that alone is folded where there is no room."""
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
    """Print the first layout whose tables have room without folding anything, else the last.

    Each is tried with two spaces between its columns, then with one.
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
    """Print a paragraph, folded between words."""
    width = min(new_console().width, _PARAGRAPH)
    print(textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False))


def print_facts(title: str, facts: dict[str, str]) -> None:
    """Print facts as `name  value`, one a line."""
    width = max(len(name) for name in facts)
    print(title)
    for name, value in facts.items():
        print(f"  {name:<{width}}  {value}")


@contextmanager
def progress_bar(
    what: str, *, of_bytes: bool = False
) -> "Iterator[Callable[[int, int | None], None]]":
    """A bar that appears with the first call of what this yields: progress(done, total)."""
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),  # it may be a path, which may hold anything
        BarColumn(),
        DownloadColumn() if of_bytes else MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    # Fits take minutes: the speed of the last half minute alone would mostly be unknown.
    bar = Progress(*columns, console=new_console(), speed_estimate_period=600.0)
    task = bar.add_task(what)

    def progress(done: int, total: int | None) -> None:
        bar.start()  # not before everything asked for was found
        bar.update(task, completed=done, total=total)

    try:
        yield progress
    finally:
        if bar.live.is_started:  # else it would print an empty line
            bar.stop()
