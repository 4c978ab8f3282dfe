"""How the command line prints: tables, facts and bars."""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def new_console(width: int = 100) -> "Console":
    """A console that is so wide where it is a pipe."""
    from rich.console import Console

    # A pipe has no width; tables need about this much.
    return Console(highlight=False, width=None if sys.stdout.isatty() else width)


def new_table(*columns: str) -> "Table":
    """An empty table, its first column to the left."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", overflow="fold")
    return table


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
        TextColumn(what),
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
