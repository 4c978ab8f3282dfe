"""The report's pictures: small panels, side by side or below each other.

Each panel is a separate picture, about as wide as a phone screen, so that it is legible there. The
legend is given once, as text above the panels.
"""

from base64 import b64encode
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from markupsafe import Markup

from crowdbench.colours import COLOURS
from crowdbench.errors import SettingError
from crowdbench.progress import steps
from crowdbench.report.html.render import html
from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import picture
from crowdbench.report.plots.flow import highest, plot_n_t, plot_speed_density
from crowdbench.report.plots.measured import RECORDED, Measured
from crowdbench.report.plots.plot_data import Curves, Group, PlotData

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAP_WIDTH = 4.2
_MOST_AREAS = 12
_LEAST_GAPS = 20


class _Figure(NamedTuple):
    title: str
    note: str
    """What the caption says after the title."""
    alt: str
    width: int
    """Like the height, in pixels of the page."""
    height: int
    address: str
    """The picture itself, as a `data:` URL."""


def _drawn(
    draw: Callable[["Axes"], object],
    title: str,
    alt: str,
    *,
    note: str = "",
    inches: tuple[float, float],
    kind: Literal["small png", "svg"] = "svg",
) -> _Figure:
    width, height = inches
    data = picture(lambda axes: draw(axes[0]), width=width, height=height, kind=kind)
    mime = "image/svg+xml" if kind == "svg" else "image/png"
    address = f"data:{mime};base64,{b64encode(data).decode()}"
    return _Figure(title, note, alt, round(96 * width), round(96 * height), address)


def pictures(plot: PlotData) -> Markup:
    """HTML of all pictures, of at least one rollout."""
    gaps = [int(c.sum()) for c in plot.reference.statistics["inter_spawn_per_area"].values()]
    busiest = _busiest(gaps)
    curves = plot.curves("inter_spawn_per_area", samples=len(gaps))
    shares = plot.cells("occupancy")
    labels = ["recorded", *(group.label for group in plot.groups)]
    measured, unmeasured = _measured(plot)
    parts: dict[str, list[Callable[[], _Figure]]] = {
        "over_time": [partial(_over_time, plot, group) for group in plot.groups],
        "autocorrelation": [partial(_autocorrelation, plot)],
        "distributions": [partial(_distribution, plot, *of) for of in _distributions(plot)],
        "per_area": [partial(_of_area, plot, curves, k, gaps[k]) for k in busiest],
        "flows": [
            partial(_flows, plot, *of)
            for of in zip(labels, plot.cells("origin_destination"), strict=True)
        ],
        "occupancy": [
            partial(_occupancy, plot, shares[0], *of) for of in zip(labels, shares, strict=True)
        ],
        "paths": [partial(_paths, plot, group) for group in plot.groups],
        "clouds": [partial(_cloud, measured, group) for group in plot.groups if measured],
        "passed": [partial(_passed, measured)] if measured else [],
    }
    figures: dict[str, list[_Figure]] = {name: [] for name in parts}
    for name, draw in steps("pictures", [(n, draw) for n, part in parts.items() for draw in part]):
        figures[name].append(draw())
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
        measured=measured,
        unmeasured=unmeasured,
        **figures,
    )


def _over_time(plot: PlotData, group: Group) -> _Figure:
    present = np.concatenate([crowd.present() for crowd in group.crowds])
    count = len(group.crowds)
    return _drawn(
        lambda axis: panels.agents_over_time(axis, plot, group),
        group.label,
        f"Number of agents over time in rollouts of {group.label}: mean {present.mean():.1f}, "
        f"maximum {present.max()}.",
        note=f", {count} rollout{'s' * (count > 1)}",
        inches=(4.6, 2.3),
        kind="small png",
    )


def _autocorrelation(plot: PlotData) -> _Figure:
    def draw(axis: "Axes") -> None:
        panels.autocorrelation(axis, plot)
        axis.set_ylabel("autocorrelation")  # the longer label does not fit

    return _drawn(
        draw,
        "Autocorrelation of the number of agents",
        "Autocorrelation of the number of agents over the lag: the recording at the lags that the "
        "metric compares, and of the mean over the rollouts of each crowd.",
        inches=(4.6, 2.7),
    )


def _distributions(plot: PlotData) -> Sequence[tuple[str, str, str, float]]:
    """Metric, title, label of the axis, and unit of each distribution that is drawn."""
    scene = plot.scene
    entering = f"people who enter in {10 * scene.dt_s:.3g} s"
    return (
        ("inter_spawn", "Inter-spawn time", "time between two arrivals (s)", scene.grid_s),
        ("spawns_per_10_frames", "Spawns per 10 frames", entering, 1.0),
        ("agents_over_time", "Agents present, N(t)", "agents present", 1.0),
        ("dwell", "Dwell time", "time from entering to leaving (s)", scene.dt_s),
    )


def _distribution(plot: PlotData, name: str, title: str, what: str, unit: float) -> _Figure:
    curves = plot.curves(name)
    cut_off = name == "dwell" and plot.scene.timeout_s < curves.longest() * unit

    def draw(axis: "Axes") -> None:
        panels.survival(axis, plot, curves, unit=unit, what=what)
        if name == "dwell":
            panels.patience(axis, plot)

    return _drawn(
        draw,
        title,
        f"Survival curves, {title.lower()}. {medians(plot, curves, unit)}",
        note="; dotted: time limit of simulated trips" if cut_off else "",
        inches=(4.6, 2.7),
    )


def medians(plot: PlotData, curves: Curves, unit: float, area: int = 0) -> str:
    """A sentence with the medians of a metric: of the recording and of each group."""
    each = [curves.recorded[area], *curves.groups[:, area]]
    labels = ["recorded", *(group.label for group in plot.groups)]
    # Rounding may leave the last value of a distribution function below 1.
    middle = [curves.support[min(int(np.searchsorted(f, 0.5)), len(f) - 1)] * unit for f in each]
    each_median = ", ".join(f"{n} {m:.3g}" for n, m in zip(labels, middle, strict=True))
    return f"Medians: {each_median}."


def _of_area(plot: PlotData, curves: Curves, k: int, gaps: int) -> _Figure:
    x, y = plot.areas.spawn.mean[k]
    where = f"({x:.1f}, {y:.1f})".replace("-", "−")
    unit = plot.scene.grid_s
    return _drawn(
        lambda axis: panels.survival(axis, plot, curves, unit=unit, what="gap (s)", area=k),
        f"Area {k}",
        f"Survival curves of gaps between arrivals at spawn area {k}. "
        f"{medians(plot, curves, unit, k)}",
        note=f" around {where} m, {gaps} recorded gaps",
        inches=(3.0, 2.2),
    )


def _busiest(gaps: Sequence[int]) -> list[int]:
    """Indices of the areas with enough recorded gaps for a picture; at least one area."""
    order = np.argsort(gaps, kind="stable")[::-1].tolist()
    return [k for k in order[:_MOST_AREAS] if gaps[k] >= _LEAST_GAPS] or order[:1]


def _size_of_map(plot: PlotData, below: float = 0.0) -> tuple[float, float]:
    b = plot.scene.bounds
    ratio = (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m)
    return _MAP_WIDTH, (_MAP_WIDTH - 0.6) * ratio + 0.5 + below


def _flows(plot: PlotData, label: str, share: np.ndarray) -> _Figure:
    k, g = divmod(int(np.argmax(share)), plot.reference.place.goal_areas)
    return _drawn(
        lambda axis: panels.flows(axis, plot, share),
        label,
        f"Map of the flows from spawn areas to goal areas, {label}. The largest, "
        f"{100 * share.max():.0f} %, leads from spawn area {k} to goal area {g}.",
        inches=_size_of_map(plot),
    )


def _occupancy(plot: PlotData, recorded: np.ndarray, label: str, share: np.ndarray) -> _Figure:
    # A percentile, so that single cells with very high values do not darken all others.
    top = 100 * float(np.percentile(recorded[recorded > 0], 99.5)) if recorded.any() else 1.0
    differs = 50 * float(np.abs(share - recorded).sum())
    distance = f" Total variation distance from the recording: {differs:.0f} %."

    def draw(axis: "Axes") -> None:
        image = panels.occupancy(axis, plot, share, top)
        bar = axis.figure.colorbar(
            image, ax=axis, location="bottom", aspect=40, extend="max", pad=0.02
        )
        bar.set_label("% of people’s time per m²")

    return _drawn(
        draw,
        label,
        f"Map of where people spend their time, {label}.{distance * (label != 'recorded')}",
        inches=_size_of_map(plot, below=0.55),
    )


def _paths(plot: PlotData, group: Group) -> _Figure:
    count = min(len(group.crowds[0]), panels.MOST_PATHS)
    return _drawn(
        lambda axis: panels.paths(axis, plot, group.crowds[0]),
        group.label,
        f"Paths of {count} people in one rollout of {group.label}, drawn over walls, spawn areas "
        "and goal areas.",
        note=f", the first {count} people",
        inches=_size_of_map(plot),
        kind="small png",
    )


def _measured(plot: PlotData) -> tuple[Measured | None, str]:
    """Flow and density, or None and the reason: PedPy is missing, or a free place."""
    try:
        return Measured.of(plot), ""
    except SettingError as error:
        return None, str(error)


def _cloud(measured: Measured, group: Group) -> _Figure:
    clouds = {n: c for n, c in measured.clouds.items() if n in (RECORDED, group.label)}
    styles = {n: {"color": measured.styles[n]["color"]} for n in clouds}

    def draw(axis: "Axes") -> None:
        plot_speed_density(axis, clouds, styles)
        density, speed = highest(measured.clouds.values())  # all panels have the same scales
        axis.set(xlim=(0, density), ylim=(0, speed))

    each = ", ".join(
        f"{n} {c.mean_speed_mps():.2f} m/s (at most {c.per_m2.max():.2f} people per m²)"
        for n, c in clouds.items()
    )
    return _drawn(
        draw,
        group.label,
        f"Speed over density in the middle of the scene, and Weidmann’s curve. Means: {each}.",
        inches=(4.6, 2.7),
        kind="small png",
    )


def _passed(measured: Measured) -> _Figure:
    each = ", ".join(
        f"{n} {len(flow.crossed_s)} people ({flow.per_metre_s:.3f} per metre and second)"
        for n, flow in measured.flows.items()
    )
    return _drawn(
        lambda axis: plot_n_t(axis, measured.flows, measured.styles),
        "People who have crossed the line, N(t)",
        f"Number of people who have crossed a line in the middle of the scene: {each}.",
        inches=(4.6, 2.7),
        kind="small png",
    )
