"""Plots of a crowd and its recording, as SVG inside the page."""

from collections.abc import Sequence
from math import ceil, floor, log10

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from crowdbench.leaderboard.verification.entry import Curve
from crowdbench.report.text.words import digits
from studies.site.render import html

_WIDTH, _HEIGHT = 340.0, 200.0  # pixels
_LEFT, _RIGHT, _TOP, _BOTTOM = 44.0, 12.0, 16.0, 38.0
_LABEL = 58.0, 13.0
_PIECE = 30.0
_Corner = tuple[float, float]


def figure(title: str, curve: Curve) -> Markup:
    """A plot as HTML: the recorded and the simulated curve with labels, on axes with units."""
    alt = (
        f"{title}: recorded and simulated {curve.y_label} over {curve.x_label}, from "
        f"{digits(curve.x[0])} to {digits(curve.x[-1])}; highest recorded "
        f"{digits(max(curve.recorded))}, simulated {digits(max(curve.simulated))}."
    )
    x = _Axis(curve.x, _LEFT, _WIDTH - _RIGHT)
    y = _Axis([0.0, *curve.recorded, *curve.simulated], _HEIGHT - _BOTTOM, _TOP)
    bottom, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
    lines = {
        name: np.array([[x(a), y(b)] for a, b in zip(curve.x, values, strict=True)])
        for name, values in (("recorded", curve.recorded), ("simulated", curve.simulated))
    }
    places, legend = _labels(lines["recorded"], lines["simulated"])
    return html(
        "curve.html.j2",
        title=title,
        alt=alt,
        curve=curve,
        width=f"{_WIDTH:g}",
        height=f"{_HEIGHT:g}",
        middle=f"{(_LEFT + right) / 2:g}",
        bottom=f"{_HEIGHT - 4:g}",
        rules="".join(f"M{_LEFT:g} {y(tick):.1f}H{right:g}" for tick in y.ticks),
        marks="".join(f"M{x(tick):.1f} {bottom:g}v4" for tick in x.ticks),
        ticks=[
            *((f"{_LEFT - 5:g}", f"{y(v) + 3.5:.1f}", "end", _number(v)) for v in y.ticks),
            *((f"{x(v):.1f}", f"{bottom + 15:g}", "middle", _number(v)) for v in x.ticks),
        ],
        lines=[*((name, _path(line)) for name, line in lines.items()), *legend],
        names=[
            (name, f"{left + _LABEL[0] / 2:.1f}", f"{top + 10.5:.1f}")
            for name, (left, top) in places.items()
        ],
    )


class _Axis:
    """Maps values to pixels; its ticks are round numbers."""

    def __init__(self, values: Sequence[float], first: float, last: float) -> None:
        """Map the range of `values` to the pixels from `first` to `last`."""
        low, high = min(values), max(values)
        # Entries have four decimals, so smaller ranges are constant curves.
        high = high if high - low > 1e-6 else low + 1.0
        rough = (high - low) / 4
        size = 10.0 ** floor(log10(rough))
        step = next(size * k for k in (1, 2, 5, 10) if size * k >= rough * 0.999)
        nearest = round(high / step) * step
        if 0 < nearest - high < 0.05 * step:  # shares that end at 0.998 get a tick at 1
            high = nearest
        steps = range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)
        self.ticks = [k * step for k in steps]
        self._low, self._per_unit, self._first = low, (last - first) / (high - low), first

    def __call__(self, value: float) -> float:
        return self._first + (value - self._low) * self._per_unit


def _number(value: float) -> str:
    return f"{value:.6g}".replace("-", "−")


def _path(line: Float[np.ndarray, "n 2"]) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in line.tolist())


def _labels(
    recorded: Float[np.ndarray, "n 2"], simulated: Float[np.ndarray, "n 2"]
) -> tuple[dict[str, _Corner], list[tuple[str, str]]]:
    """Upper left corners of the labels, each next to its own line and overlapping neither.

    If there is no free place, the labels form a legend, with a piece of each line.
    """
    first = _place(recorded, simulated, None)
    second = _place(simulated, recorded, first)
    if first is not None and second is not None:
        return {"recorded": first, "simulated": second}, []
    left, top = _corner([recorded, simulated])
    places = {"recorded": (left + _PIECE, top), "simulated": (left + _PIECE, top + _LABEL[1])}
    pieces = [(name, f"M{left:g} {at + 6.5:g}h{_PIECE - 6:g}") for name, (_, at) in places.items()]
    return places, pieces


def _place(
    own: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "n 2"], taken: _Corner | None
) -> _Corner | None:
    """Upper left corner of a label: next to its own line and far from the other one.

    None if there is no free place.
    """
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
    """Upper left corner of the legend: in a corner without lines, if there is one."""
    size = (_PIECE + _LABEL[0], 2 * _LABEL[1])
    right, bottom = _WIDTH - _RIGHT - size[0], _HEIGHT - _BOTTOM - size[1] - 4
    corners = [(right, _TOP + 4), (right, bottom), (_LEFT + 6, _TOP + 4), (_LEFT + 6, bottom)]
    free = [at for at in corners if not any(_crosses(line, at, size) for line in lines)]
    return [*free, corners[1]][0]


def _crosses(
    line: Float[np.ndarray, "n 2"], at: _Corner, size: tuple[float, float] = _LABEL
) -> bool:
    """Whether a line crosses a box of the given size with its upper left corner at `at`."""
    low = np.minimum(line[:-1], line[1:])
    high = np.maximum(line[:-1], line[1:])
    corner = np.array(at)
    return bool(((low < corner + np.array(size) + 2) & (high > corner - 2)).all(axis=1).any())


def _distance(line: Float[np.ndarray, "n 2"], at: _Corner) -> float:
    """Distance (pixels) from a label at `at` to the nearest point of a line."""
    half = np.array(_LABEL) / 2
    return float(np.hypot(*np.maximum(np.abs(line - at - half) - half, 0).T).min())
