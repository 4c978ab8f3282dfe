"""What goes wrong in classes of the user's own, told in one line."""

import os
import sysconfig
import traceback
from pathlib import Path

_OURS = Path(__file__).parent
_LIBRARIES = tuple(
    Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib", "platlib")
)


def told(error: BaseException) -> str:
    """An error's type and message, and the line of the user's code that led to it."""
    message = " ".join(str(error).split())[:300]
    named = f"{type(error).__name__}: {message}" if message else type(error).__name__
    frame = _frame(traceback.extract_tb(error.__traceback__))
    if isinstance(error, SyntaxError) and error.filename:
        return f"{type(error).__name__}: {error.msg} ({_short(error.filename)}:{error.lineno})"
    return f"{named} ({_short(frame.filename)}:{frame.lineno}, {frame.name})" if frame else named


def _frame(frames: traceback.StackSummary) -> traceback.FrameSummary | None:
    """The innermost frame of the user's code, or what is nearest to that."""
    foreign = [f for f in frames if not _within(f.filename, _OURS) and os.path.isabs(f.filename)]
    theirs = [f for f in foreign if not any(_within(f.filename, place) for place in _LIBRARIES)]
    return next(reversed(theirs or foreign or list(frames)), None)


def _within(file: str, folder: Path) -> bool:
    return Path(file).is_relative_to(folder)


def _short(file: str) -> str:
    """As seen from where the user stands."""
    here = Path.cwd()
    return str(Path(file).relative_to(here)) if _within(file, here) else file
