"""Bars of scores on one axis for all pages: 0 is the anchor, 1 a perfect model's expected score."""

from collections.abc import Mapping, Sequence

from markupsafe import Markup

LOW, HIGH = -0.5, 1.5
"""Ends of the axis; arrows mark intervals that extend beyond."""
WIDE, NARROW = 160, 96  # pixels
_HEIGHT = 12


def ticks(width: int) -> Markup:
    """The numbers of the axis as SVG, for the head of a column of bars."""
    numbers = "".join(f'<text x="{_x(v, width)}" y="9">{v:g}</text>' for v in (0.0, 1.0))
    return Markup(
        f'<svg class="ticks" viewBox="0 0 {width} 11" width="{width}" height="11" '
        f'aria-hidden="true">{numbers}</svg>'
    )


def bar(value: float, interval: tuple[float, float], width: int) -> Markup:
    """A score as SVG: a dot, with its interval as whiskers."""
    low, high = interval
    ends = "M4 2.5L.5 6L4 9.5" if low < LOW else ""
    ends += f"M{width - 4} 2.5L{width - 0.5} 6L{width - 4} 9.5" if high > HIGH else ""
    whisker = f'<path class="whisker" d="M{_x(low, width)} 6H{_x(high, width)}{ends}"/>'
    inside = LOW <= value <= HIGH
    dot = f'<circle cx="{_x(value, width)}" cy="6" r="3"/>' if inside else ""
    return _svg(whisker + dot, width, _HEIGHT, "bar")


def no_bar(width: int) -> Markup:
    """The empty axis as SVG."""
    return _svg("", width, _HEIGHT, "bar")


def strip(fits: Mapping[str, Sequence[float | None]], splits: Sequence[str]) -> Markup:
    """The scores of fits as SVG: a row per split, a dot per fit. Empty if there are no scores."""
    dots = "".join(
        f'<circle cx="{_x(value, NARROW)}" cy="{4 + 7 * k}" r="2"/>'
        for k, split in enumerate(splits)
        for value in fits.get(split, ())
        if value is not None
    )
    return _svg(dots, NARROW, 7 * len(splits) + 1, "bar strip") if dots else Markup()


def _x(value: float, width: int) -> str:
    inside = min(max(value, LOW), HIGH)
    return f"{(inside - LOW) / (HIGH - LOW) * width:.1f}".removesuffix(".0")


def _svg(content: str, width: int, height: int, kind: str) -> Markup:
    # The lines extend beyond the picture to meet those of the next row; cells clip them.
    span = f"-200V{height + 200}"
    lines = f'<path d="M{_x(0.0, width)} {span}"/><path class="one" d="M{_x(1.0, width)} {span}"/>'
    return Markup(
        f'<svg class="{kind}" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" aria-hidden="true">{lines}{content}</svg>'
    )
