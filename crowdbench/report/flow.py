"""Flow, density and speed as practitioners measure them, with the library PedPy.

PedPy computes which people cross a line, Voronoi cells and speeds. Here crowds and scenes are
converted for it, and the results are summed up. `crowdbench.report.plots.flow` draws them.
"""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from crowdbench.data.table import Trajectories, is_within
from crowdbench.errors import SettingError, to_install
from crowdbench.scene import Scene

if TYPE_CHECKING:
    from pedpy import TrajectoryData, WalkableArea

MOST_FRAMES = 500
"""Number of frames in which `speed_density` measures, at most."""
SIDES_M = (2.0, 1.0)
"""Sides of the square that `middle_area` looks for a place for, metres; the first that fits."""
_GRID_M = 0.25
_HALF_WINDOW_S = 0.5
_APART_M = 0.001
_FRACTION_S = 1e-6  # times are multiples of dt_s only up to rounding


@dataclass(frozen=True, eq=False, kw_only=True)
class Flow:
    """People who cross a line, as `flow_through` measures them."""

    crossed_s: Float[np.ndarray, " n"]
    """When each of the n people crossed, ascending; N(t) is how many of these times are ≤ t."""
    width_m: float
    """Length of the line."""
    window_s: tuple[float, float]
    """Start and end of the window in which the flow is measured."""
    observed_s: float
    """How long the crowd was observed in the window; less than its length if there are gaps."""
    duration_s: float
    """Length of the crowd."""

    @property
    def per_metre_s(self) -> float:
        """Specific flow J = ΔN / (b Δt) in the window, people per metre and second.

        ΔN is the number of people who cross after the window's start and until its end, Δt is
        `observed_s`, b the length of the line. NaN if Δt is 0.
        """
        if self.observed_s == 0:
            return float("nan")
        crossed = int(_is_after_until(self.crossed_s, *self.window_s).sum())
        return crossed / (self.width_m * self.observed_s)


@dataclass(frozen=True, eq=False, kw_only=True)
class SpeedDensity:
    """Voronoi density and speed in an area, in n frames, as `speed_density` measures them."""

    frame: Int[np.ndarray, " n"]
    per_m2: Float[np.ndarray, " n"]
    """Density, people per square metre."""
    speed_mps: Float[np.ndarray, " n"]
    """Speed; NaN in frames in which nobody's speed is known."""
    stride: int
    """Every how many of the observed frames were measured."""
    area: shapely.Polygon

    def mean_speed_mps(self, low: float = 0.0, high: float = np.inf) -> float:
        """Mean speed in the frames with a density in [low, high); NaN if there are none."""
        speeds = self.speed_mps[(self.per_m2 >= low) & (self.per_m2 < high)]
        known = speeds[np.isfinite(speeds)]
        return float(known.mean()) if len(known) else float("nan")


def trajectory_data(
    crowd: Trajectories, of_rows: Bool[np.ndarray, " R"] | None = None
) -> "TrajectoryData":
    """A crowd as PedPy's `TrajectoryData`: `id`, `frame`, `x` and `y` in metres, 1/dt frames/s.

    Ids and frames keep their numbers. `of_rows` says which rows to convert; by default, all.

    Raises:
        SettingError: PedPy is not installed.
    """
    _check_pedpy()
    import pandas
    import pedpy

    kept = np.ones(len(crowd.xy), dtype=bool) if of_rows is None else of_rows
    x, y = crowd.xy[kept].astype(np.float64).T
    ids = crowd.person_id[crowd.row_person()[kept]]
    table = pandas.DataFrame({"id": ids, "frame": crowd.row_frame()[kept], "x": x, "y": y})
    return pedpy.TrajectoryData(data=table, frame_rate=1 / crowd.dt_s)


def walkable_area(scene: Scene) -> "WalkableArea":
    """A scene as PedPy's `WalkableArea`: the rectangle of its bounds without the walls.

    PedPy requires one connected area: where walls divide the rectangle, it is the largest part.

    Raises:
        SettingError: PedPy is not installed.
    """
    _check_pedpy()
    import pedpy

    return pedpy.WalkableArea(_free(scene))


def middle_area(scene: Scene) -> shapely.Polygon:
    """The area of a scene in which density and speed are measured if no other is named.

    It is a square parallel to the axes. Its side is 2 m, or 1 m if no larger square fits between
    walls and bounds. Of the places where it fits, on a grid of 0.25 m around the middle of the
    bounds, it is at the one nearest to this middle.

    Raises:
        SettingError: the scene has no place for a square of 1 m.
    """
    free, b = _free(scene), scene.bounds
    shapely.prepare(free)
    x, y = np.meshgrid(*(_around(*s) for s in ((b.x_min_m, b.x_max_m), (b.y_min_m, b.y_max_m))))
    to_middle = np.hypot(x - (b.x_min_m + b.x_max_m) / 2, y - (b.y_min_m + b.y_max_m) / 2)
    for side in SIDES_M:
        half = side / 2
        squares = shapely.box(x - half, y - half, x + half, y + half)
        fits = shapely.covers(free, squares)
        if fits.any():
            return squares.flat[np.where(fits, to_middle, np.inf).argmin()]
    raise SettingError(
        f"measurement area of {scene.id}",
        got="no place of 1 m × 1 m between its walls",
        expected="an area without walls",
        hint="Name the area.",
    )


def _free(scene: Scene) -> shapely.Polygon:
    """The largest connected part of the rectangle of a scene's bounds without its walls."""
    b = scene.bounds
    free = shapely.box(b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m).difference(scene.obstacles)
    return max(shapely.get_parts(free), key=shapely.area)


def _around(low: float, high: float) -> Float[np.ndarray, " n"]:
    """Points of the grid between two bounds, among them their middle."""
    steps = np.floor((high - low) / 2 / _GRID_M)
    return (low + high) / 2 + _GRID_M * np.arange(-steps, steps + 1)


def middle_line(scene: Scene) -> Float[np.ndarray, "2 2"]:
    """The line of a scene through which flow is measured if no other is named; metres.

    It passes through the middle of `middle_area`, parallel to an axis, and extends on both sides to
    the nearest wall or bound. Of the two such lines it is the shorter one.

    Raises:
        SettingError: as `middle_area` does.
    """
    free, middle, b = _free(scene), middle_area(scene).centroid, scene.bounds
    lines = []
    for ends in (
        [(b.x_min_m, middle.y), (b.x_max_m, middle.y)],
        [(middle.x, b.y_min_m), (middle.x, b.y_max_m)],
    ):
        parts = shapely.get_parts(shapely.intersection(free, shapely.LineString(ends)))
        lines.append(parts[shapely.distance(parts, middle).argmin()])
    return shapely.get_coordinates(min(lines, key=shapely.length))


def flow_through(
    crowd: Trajectories,
    line: Float[np.ndarray, "2 2"],
    window_s: tuple[float, float] | None = None,
) -> Flow:
    """N(t) of the people who cross a line, and their flow per metre and second.

    A person counts once, in the first frame after crossing, whatever the direction. Crossings in
    frames that are not observed do not count, nor does the time of these frames.

    Args:
        crowd: Recorded or simulated people.
        line: Its two ends, metres.
        window_s: Start and end of the window in which the flow is measured, seconds from frame 0;
            by default from the first to the last crossing, so that the flow of n people who cross
            one by one is (n − 1) / (b (t_n − t_1)).

    Raises:
        SettingError: PedPy is not installed, the line has no length, or the window ends before it
            starts.
    """
    data = trajectory_data(crowd)
    width = float(np.linalg.norm(line[1] - line[0]))
    if not width > 0:
        got, expected = f"{line.tolist()}", "two different points"
        raise SettingError("line of a flow", got=got, expected=expected)
    if window_s is not None and not window_s[0] < window_s[1]:
        raise SettingError("window of a flow", got=f"{window_s}", expected="start < end")
    import pedpy

    crossed = np.zeros(0, dtype=np.int64)
    if len(data.data):
        across = pedpy.MeasurementLine(line)
        firsts = pedpy.compute_n_t(traj_data=data, measurement_line=across)[1]
        crossed = firsts["frame"].to_numpy(dtype=np.int64)
    times = np.sort(crossed[crowd.is_observed()[crossed]]) * crowd.dt_s
    if window_s is None:
        window_s = (times[0], times[-1]) if len(times) else (0.0, crowd.duration_s)
    start, end = map(float, window_s)
    observed_s = np.flatnonzero(crowd.is_observed()) * crowd.dt_s
    return Flow(
        crossed_s=times,
        width_m=width,
        window_s=(start, end),
        observed_s=int(_is_after_until(observed_s, start, end).sum()) * crowd.dt_s,
        duration_s=crowd.duration_s,
    )


def _is_after_until(
    time_s: Float[np.ndarray, " n"], start_s: float, end_s: float
) -> Bool[np.ndarray, " n"]:
    """Whether each time is after the start of a window, and not after its end."""
    return (time_s > start_s + _FRACTION_S) & (time_s <= end_s + _FRACTION_S)


def speed_density(
    crowd: Trajectories,
    scene: Scene,
    area: shapely.Polygon | None = None,
    most_frames: int = MOST_FRAMES,
) -> SpeedDensity:
    """Voronoi density and Voronoi speed in an area, frame by frame.

    Each person i has a Voronoi cell: the part V_i of the walkable area that is nearer to it than to
    anybody else. With the area A, where |…| is an area in m²:

        density = Σ |V_i ∩ A| / |V_i| / |A|                   (people per m²)
        speed   = Σ v_i |V_i ∩ A| / Σ |V_i ∩ A|               (m/s)

    Source: B. Steffen and A. Seyfried, Methods for measuring pedestrian density, flow, speed and
    direction with minimal scatter, Physica A 389 (2010). The speed v_i of a person is the distance
    between its positions half a second before and after the frame (whole frames, at least one),
    divided by the time between them; where a trip begins or ends, between one of them and that in
    the frame.

    Cells end at walls and bounds. Where people also walk beyond the bounds, cells near them are too
    small; `middle_area` is therefore in the middle. In a walkable area that is not convex, a cell
    may be cut off by a wall. People outside of the walkable area have no cell.

    Args:
        crowd: Recorded or simulated people.
        scene: Its walkable area.
        area: A convex area without walls, by default `middle_area`.
        most_frames: If more frames than this are observed, every k-th of them is measured, with the
            smallest k that suffices.

    Raises:
        SettingError: PedPy is not installed, or the area is not convex or not walkable.
    """
    _check_pedpy()
    import pedpy

    where = f"measurement area in {scene.id}"
    area = middle_area(scene) if area is None else area
    free = walkable_area(scene)
    if not free.polygon.covers(area):
        got, expected = area.wkt, "an area inside the bounds that overlaps no wall"
        raise SettingError(where, got=got, expected=expected)
    try:
        measured = pedpy.MeasurementArea(area)
    except pedpy.GeometryError as error:
        expected = "a convex polygon without holes"
        raise SettingError(where, got=area.wkt, expected=expected) from error

    observed = np.flatnonzero(crowd.is_observed())
    stride = max(1, -(-len(observed) // most_frames))
    frames = observed[::stride]
    density, speed = np.zeros(len(frames)), np.full(len(frames), np.nan)
    cells = _cells(crowd, frames, free)
    if len(cells):
        per_m2, parts = pedpy.compute_voronoi_density(
            individual_voronoi_data=cells, measurement_area=measured
        )
        of_frame = per_m2.set_index("frame")["density"]
        density = of_frame.reindex(frames, fill_value=0.0).to_numpy(dtype=np.float64)
        parts = parts.merge(_speeds(crowd, frames), on=["id", "frame"], how="left")
        known = parts[parts["speed"].notna()]
        weight = shapely.area(known["intersection"].to_numpy())
        at = np.searchsorted(frames, known["frame"].to_numpy())
        weighted = np.bincount(at, weight * known["speed"].to_numpy(), minlength=len(frames))
        with np.errstate(invalid="ignore"):
            speed = weighted / np.bincount(at, weight, minlength=len(frames))
    return SpeedDensity(frame=frames, per_m2=density, speed_mps=speed, stride=stride, area=area)


def _cells(crowd: Trajectories, frames: Int[np.ndarray, " n"], free: "WalkableArea") -> Any:
    """PedPy's table of the Voronoi cells in these frames."""
    import pedpy

    data = trajectory_data(crowd, np.isin(crowd.row_frame(), frames))
    # People at the same place have no cells of their own: they are taken to be 1 mm apart.
    beside_m = _APART_M * data.data.groupby(["frame", "x", "y"]).cumcount()
    table = data.data.assign(x=data.data["x"] + beside_m)
    inside = shapely.contains_xy(free.polygon, table["x"].to_numpy(), table["y"].to_numpy())
    people = pedpy.TrajectoryData(data=table[inside], frame_rate=data.frame_rate)
    if not inside.any():
        return people.data
    return pedpy.compute_individual_voronoi_polygons(traj_data=people, walkable_area=free)


def _speeds(crowd: Trajectories, frames: Int[np.ndarray, " n"]) -> Any:
    """PedPy's table of speeds in these frames, among others; NaN for people of a single row."""
    import pedpy

    half = max(1, round(_HALF_WINDOW_S / crowd.dt_s))
    # PedPy takes the rows before and after, so all rows of the window must be there.
    around = is_within(np.stack([np.maximum(frames - half, 0), frames + half + 1], 1), crowd.frames)
    return pedpy.compute_individual_speed(
        traj_data=trajectory_data(crowd, around[crowd.row_frame()]),
        frame_step=half,
        speed_calculation=pedpy.SpeedCalculation.BORDER_SINGLE_SIDED,
    )


def _check_pedpy() -> None:
    if find_spec("pedpy") is None:
        raise SettingError(
            "flow and density",
            got="no pedpy",
            expected="the package PedPy",
            hint=to_install("pedpy"),
        )
