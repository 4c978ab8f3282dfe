"""Scenes: real places (and one synthetic one) with bounds, walls and a protocol for scoring.

A scene is a folder with `scene.toml`, which describes the place, and the files that
`crowdbench scene fit` computes from its recording. Its id ends in `-vN`: any change that affects
scores requires a new version.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import shapely
from jaxtyping import Bool, Float

from crowdbench.errors import SceneError, checked, did_you_mean
from crowdbench.files import read_struct

SCHEMA = 1
TIMEOUT_DWELLS = 2.0
ID = re.compile(r"[a-z][a-z0-9_]*-v[0-9]+")
"""Valid ids of scenes."""
LARGEST_BODY_M = 0.19
"""Largest radius of a body: paths pass the corners of walls at 0.2 m."""
_MARGIN_M = 0.01  # moved points keep this distance from walls and bounds
_HINT = "Compare with scenes/plaza-v0/scene.toml."


class Recording(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The recording that the scene's models and statistics are computed from."""

    name: str
    frames: int
    """Length in frames of the scene; also the default length of a rollout."""
    dwell_p99_s: float
    """99th percentile of the dwell times of people who entered and left, seconds."""
    sha256: str = ""
    """SHA-256 of the source data, for users' own recordings."""
    preprocess: Literal["", "paper"] = ""
    """`paper`: people are dropped as in the founding paper; see `trajectories.preprocessing`."""


class Bounds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rectangle of the scene; people who walk out of it leave the scene."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float


class Wall(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An obstacle: a solid simple polygon with its corners in order."""

    name: str
    corners_m: tuple[tuple[float, float], ...]


class Motion(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Limits of motion, and sizes of persons and goals."""

    max_speed_mps: float
    person_radius_m: float
    """Radius of a person's disc in rays and overlaps."""
    goal_radius_m: float
    """A person arrives when the segment walked in a step comes this close to the goal."""
    body_radius_m: float = 0.0
    """Radius of bodies that pass neither through each other nor through walls, 0 for none; see
    `crowdbench.simulation.contact`."""


class Spawning(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rules for waiting before entry."""

    clearance_m: float
    """A person waits to enter while somebody is closer than this to its start."""
    patience_s: float
    """Maximum waiting time, seconds; after it the person enters in any case."""


class Clustering(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of DBSCAN for the clustering of starts and ends of trips."""

    spawn_eps_m: float
    spawn_min_persons: int
    goal_eps_m: float
    goal_min_persons: int
    keep_noise: bool
    """If True, persons in no cluster join the nearest cluster or a separate broad area. If False,
    they are left out, as in the founding paper."""
    widest_m: float = math.inf
    """Largest standard deviation of an area, metres. Wider clusters are split, because DBSCAN joins
    doors that are side by side."""


class Protocol(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the scene's scoring."""

    block_s: float
    """Length of a time block, seconds."""
    resample_s: float
    """Length of the runs of consecutive scored blocks that are resampled together, seconds."""
    fits: int
    """Number of fits of each spawn model."""
    rollouts_per_fit: int
    walk_rollouts: int
    """Number of rollouts under the recorded arrivals, to which nothing is fitted."""
    scored: tuple[str, ...] = ()
    """Names of the scored metrics, determined by `crowdbench scene power`."""


class Walking(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Time scales of the walking metrics, chosen so that people move more than positions jitter.

    `crowdbench scene create` derives them from the recording's own noise; see `rules.walking_of`.
    """

    tick_frames: int = 1
    """Frames from one tick to the next. Walking is measured at ticks: frames with annotated, not
    interpolated positions."""
    window_ticks: int = 9
    """Length of the window in which speeds are measured, in ticks; odd."""
    lags_ticks: tuple[int, ...] = (3, 4, 6)
    """Time scales of accelerations, in ticks."""
    shifts_s: tuple[float, ...] = (20.0, 40.0)
    """Delays of one of two people in the pairs that encounters are compared with, seconds."""


class Gate(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits for the policies of a scene. Beyond them `walk` is at most 0."""

    speed: float = 0.15
    """Relative deviation of the mean speed from that of recorded people walked."""
    arrivals: float = 0.95
    """Share of people at the goal, as a share of that of recorded people walked."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A place and its rules, read from `scene.toml` by `load_scene`."""

    id: str
    title: str
    dt_s: float
    """Seconds from one frame to the next."""
    grid_s: float
    """Step of the grid on which the recording's arrivals were annotated, seconds."""
    recording: Recording
    bounds: Bounds
    walls: tuple[Wall, ...] = ()
    motion: Motion
    spawning: Spawning
    clustering: dict[str, Clustering]
    walking: Walking = Walking()
    gate: Gate = Gate()
    protocol: Protocol
    folder: Path

    @property
    def asked(self) -> str:
        """The name by which commands find the scene: its id, or its folder if it is not shipped."""
        shipped = self.folder.parent == scenes_folder()
        return self.id if shipped else str(self.folder)

    @property
    def horizon_s(self) -> float:
        """Default length of a rollout, seconds: that of the recording."""
        return self.recording.frames * self.dt_s

    @property
    def timeout_s(self) -> float:
        """Seconds after which a person is removed: twice the 99th percentile of dwell times."""
        return TIMEOUT_DWELLS * self.recording.dwell_p99_s

    @property
    def rules(self) -> bytes:
        """The settings of `scene.toml` that rollouts depend on, as canonical JSON.

        The title, the settings of DBSCAN (whose result is `areas.json`) and those of scores are
        left out.
        """
        rules = {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in ("title", "folder", "clustering", "walking", "gate")
        }
        rules["protocol"] = msgspec.structs.replace(self.protocol, scored=())
        return msgspec.json.encode(rules, order="deterministic")

    def frames(self, duration_s: float) -> int:
        """The number of frames that `duration_s` fills, rounded up."""
        return int(np.ceil(duration_s / self.dt_s - 1e-6))

    @cached_property
    def obstacles(self) -> shapely.Geometry:
        """The union of all walls."""
        obstacles = shapely.union_all([shapely.Polygon(wall.corners_m) for wall in self.walls])
        shapely.prepare(obstacles)
        return obstacles

    @cached_property
    def wall_segments(self) -> Float[np.ndarray, "S 4"]:
        """Edges of the walls, each x0, y0, x1, y1 in metres."""
        segments = [
            [*corner, *following]
            for wall in self.walls
            for corner, following in zip(
                wall.corners_m, wall.corners_m[1:] + wall.corners_m[:1], strict=True
            )
        ]
        return np.array(segments, dtype=np.float64).reshape(-1, 4)

    @cached_property
    def wall_of_segment(self) -> tuple[int, ...]:
        """Index of the wall to which each of `wall_segments` belongs."""
        return tuple(k for k, wall in enumerate(self.walls) for _ in wall.corners_m)

    def inside(self, points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Whether each point lies within the bounds."""
        b = self.bounds
        return (
            (points[:, 0] > b.x_min_m)
            & (points[:, 0] < b.x_max_m)
            & (points[:, 1] > b.y_min_m)
            & (points[:, 1] < b.y_max_m)
        )

    def walkable(self, points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Whether each point lies within the bounds and outside all walls."""
        return self.inside(points) & ~shapely.intersects_xy(
            self.obstacles, points[:, 0], points[:, 1]
        )

    def has_room(self, points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Whether each point lies within the bounds, a person's radius or more from all walls."""
        circles = shapely.points(points)
        near = shapely.dwithin(self.obstacles, circles, self.motion.person_radius_m)
        return self.inside(points) & ~near

    def nearest_walkable(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """The points; those outside the bounds or in a wall are moved to the nearest free place."""
        lost = np.flatnonzero(~self.walkable(points))
        moved = points.copy()
        if len(lost):
            b = self.bounds
            whole = shapely.box(b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m)
            free = whole.difference(self.obstacles).buffer(-_MARGIN_M)
            ways = shapely.shortest_line(free, shapely.points(points[lost]))
            moved[lost] = shapely.get_coordinates(ways)[::2]
        return moved


_SceneFile: Any = msgspec.defstruct(
    "_SceneFile",
    [
        ("schema", int),
        *((f.name, f.type) for f in fields(Scene) if f.default is MISSING and f.name != "folder"),
        *((f.name, f.type, f.default) for f in fields(Scene) if f.default is not MISSING),
    ],
    frozen=True,
    forbid_unknown_fields=True,
)
"""The content of `scene.toml`."""


def scenes_folder() -> Path:
    """The folder of the scenes that come with crowdbench."""
    package = Path(__file__).parent
    installed = package / "_scenes"  # location in an installed package
    return installed if installed.is_dir() else package.parent / "scenes"


def list_scenes() -> list[str]:
    """Ids of the scenes that come with crowdbench."""
    return sorted(path.parent.name for path in scenes_folder().glob("*/scene.toml"))


@checked()
def load_scene(scene: str | Path | Scene) -> Scene:
    """Load a scene by its id, or from a folder with a `scene.toml`.

    The id of a shipped scene takes precedence over a folder of the same name in the working
    directory. A `Scene` is returned unchanged.

    Raises:
        SceneError: there is no such scene, or its file is broken or inconsistent.
    """
    if isinstance(scene, Scene):
        return scene
    folder = Path(scene)
    if ID.fullmatch(str(scene)) and (scenes_folder() / str(scene)).is_dir():
        folder = scenes_folder() / str(scene)
    if not (folder / "scene.toml").is_file():
        expected = f"one of {', '.join(list_scenes())}, or a folder with a scene.toml"
        hint = did_you_mean(scene, list_scenes())
        raise SceneError("scene", got=repr(str(scene)), expected=expected, hint=hint)
    path = folder / "scene.toml"
    file = read_struct(path, _SceneFile, SceneError, _HINT)
    _check(file, path)
    known = {name: getattr(file, name) for name in file.__struct_fields__ if name != "schema"}
    return Scene(**known, folder=folder)


def _check(file: Any, path: Path) -> None:
    def require(holds: bool, got: str, expected: str) -> None:
        if not holds:
            raise SceneError(path, got=got, expected=expected, hint=_HINT)

    b, walking = file.bounds, file.walking
    require(file.schema == SCHEMA, f"schema = {file.schema}", f"schema = {SCHEMA}")
    require(bool(ID.fullmatch(file.id)), f"id = {file.id!r}", "an id like name-v0")
    for name, value in _numbers(file):
        holds, expected = value > 0 and math.isfinite(value), "a positive number"
        if name.startswith("bounds."):
            holds, expected = math.isfinite(value), "a finite number"
        elif name.startswith("spawning."):
            holds, expected = 0 <= value < math.inf, "zero or more"
        elif name == "motion.body_radius_m":
            holds = 0 <= value <= LARGEST_BODY_M
            expected = f"0 (no bodies) to {LARGEST_BODY_M}"
        elif name == "gate.arrivals":
            holds, expected = 0 <= value <= 1, "a share from 0 to 1"
        elif name.endswith(".widest_m"):
            holds, expected = value >= 1, "1 m or more"
        require(holds, f"{name} = {value}", expected)
    require(b.x_min_m < b.x_max_m and b.y_min_m < b.y_max_m, f"bounds {b}", "minima below maxima")
    window, lags, shifts = walking.window_ticks, walking.lags_ticks, walking.shifts_s
    shortest_s = max(1.0, walking.tick_frames * file.dt_s)
    odd = window >= 3 and window % 2 == 1
    require(odd, f"walking.window_ticks = {window}", "an odd number, 3 or more")
    ascending = lags == tuple(sorted(set(lags))) and min(lags, default=0) >= 2
    expected = "ascending numbers of ticks, 2 or more"
    require(ascending, f"walking.lags_ticks = {list(lags)}", expected)
    long = len(shifts) > 0 and all(math.isfinite(s) and s >= shortest_s for s in shifts)
    expected = f"numbers of seconds, {shortest_s:g} or more"
    require(long, f"walking.shifts_s = {list(shifts)}", expected)
    require("default" in file.clustering, "no [clustering.default]", "settings of DBSCAN there")
    for wall in file.walls:
        corners, who = wall.corners_m, f"wall {wall.name!r}"
        require(len(corners) >= 3, f"{who} with {len(corners)} corners", "three corners or more")
        finite = bool(np.isfinite(corners).all())
        require(finite, f"{who} with a corner that is not finite", "corners in metres")
        distinct = len(set(corners)) == len(corners)
        require(distinct, f"{who} with a repeated corner", "distinct corners")
        simple = shapely.Polygon(corners).is_valid
        require(simple, f"{who} that crosses itself", "a simple polygon")


def _numbers(
    table: "msgspec.Struct | dict[str, Any]", path: str = ""
) -> Iterator[tuple[str, float]]:
    """The numbers in a table and those in it, with their dotted names; not those in lists."""
    values = table if isinstance(table, dict) else msgspec.structs.asdict(table)
    for name, value in values.items():
        if isinstance(value, msgspec.Struct | dict):
            yield from _numbers(value, f"{path}{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{path}{name}", value
