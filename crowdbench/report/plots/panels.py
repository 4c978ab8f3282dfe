"""Functions that draw onto axes: time series, survival curves, maps, values in cells."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Float32

from crowdbench.colours import goal_colour
from crowdbench.data.table import Trajectories
from crowdbench.registry.map_images import WHITE, map_of
from crowdbench.report.plots.plot_data import Curves, Group, PlotData
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Gaussians

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

BAND = "0.82"
MOST_FRAMES = 20_000
MOST_PATHS = 150
"""Maximum number of paths on a map; more would hide each other."""
LEAST_SHARE = 0.01
"""Minimum share of people for a flow to be drawn on a map."""
LEAST_LABELLED = 0.1
_BEND = 0.18
CELL_M = 0.5
"""Size of the cells of `in_cells`."""


def linestyle(group: Group) -> Any:
    """A group's dashes as a matplotlib line style."""
    return (0, group.dashes) if group.dashes else "-"


def agents_over_time(axis: "Axes", plot: PlotData, group: Group) -> None:
    """Draw N(t) of the rollouts, the first one highlighted, over the recording's time blocks."""
    recorded_bands(axis, plot)
    rollouts_over_time(axis, plot, group)


def rollouts_over_time(axis: "Axes", plot: PlotData, group: Group) -> None:
    """Draw N(t) of the rollouts, the first one highlighted."""
    for k, crowd in enumerate(group.crowds):
        style: dict[str, Any] = (
            {"linewidth": 0.6, "alpha": 0.3} if k else {"linewidth": 0.9, "zorder": 3}
        )
        axis.plot(*_agents(plot, crowd), color=group.colour, **style)
    end_s = plot.scene.recording.frames * plot.scene.dt_s
    axis.set(xlim=(0, end_s), ylim=(0, most_agents(plot)), xlabel="time (s)")
    axis.set_ylabel("mean of agents" if in_blocks(plot) else "agents")


def in_blocks(plot: PlotData) -> bool:
    """Whether N(t) is drawn as its means over time blocks.

    A recording of many hours has more frames than a picture can show; only their extremes would
    be visible.
    """
    return plot.scene.recording.frames > MOST_FRAMES


def _agents(plot: PlotData, crowd: Trajectories) -> tuple[np.ndarray, np.ndarray]:
    """Times in seconds and numbers of agents, or a step curve of their means over blocks."""
    present = crowd.present()[: plot.scene.recording.frames]
    if not in_blocks(plot):
        return np.arange(len(present)) * plot.scene.dt_s, present
    frames = plot.reference.blocks.frames
    means = block_means(plot, crowd)
    # NaN interrupts the line between blocks that are not adjacent.
    edges = np.pad(frames, ((0, 0), (0, 1)), constant_values=frames.max()) * plot.scene.dt_s
    steps = np.stack([means, means, np.full(len(means), np.nan)], axis=1)
    touching = np.r_[frames[1:, 0] == frames[:-1, 1], False]
    kept = np.ones(steps.shape, dtype=bool)
    kept[touching, 2] = False
    return edges[kept], steps[kept]


def block_means(plot: PlotData, crowd: Trajectories) -> np.ndarray:
    """Mean number of agents in each time block of a crowd."""
    present = crowd.present()
    return np.array([present[a:b].mean() for a, b in plot.reference.blocks.frames.tolist()])


def recorded_means(plot: PlotData) -> np.ndarray:
    """Mean number of agents in each time block of the recording."""
    counts = plot.reference.statistics["agents_over_time"]["counts"]
    means: np.ndarray = counts @ np.arange(counts.shape[1]) / counts.sum(axis=1)
    return means


def most_agents(plot: PlotData) -> float:
    """Upper limit of a scale that shows all rollouts and the recording."""
    crowds = [crowd for group in plot.groups for crowd in group.crowds]
    simulated = max(float(np.nanmax(_agents(plot, crowd)[1], initial=0)) for crowd in crowds)
    counts = plot.reference.statistics["agents_over_time"]["counts"]
    seen = recorded_means(plot) if in_blocks(plot) else np.flatnonzero(counts.any(axis=0))
    return 1.05 * max(simulated, float(seen.max(initial=0 if in_blocks(plot) else 1)))


def recorded_bands(axis: "Axes", plot: PlotData) -> None:
    """Draw the recording's mean of N and its 5–95 % range in each time block.

    The range is left out if the rollouts are drawn as means over blocks.
    """
    counts = plot.reference.statistics["agents_over_time"]["counts"]
    blocks, means = plot.reference.blocks, recorded_means(plot)
    of_range: str | None = "recorded, 5–95 % of a block"
    of_mean: str | None = "recorded, mean of a block"
    for b, (start, stop) in enumerate(blocks.frames * blocks.dt_s):
        low, high = recorded_range(counts[b])
        if not in_blocks(plot):
            axis.fill_between([start, stop], low - 0.2, high + 0.2, color=BAND, linewidth=0,
                              label=of_range)  # fmt: skip
        axis.plot([start, stop], [means[b]] * 2, color="black", linewidth=1.6, label=of_mean)
        of_range = of_mean = None  # once in a legend


def recorded_range(counts: np.ndarray) -> tuple[int, int]:
    """5th and 95th percentile of a number; `counts[n]` is how often it has the value n."""
    cumulative = counts.cumsum() / counts.sum()
    low, high = (int(np.searchsorted(cumulative, q)) for q in (0.05, 0.95))
    return low, high


def survival(
    axis: "Axes", plot: PlotData, curves: Curves, *, unit: float, what: str, area: int = 0
) -> None:
    """Draw P(X > x) of the recording and of each group, with its rollouts pooled.

    Unlike histograms, survival curves need no bins and show the tail.
    """
    x = curves.support * unit
    low, high = curves.band[0][area], curves.band[1][area]
    axis.fill_between(x, 1 - high, 1 - low, step="post", color=BAND, linewidth=0)
    axis.step(x, 1 - curves.recorded[area], where="post", color="black", linewidth=2.2,
              label="recorded")  # fmt: skip
    for group, f in zip(plot.groups, curves.groups, strict=True):
        style = {"color": group.colour, "linestyle": linestyle(group), "linewidth": 1.4}
        axis.step(x, 1 - f[area], where="post", label=group.label, **style)
    axis.set(xlim=(0, max(1, curves.longest(area)) * unit), ylim=(0, 1))
    axis.set(xlabel=what, ylabel="share above it")


def patience(axis: "Axes", plot: PlotData) -> None:
    """Draw the time limit of simulated trips, if it is within the axes."""
    if plot.scene.timeout_s < axis.get_xlim()[1]:
        axis.axvline(plot.scene.timeout_s, color="0.45", linewidth=0.9, linestyle=":",
                     label="simulated trips are cut off")  # fmt: skip


def place(axis: "Axes", scene: Scene, *, fill: str = "0.75") -> None:
    """Draw the scene's walls over its map, if it has one, and limit the axes to its bounds (m)."""
    b, image = scene.bounds, map_of(scene)
    if image is not None:
        axis.imshow(image.on(WHITE), extent=image.extent_m, zorder=-2)
    for wall in scene.walls:
        axis.fill(*np.array(wall.corners_m).T, color=fill, linewidth=0)
    axis.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axis.set(xlim=(b.x_min_m, b.x_max_m), ylim=(b.y_min_m, b.y_max_m))


def autocorrelation(axis: "Axes", plot: PlotData) -> None:
    """Draw the mean autocorrelation of N(t) over each group's rollouts.

    Dots with whiskers show the recording at the lags that the metric compares.
    """
    for group, values in zip(plot.groups, plot.autocorrelations(plot.lags_s.tolist()), strict=True):
        style = {"color": group.colour, "linestyle": linestyle(group), "linewidth": 1.4}
        axis.plot(plot.lags_s, values, label=group.label, **style)
    at = plot.compared_autocorrelation()
    # With few blocks, the value may lie outside its interval.
    whiskers = np.maximum(0, [at.value - at.low, at.high - at.value])
    axis.errorbar(at.lag_s, at.value, whiskers, fmt="o", color="black", markersize=5, capsize=3,
                  zorder=4, label="recorded, at the lags compared")  # fmt: skip
    axis.axhline(0, color="0.45", linewidth=0.8)
    axis.set(xlim=(0, max(1.0, float(plot.lags_s[-1]))), ylim=(None, 1))
    axis.set(xlabel="lag (s)", ylabel="autocorrelation of the number of agents")


def paths(axis: "Axes", plot: PlotData, crowd: Trajectories) -> None:
    """Draw the paths of a crowd's first people, in the colours of their goal areas."""
    place(axis, plot.scene)
    for p in range(min(len(crowd), MOST_PATHS)):
        colour = goal_colour(int(crowd.goal_area[p]))
        axis.plot(*crowd.path(p).T, color=colour, linewidth=0.5, alpha=0.5)
    for k in range(len(plot.areas.goal)):
        ellipse(axis, plot.areas.goal, k, color=goal_colour(k), linewidth=1.8)
    for k in range(len(plot.areas.spawn)):
        ellipse(axis, plot.areas.spawn, k, color="black", linewidth=1.0, linestyle="--")


def ellipse(axis: "Axes", gaussians: Gaussians, k: int, **style: Any) -> None:
    """Draw the outline of an area: two standard deviations around its centre."""
    axis.plot(*gaussians.outline(k).T, **style)


def flows(axis: "Axes", plot: PlotData, share: np.ndarray) -> None:
    """Draw arrows from spawn areas to goal areas; their widths are proportional to the shares."""
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.patheffects import withStroke

    place(axis, plot.scene)
    spawn, goal = plot.areas.spawn, plot.areas.goal
    for k in range(len(spawn)):
        ellipse(axis, spawn, k, color="0.35", linewidth=0.8, linestyle="--")
    for cell in np.argsort(share[: len(spawn) * len(goal)], kind="stable"):
        k, g = divmod(int(cell), len(goal))
        start, end = spawn.mean[k], goal.mean[g]
        width = 26 * float(share[cell])
        if share[cell] < LEAST_SHARE:
            continue
        if np.linalg.norm(end - start) < 1.5:  # the goal area is at the spawn area
            axis.plot(*start, "o", color=goal_colour(g), alpha=0.8, markersize=10,
                      markerfacecolor="none", markeredgewidth=width)  # fmt: skip
            continue
        shape = f"tail_width={width:.3f},head_width={width + 4:.3f},head_length={4 + width / 2:.3f}"
        arrow = FancyArrowPatch(
            tuple(start), tuple(end), connectionstyle=f"arc3,rad={_BEND}",
            arrowstyle=f"simple,{shape}", color=goal_colour(g), linewidth=0, alpha=0.8,
            shrinkA=3, shrinkB=3,
        )  # fmt: skip
        axis.add_patch(arrow)
        if share[cell] >= LEAST_LABELLED:
            (dx, dy), middle = end - start, (start + end) / 2  # the arc passes to its right
            x, y = middle + _BEND / 2 * np.array([dy, -dx])
            axis.text(
                x, y, f"{100 * share[cell]:.0f} %",
                ha="center", va="center", fontsize=8, fontweight="bold",
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
            )  # fmt: skip
    for g in range(len(goal)):
        axis.plot(*goal.mean[g], "o", color=goal_colour(g), markersize=6,
                  markeredgecolor="white", markeredgewidth=0.8)  # fmt: skip


def occupancy(axis: "Axes", plot: PlotData, share: np.ndarray, top: float) -> "AxesImage":
    """Draw the share of people's time in each cell of 1 m, in percent; the scale ends at `top`."""
    x0, x1, y0, y1 = plot.reference.place.bounds_m
    low = np.floor([x0, y0]).astype(np.int64) - 1
    high = np.ceil([x1, y1]).astype(np.int64)
    cells = 100 * share[: int((high - low + 1).prod())].reshape(high - low + 1).T
    image = axis.imshow(
        np.ma.masked_equal(cells, 0), origin="lower", cmap="viridis", vmin=0, vmax=top,
        extent=(low[0], high[0] + 1, low[1], high[1] + 1), interpolation="nearest",
    )  # fmt: skip
    place(axis, plot.scene)
    return image


def in_cells(xy: Float32[np.ndarray, "n 2"], scene: Scene) -> Float[np.ndarray, "Y X"]:
    """Number of positions in each cell of `CELL_M`; the first cell is at the lowest x and y."""
    b = scene.bounds
    edges = [
        low + CELL_M * np.arange(int(np.ceil((high - low) / CELL_M)) + 1)
        for low, high in ((b.y_min_m, b.y_max_m), (b.x_min_m, b.x_max_m))
    ]
    x, y = xy.T
    return np.histogram2d(y, x, bins=edges)[0]


def draw_cells(axis: "Axes", values: Float[np.ndarray, "Y X"], scene: Scene, **style: Any) -> Any:
    """Draw a value per cell and return the image, for a colour bar."""
    b, (rows, columns) = scene.bounds, values.shape
    x, y = b.x_min_m, b.y_min_m
    extent = (x, x + CELL_M * columns, y, y + CELL_M * rows)
    return axis.imshow(values, origin="lower", interpolation="nearest", extent=extent, **style)
