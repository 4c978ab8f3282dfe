"""Scores on the axis that all pages share: 0 is the anchor, 1 the true process on average."""

from collections.abc import Sequence

from crowdbench.report.text.words import NOTHING, plainly
from crowdbench.scoring.score import Score

LOW, HIGH = -0.5, 1.5
"""Ends of the axis; what lies beyond is an arrow."""
WIDE, NARROW = 160, 96  # pixels
_HEIGHT = 12


def ticks(width: int) -> str:
    """The axis' numbers, for above a column of bars."""
    numbers = "".join(f'<text x="{_x(v, width)}" y="9">{v:g}</text>' for v in (0.0, 1.0))
    return (
        f'<svg class="ticks" viewBox="0 0 {width} 11" width="{width}" height="11" '
        f'aria-hidden="true">{numbers}</svg>'
    )


def with_bar(score: Score | None) -> str:
    """Number, interval and a narrow bar."""
    if score is None:
        return NOTHING
    return f"{number(score)}{bar(score.value, score.interval, NARROW)}"


def number(score: Score | None) -> str:
    """Number and interval."""
    if score is None:
        return NOTHING
    return f'<span class="n">{plainly(score.value)}</span>{brackets(score.interval)}'


def brackets(interval: tuple[float, float]) -> str:
    """The interval in small."""
    low, high = map(plainly, interval)
    return f'<span class="i">[{low},&nbsp;{high}]</span>'


def bar(value: float, interval: tuple[float, float], width: int) -> str:
    """A dot with the whiskers of its interval."""
    low, high = interval
    ends = "M4 2.5L.5 6L4 9.5" if low < LOW else ""
    ends += f"M{width - 4} 2.5L{width - 0.5} 6L{width - 4} 9.5" if high > HIGH else ""
    whisker = f'<path class="whisker" d="M{_x(low, width)} 6H{_x(high, width)}{ends}"/>'
    inside = LOW <= value <= HIGH
    dot = f'<circle cx="{_x(value, width)}" cy="6" r="3"/>' if inside else ""
    return _svg(whisker + dot, width, _HEIGHT, "bar")


def no_bar(width: int) -> str:
    """The axis alone."""
    return _svg("", width, _HEIGHT, "bar")


def strip(parts: Sequence[Sequence[float | None]]) -> str:
    """A line of dots for each part, one dot per fit."""
    dots = "".join(
        f'<circle cx="{_x(value, NARROW)}" cy="{4 + 7 * k}" r="2"/>'
        for k, fits in enumerate(parts)
        for value in fits
        if value is not None
    )
    return _svg(dots, NARROW, 7 * len(parts) + 1, "bar strip") if dots else ""


def _x(value: float, width: int) -> str:
    inside = min(max(value, LOW), HIGH)
    return f"{(inside - LOW) / (HIGH - LOW) * width:.1f}".removesuffix(".0")


def _svg(content: str, width: int, height: int, kind: str) -> str:
    # The lines run on beyond the picture, to those of the next row; cells cut them off.
    span = f"-200V{height + 200}"
    lines = f'<path d="M{_x(0.0, width)} {span}"/><path class="one" d="M{_x(1.0, width)} {span}"/>'
    return (
        f'<svg class="{kind}" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" aria-hidden="true">{lines}{content}</svg>'
    )
