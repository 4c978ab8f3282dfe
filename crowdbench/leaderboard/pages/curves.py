"""Curves: a crowd beside its recording, as SVG inside the page."""

from collections.abc import Sequence
from math import ceil, floor, log10

import numpy as np
from jaxtyping import Float

from crowdbench.leaderboard.pages.text import escaped, in_html
from crowdbench.leaderboard.verification.entry import Curve
from crowdbench.report.text.words import digits

_WIDTH, _HEIGHT = 340.0, 200.0  # pixels
_LEFT, _RIGHT, _TOP, _BOTTOM = 44.0, 12.0, 16.0, 38.0
_LABEL = 58.0, 13.0
_PIECE = 30.0
_Corner = tuple[float, float]


def figure(title: str, curve: Curve) -> str:
    """Both lines with their names, axes with their units."""
    alt = (
        f"{title}: recorded and simulated {curve.y_label} over {curve.x_label}, from "
        f"{digits(curve.x[0])} to {digits(curve.x[-1])}; highest recorded "
        f"{digits(max(curve.recorded))}, simulated {digits(max(curve.simulated))}."
    )
    x = _Axis(curve.x, _LEFT, _WIDTH - _RIGHT)
    y = _Axis([0.0, *curve.recorded, *curve.simulated], _HEIGHT - _BOTTOM, _TOP)
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    return (
        f"<figure><figcaption><b>{in_html(title, 80)}</b></figcaption>"
        f'<svg class="curve" viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" '
        f'aria-label="{escaped(alt)}">{_grid(x, y)}'
        f'<path class="recorded" d="{_line(x, y, curve.x, curve.recorded)}"/>'
        f'<path class="simulated" d="{_line(x, y, curve.x, curve.simulated)}"/>'
        f"{_names(x, y, curve)}"
        f'<text x="{middle:g}" y="{_HEIGHT - 4:g}" text-anchor="middle">'
        f"{escaped(curve.x_label, 50)}</text>"
        f'<text x="2" y="9">{escaped(curve.y_label, 50)}</text></svg></figure>\n'
    )


class _Axis:
    """From values to pixels, over round numbers."""

    def __init__(self, values: Sequence[float], first: float, last: float) -> None:
        """An axis from pixel `first` to pixel `last`."""
        low, high = min(values), max(values)
        # Entries have four decimals; what differs by less cannot be drawn.
        high = high if high - low > 1e-6 else low + 1.0
        rough = (high - low) / 4
        size = 10.0 ** floor(log10(rough))
        step = next(size * k for k in (1, 2, 5, 10) if size * k >= rough * 0.999)
        nearest = round(high / step) * step
        if 0 < nearest - high < 0.05 * step:  # shares that end at 0.998 have a 1
            high = nearest
        steps = range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)
        self.ticks = [k * step for k in steps]
        self._low, self._per_unit, self._first = low, (last - first) / (high - low), first

    def __call__(self, value: float) -> float:
        return self._first + (value - self._low) * self._per_unit


def _grid(x: _Axis, y: _Axis) -> str:
    bottom, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
    rules = "".join(f"M{_LEFT:g} {y(tick):.1f}H{right:g}" for tick in y.ticks)
    marks = "".join(f"M{x(tick):.1f} {bottom:g}v4" for tick in x.ticks)
    numbers = "".join(
        f'<text x="{_LEFT - 5:g}" y="{y(tick) + 3.5:.1f}" text-anchor="end">{_number(tick)}</text>'
        for tick in y.ticks
    ) + "".join(
        f'<text x="{x(tick):.1f}" y="{bottom + 15:g}" text-anchor="middle">{_number(tick)}</text>'
        for tick in x.ticks
    )
    return f'<path class="rule" d="{rules}"/><path class="tick" d="{marks}"/>{numbers}'


def _number(value: float) -> str:
    return f"{value:.6g}".replace("-", "−")


def _line(x: _Axis, y: _Axis, xs: Sequence[float], ys: Sequence[float]) -> str:
    return "M" + "L".join(f"{x(a):.1f} {y(b):.1f}" for a, b in zip(xs, ys, strict=True))


def _names(x: _Axis, y: _Axis, curve: Curve) -> str:
    """The lines' names, each beside its own line and clear of both."""
    lines = {
        name: np.array([[x(a), y(b)] for a, b in zip(curve.x, values, strict=True)])
        for name, values in (("recorded", curve.recorded), ("simulated", curve.simulated))
    }
    first = _place(lines["recorded"], lines["simulated"], None)
    second = _place(lines["simulated"], lines["recorded"], first)
    if first is None or second is None:  # as a key, with a piece of each line
        left, top = _corner(list(lines.values()))
        first, second = (left + _PIECE, top), (left + _PIECE, top + _LABEL[1])
        pieces = "".join(
            f'<path class="{name}" d="M{left:g} {top + 6.5:g}h{_PIECE - 6:g}"/>'
            for name, (_, top) in (("recorded", first), ("simulated", second))
        )
    else:
        pieces = ""
    return pieces + "".join(
        f'<text class="{name}" x="{left + _LABEL[0] / 2:.1f}" y="{top + 10.5:.1f}" '
        f'text-anchor="middle">{name}</text>'
        for name, (left, top) in (("recorded", first), ("simulated", second))
    )


def _place(
    own: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "n 2"], taken: _Corner | None
) -> _Corner | None:
    """Upper left corner of a name: beside its line, and farther from the other one, if possible."""
    width, height = _LABEL
    left, right = _LEFT + 2, _WIDTH - _RIGHT - width
    best: tuple[float, _Corner | None] = (0.0, None)
    for px, py in own[:: max(1, len(own) // 20)].tolist():
        for x, y in (
            (px - width / 2, py - height - 4),
            (px - width / 2, py + 4),
            (px - width - 12, py - height / 2),
            (px + 12, py - height / 2),
        ):
            at = min(max(x, left), right), y
            inside = _TOP - 4 <= y <= _HEIGHT - _BOTTOM - height
            if taken is not None:
                inside &= abs(at[0] - taken[0]) > width or abs(y - taken[1]) > height
            if inside and not (_crosses(own, at) or _crosses(other, at)):
                worth = min(_distance(other, at), 30.0) - _distance(own, at)
                best = max(best, (worth, at), key=lambda one: one[0])
    return best[1]


def _corner(lines: Sequence[Float[np.ndarray, "n 2"]]) -> _Corner:
    """Where a key of both names has room: a corner that no line goes through, if there is one."""
    size = (_PIECE + _LABEL[0], 2 * _LABEL[1])
    right, bottom = _WIDTH - _RIGHT - size[0], _HEIGHT - _BOTTOM - size[1] - 4
    corners = [(right, _TOP + 4), (right, bottom), (_LEFT + 6, _TOP + 4), (_LEFT + 6, bottom)]
    free = [at for at in corners if not any(_crosses(line, at, size) for line in lines)]
    return [*free, corners[1]][0]


def _crosses(
    line: Float[np.ndarray, "n 2"], at: _Corner, size: tuple[float, float] = _LABEL
) -> bool:
    """Whether the line goes through a name there."""
    low = np.minimum(line[:-1], line[1:])
    high = np.maximum(line[:-1], line[1:])
    corner = np.array(at)
    return bool(((low < corner + np.array(size) + 2) & (high > corner - 2)).all(axis=1).any())


def _distance(line: Float[np.ndarray, "n 2"], at: _Corner) -> float:
    """From a name there to the nearest value."""
    half = np.array(_LABEL) / 2
    return float(np.hypot(*np.maximum(np.abs(line - at - half) - half, 0).T).min())
