"""The picture of arrival rates: persons per minute, as fitted and under a scenario."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from crowdbench.colours import COLOURS
from crowdbench.report.plots.canvas import picture
from crowdbench.report.steering.changes import Steering, total
from crowdbench.spawn import SpawnEvents
from crowdbench.spawn.steering.scenario import Number, Profile

if TYPE_CHECKING:
    from matplotlib.axes import Axes

USUAL, STEERED = "0.5", COLOURS[1]
_BINS_S = (10, 20, 30, 60, 120, 300, 600, 900, 1800, 3600)
_MOST_BINS = 50
_MOST_PANELS = 8


def rates_picture(found: Steering) -> bytes:
    """Bytes of a picture with a panel per changed or added spawn area, and one for all others."""
    touched = found.touched[:_MOST_PANELS]
    horizon_s = found.scene.horizon_s
    bin_s = next((b for b in _BINS_S if horizon_s / b <= _MOST_BINS), _BINS_S[-1])
    edges = np.append(np.arange(0, horizon_s, bin_s), horizon_s)

    def draw(axes: "list[Axes]") -> None:
        for axis, area in zip(axes, touched, strict=False):
            _panel(axis, found, [area], edges)
            _asked(axis, found, area)
            added = area >= len(found.areas.spawn)
            axis.set_title(f"spawn area {area}{' (added)' if added else ''}", fontsize=9)
        others = sorted(set(range(found.spawn_areas)) - set(touched))
        _panel(axes[-1], found, others, edges)
        axes[-1].set_title(f"the other {len(others)} spawn areas together", fontsize=9)
        axes[-1].set(xlabel=f"time (s), in steps of {bin_s} s", xlim=(0, horizon_s))
        figure = axes[0].figure
        figure.supylabel("persons per minute", fontsize=9)
        figure.suptitle(
            f"{found.scenario.name} on {found.scene.id}: mean of {len(found.usual)} episodes",
            x=0.01, ha="left",
        )  # fmt: skip
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)

    rows = len(touched) + 1
    return picture(draw, width=7.0, height=1.45 * rows + 0.9, rows=rows, kind="small png")


def _panel(axis: "Axes", found: Steering, areas: list[int], edges: Float[np.ndarray, " b"]) -> None:
    usual = _per_minute(found.usual_events, areas, edges)
    steered = _per_minute(found.steered_events, areas, edges)
    axis.stairs(usual, edges, color=USUAL, fill=True, alpha=0.45, label="as fitted")
    axis.stairs(steered, edges, color=STEERED, linewidth=1.3, label="steered")
    top = 1.15 * max(0.1, *usual, *steered)
    axis.set_ylim(-0.03 * top, top)  # so that a line at 0 is visible


def _per_minute(
    events: list[SpawnEvents], areas: list[int], edges: Float[np.ndarray, " b"]
) -> Float[np.ndarray, " n"]:
    """Persons per minute in each bin, means over the seeds."""
    each = [_counts(e.time_s[np.isin(e.spawn_area, areas)], edges) for e in events]
    per_minute: np.ndarray = 60 * np.mean(each, axis=0) / np.diff(edges)
    return per_minute


def _counts(
    time_s: Float[np.ndarray, " n"], edges: Float[np.ndarray, " b"]
) -> Int[np.ndarray, " m"]:
    return np.histogram(time_s, edges)[0]


def _asked(axis: "Axes", found: Steering, area: int) -> None:
    """Draw the requested rate: the mean fitted rate times the factor, or an added area's rate."""
    horizon_s, number = found.scene.horizon_s, len(found.areas.spawn)
    profile: Profile
    if area >= number:
        profile, before, unit = found.scenario.add[area - number].persons_per_min, 0.0, 1.0
    else:
        profile = next(c.factor for c in found.scenario.change if c.area == area)
        before = 1.0
        unit = float(_per_minute(found.usual_events, [area], np.array([0.0, horizon_s]))[0])
    steps = [0.0, *([] if isinstance(profile, Number) else [t for t, _ in profile]), horizon_s]
    edges = np.unique([t for t in steps if t <= horizon_s])
    ends = np.array([total(profile, before, float(t)) for t in edges[1:]])
    asked = unit * np.diff(ends, prepend=0.0) / np.diff(edges)
    axis.stairs(asked, edges, color="black", linestyle="--", linewidth=1.0, baseline=None,
                label="asked for")  # fmt: skip
