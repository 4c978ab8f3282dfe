"""The report's pictures: small panels, side by side or below each other.

Each panel is a separate picture, about as wide as a phone screen, so that it is legible there. The
legend is given once, as text above the panels.
"""

from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from markupsafe import Markup

from crowdbench.colours import COLOURS
from crowdbench.progress import steps
from crowdbench.report.html.render import html
from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import picture
from crowdbench.report.plots.plot_data import Curves, PlotData

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH = 4.2
_MOST_AREAS = 12
_LEAST_GAPS = 20


@dataclass(kw_only=True)
class _Figure:
    """A picture with its caption; the template shows it."""

    draw: Callable[["Axes"], None]
    title: str
    note: str = ""
    """What the caption says after the title."""
    alt: str
    height_in: float
    width_in: float = _WIDTH
    kind: Literal["small png", "svg"] = "svg"
    address: str = ""
    """The picture itself, as a `data:` URL, once it is drawn."""

    @property
    def width(self) -> int:
        """Width in pixels of the page."""
        return round(96 * self.width_in)

    @property
    def height(self) -> int:
        """Height in pixels of the page."""
        return round(96 * self.height_in)

    def make(self) -> None:
        """Draw the picture."""
        data = picture(
            lambda axes: self.draw(axes[0]),
            width=self.width_in,
            height=self.height_in,
            kind=self.kind,
        )
        mime = "image/svg+xml" if self.kind == "svg" else "image/png"
        self.address = f"data:{mime};base64,{b64encode(data).decode()}"


def pictures(plot: PlotData) -> Markup:
    """HTML of all pictures, of at least one rollout."""
    gaps = _gaps(plot)
    busiest = _busiest(gaps)
    figures = {
        "over_time": _over_time(plot),
        "autocorrelation": _autocorrelation(plot),
        "distributions": _distributions(plot),
        "per_area": _per_area(plot, gaps, busiest),
        "flows": _flows(plot),
        "occupancy": _occupancy(plot),
        "paths": _paths(plot),
    }
    for figure in steps("pictures", [each for part in figures.values() for each in part]):
        figure.make()
    return html(
        "pictures.html.j2",
        groups=plot.groups,
        rollouts=max(len(group.crowds) for group in plot.groups),
        first_fold=plot.split != "full",
        in_blocks=panels.in_blocks(plot),
        areas_left_out=len(gaps) - len(busiest),
        gaps_left_out=sum(gaps) - sum(gaps[k] for k in busiest),
        least_share=f"{100 * panels.LEAST_SHARE:.0f}",
        first_colour=COLOURS[0],
        **figures,
    )


def _over_time(plot: PlotData) -> list[_Figure]:
    found = []
    for group in plot.groups:
        present = np.concatenate([crowd.present() for crowd in group.crowds])
        count = len(group.crowds)
        found.append(
            _Figure(
                draw=partial(panels.agents_over_time, plot=plot, group=group),
                title=group.label,
                note=f", {count} rollout{'s' * (count > 1)}",
                alt=f"Number of agents over time in rollouts of {group.label}: mean "
                f"{present.mean():.1f}, maximum {present.max()}.",
                width_in=4.6,
                height_in=2.3,
                kind="small png",
            )
        )
    return found


def _autocorrelation(plot: PlotData) -> list[_Figure]:
    return [
        _Figure(
            draw=partial(_correlated, plot=plot),
            title="Autocorrelation of the number of agents",
            alt="Autocorrelation of the number of agents over the lag: the recording at the lags "
            "that the metric compares, and of the mean over the rollouts of each crowd.",
            width_in=4.6,
            height_in=2.7,
        )
    ]


def _correlated(axis: "Axes", plot: PlotData) -> None:
    panels.autocorrelation(axis, plot)
    axis.set_ylabel("autocorrelation")  # the longer label does not fit


def _distributions(plot: PlotData) -> list[_Figure]:
    scene = plot.scene
    found = []
    for name, title, what, unit in (
        ("inter_spawn", "Inter-spawn time", "time between two arrivals (s)", scene.grid_s),
        ("spawns_per_10_frames", "Spawns per 10 frames",
         f"people who enter in {10 * scene.dt_s:.3g} s", 1.0),
        ("agents_over_time", "Agents present, N(t)", "agents present", 1.0),
        ("dwell", "Dwell time", "time from entering to leaving (s)", scene.dt_s),
    ):  # fmt: skip
        curves = plot.curves(name)
        cut_off = name == "dwell" and plot.scene.timeout_s < curves.longest() * unit
        found.append(
            _Figure(
                draw=partial(
                    _distribution, plot=plot, name=name, curves=curves, unit=unit, what=what
                ),
                title=title,
                note="; dotted: time limit of simulated trips" if cut_off else "",
                alt=f"Survival curves, {title.lower()}. {medians(plot, curves, unit)}",
                width_in=4.6,
                height_in=2.7,
            )
        )
    return found


def _distribution(
    axis: "Axes", plot: PlotData, name: str, curves: Curves, unit: float, what: str
) -> None:
    panels.survival(axis, plot, curves, unit=unit, what=what)
    if name == "dwell":
        panels.patience(axis, plot)


def medians(plot: PlotData, curves: Curves, unit: float, area: int = 0) -> str:
    """A sentence with the medians of a metric: of the recording and of each group."""
    each = [curves.recorded[area], *curves.groups[:, area]]
    labels = ["recorded", *(group.label for group in plot.groups)]
    # Rounding may leave the last value of a distribution function below 1.
    middle = [curves.support[min(int(np.searchsorted(f, 0.5)), len(f) - 1)] * unit for f in each]
    each_median = ", ".join(f"{n} {m:.3g}" for n, m in zip(labels, middle, strict=True))
    return f"Medians: {each_median}."


def _per_area(plot: PlotData, gaps: Sequence[int], busiest: Sequence[int]) -> list[_Figure]:
    name, areas = "inter_spawn_per_area", plot.reference.place.spawn_areas
    curves = plot.curves(name, samples=areas)
    found = []
    for k in busiest:
        x, y = plot.areas.spawn.mean[k]
        where = f"({x:.1f}, {y:.1f})".replace("-", "−")
        found.append(
            _Figure(
                draw=partial(
                    panels.survival,
                    plot=plot,
                    curves=curves,
                    unit=plot.scene.grid_s,
                    what="gap (s)",
                    area=k,
                ),
                title=f"Area {k}",
                note=f" around {where} m, {gaps[k]} recorded gaps",
                alt=f"Survival curves of gaps between arrivals at spawn area {k}. "
                f"{medians(plot, curves, plot.scene.grid_s, k)}",
                width_in=3.0,
                height_in=2.2,
            )
        )
    return found


def _gaps(plot: PlotData) -> list[int]:
    """Number of recorded gaps at each spawn area."""
    each = plot.reference.statistics["inter_spawn_per_area"].values()
    return [int(counts.sum()) for counts in each]


def _busiest(gaps: Sequence[int]) -> list[int]:
    """Indices of the areas with enough recorded gaps for a picture; at least one area."""
    order = np.argsort(gaps, kind="stable")[::-1].tolist()
    return [k for k in order[:_MOST_AREAS] if gaps[k] >= _LEAST_GAPS] or order[:1]


def _map_height(plot: PlotData, extra: float = 0.5) -> float:
    b = plot.scene.bounds
    return (_WIDTH - 0.6) * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m) + extra


def _flows(plot: PlotData) -> list[_Figure]:
    found = []
    goals = plot.reference.place.goal_areas
    labels = ["recorded", *(group.label for group in plot.groups)]
    for label, share in zip(labels, plot.cells("origin_destination"), strict=True):
        k, g = divmod(int(np.argmax(share)), goals)
        found.append(
            _Figure(
                draw=partial(panels.flows, plot=plot, share=share),
                title=label,
                alt=f"Map of the flows from spawn areas to goal areas, {label}. The largest, "
                f"{100 * share.max():.0f} %, leads from spawn area {k} to goal area {g}.",
                height_in=_map_height(plot),
            )
        )
    return found


def _occupancy(plot: PlotData) -> list[_Figure]:
    shares = plot.cells("occupancy")
    # A percentile, so that single cells with very high values do not darken all others.
    top = 100 * float(np.percentile(shares[0][shares[0] > 0], 99.5)) if shares[0].any() else 1.0
    labels = ["recorded", *(group.label for group in plot.groups)]
    found = []
    for label, share in zip(labels, shares, strict=True):
        differs = 50 * float(np.abs(share - shares[0]).sum())
        found.append(
            _Figure(
                draw=partial(_occupied, plot=plot, share=share, top=top),
                title=label,
                alt=f"Map of where people spend their time, {label}."
                + (f" Total variation distance from the recording: {differs:.0f} %."
                   if label != "recorded" else ""),
                height_in=_map_height(plot, 1.05),
            )
        )  # fmt: skip
    return found


def _occupied(axis: "Axes", plot: PlotData, share: np.ndarray, top: float) -> None:
    image = panels.occupancy(axis, plot, share, top)
    bar = axis.figure.colorbar(image, ax=axis, location="bottom", aspect=40, extend="max", pad=0.02)
    bar.set_label("% of people’s time per m²")


def _paths(plot: PlotData) -> list[_Figure]:
    found = []
    for group in plot.groups:
        count = min(len(group.crowds[0]), panels.MOST_PATHS)
        found.append(
            _Figure(
                draw=partial(panels.paths, plot=plot, crowd=group.crowds[0]),
                title=group.label,
                note=f", the first {count} people",
                alt=f"Paths of {count} people in one rollout of {group.label}, drawn over walls, "
                "spawn areas and goal areas.",
                height_in=_map_height(plot),
                kind="small png",
            )
        )
    return found
