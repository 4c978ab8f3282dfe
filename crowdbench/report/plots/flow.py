"""Functions that draw flow, density and speed onto axes."""

from collections.abc import Iterable, Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from crowdbench.colours import COLOURS
from crowdbench.report.flow import Flow, SpeedDensity

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FREE_SPEED_MPS = 1.34
"""Mean speed of people who walk freely (Weidmann 1993), m/s."""
DENSEST_PER_M2 = 5.4
"""Density at which nobody walks any more (Weidmann 1993), people per square metre."""


def weidmann(per_m2: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Speed at a density, m/s: v = v0 (1 − exp(−1.913 (1/ρ − 1/5.4))) with v0 = 1.34 m/s.

    It is v0 where nobody is, and 0 from 5.4 people per m² on. Source: U. Weidmann, Transporttechnik
    der Fussgänger, Schriftenreihe des IVT 90, ETH Zürich (1993).
    """
    with np.errstate(divide="ignore"):
        room = np.maximum(0, 1 / per_m2 - 1 / DENSEST_PER_M2)
    return FREE_SPEED_MPS * (1 - np.exp(-1.913 * room))


def plot_n_t(
    axis: "Axes", flows: Mapping[str, Flow], styles: Mapping[str, Mapping[str, Any]] | None = None
) -> None:
    """Draw how many people have crossed a line until each time.

    Args:
        axis: Where to draw. Lines have labels; the legend is the caller's.
        flows: Crowds by label, drawn in this order.
        styles: Arguments of matplotlib's `plot` by label; by default, a colour for each.
    """
    for (label, flow), colour in zip(flows.items(), cycle(COLOURS), strict=False):
        time_s = np.r_[0.0, flow.crossed_s, flow.duration_s]
        people = np.r_[np.arange(len(flow.crossed_s) + 1), len(flow.crossed_s)]
        style = (styles or {}).get(label, {"color": colour})
        axis.step(time_s, people, where="post", label=label, **{"linewidth": 1.3, **style})
    longest = max((flow.duration_s for flow in flows.values()), default=1.0)
    axis.set(xlim=(0, longest), ylim=(0, None))
    axis.set(xlabel="time (s)", ylabel="people who have crossed")


def plot_speed_density(
    axis: "Axes",
    clouds: Mapping[str, SpeedDensity],
    styles: Mapping[str, Mapping[str, Any]] | None = None,
) -> None:
    """Draw speed over density, a dot for each frame, and Weidmann's curve.

    Args:
        axis: Where to draw. Dots and curve have labels; the legend is the caller's.
        clouds: Crowds by label, drawn in this order.
        styles: Arguments of matplotlib's `plot` by label; by default, a colour for each.
    """
    for (label, cloud), colour in zip(clouds.items(), cycle(COLOURS), strict=False):
        style = (styles or {}).get(label, {"color": colour})
        dots = {"linestyle": "", "marker": "o", "markersize": 3, "markeredgewidth": 0, "alpha": 0.5}
        axis.plot(cloud.per_m2, cloud.speed_mps, label=label, **{**dots, **style})
    density = np.linspace(0, DENSEST_PER_M2, 500)
    style = {"color": "0.35", "linestyle": "--", "linewidth": 1.2}
    axis.plot(density, weidmann(density), label="Weidmann (1993)", **style)
    most, fastest = highest(clouds.values())
    axis.set(xlim=(0, most), ylim=(0, fastest))
    axis.set(xlabel="density (people per m²)", ylabel="speed (m/s)")


def highest(clouds: Iterable[SpeedDensity]) -> tuple[float, float]:
    """Upper ends of scales that show these clouds: of density, people per m², and speed, m/s."""
    density, speed = [0.5], [FREE_SPEED_MPS]
    for cloud in clouds:
        density += cloud.per_m2.tolist()
        speed += cloud.speed_mps[np.isfinite(cloud.speed_mps)].tolist()
    return 1.05 * max(density), 1.05 * max(speed)
