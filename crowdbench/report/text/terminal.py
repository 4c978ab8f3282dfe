"""Text for the terminal: tables, facts and notes that fit its width."""

import os
import sys
import textwrap
from collections.abc import Collection, Iterable, Sequence
from itertools import product

from rich import box
from rich.console import Console
from rich.table import Table

_UNLIMITED = 10_000  # characters; wider than any table
_PARAGRAPH = 90


def new_console() -> Console:
    """Console as wide as the terminal or `COLUMNS`; unlimited if the output goes to a file."""
    unlimited = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(highlight=False, width=_UNLIMITED if unlimited else None)


def new_table(
    *columns: str, rows: Iterable[Sequence[str]] = (), left: Collection[str] = ()
) -> Table:
    """Table whose first column is left-aligned, like those in `left`, and may be folded."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column(columns[0], overflow="fold")
    for column in columns[1:]:
        table.add_column(column, justify="left" if column in left else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def print_table(*columns: str, rows: Iterable[Sequence[str]], left: Collection[str] = ()) -> None:
    """Print a `new_table`."""
    new_console().print(new_table(*columns, rows=rows, left=left))


def print_fitting(layouts: Iterable[Sequence[Table]], console: Console) -> None:
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
