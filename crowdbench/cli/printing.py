"""Progress bars and JSON of commands."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from functools import partial
from pathlib import Path

from crowdbench.report.text.terminal import new_console


@contextmanager
def progress_bar(
    what: str, *, of_bytes: bool = False
) -> Iterator[Callable[[int, int | None], None]]:
    """Yield a function progress(done, total); its first call shows the progress bar.

    Other stages of the work in the block, see `crowdbench.progress`, get a bar each, below it.
    """
    from rich import progress as bars

    from crowdbench.progress import heard_by

    columns = (
        bars.TextColumn("{task.description}", markup=False),  # it may be a path with brackets
        bars.BarColumn(),
        bars.DownloadColumn() if of_bytes else bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
        bars.TextColumn("left"),
        bars.TimeRemainingColumn(),
    )
    # Fits take minutes. With the default period of 30 s, the speed would mostly be unknown.
    bar = bars.Progress(*columns, console=new_console(), speed_estimate_period=600.0)
    tasks: dict[str, bars.TaskID] = {}

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


@contextmanager
def json_written(where: str | None) -> Iterator[Callable[[object], None]]:
    """Yield a function that writes its argument as JSON to `where`, which may be None or `-`.

    For `-`, everything else that the block prints goes to standard error.
    """
    import msgspec

    from crowdbench.files import write_json

    if where != "-":
        yield lambda value: None if where is None else write_json(Path(where), value)
        return
    found: list[object] = []
    with redirect_stdout(sys.stderr):
        yield found.append
    for value in found:
        encoded = msgspec.json.encode(value, order="deterministic")
        print(msgspec.json.format(encoded, indent=1).decode())
