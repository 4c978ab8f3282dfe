"""Scenes: real places (and one made-up one) with bounds, walls and the rules of their protocol.

A scene is a folder with `scene.toml`, which says what the place is, and the files that
`crowdbench fit` computed from its recording. Its id ends in `-vN`: whatever changes a score
makes a new version.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from jaxtyping import Bool, Float

from crowdbench.errors import SceneError
from crowdbench.files import read_struct, write_text

if TYPE_CHECKING:
    import shapely

SCHEMA = 1
_ID = re.compile(r"[a-z][a-z0-9_]*-v[0-9]+")
_MARGIN_M = 0.01  # a place beside a wall or the bounds, not on the line
_HINT = "Compare with scenes/plaza-v0/scene.toml."


class Recording(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The recording that the scene's models and statistics are computed from."""

    name: str
    frames: int
    """Its length in frames of the scene; a rollout is by default as long."""
    dwell_p99_s: float
    """99th percentile of the dwell times of those who entered and left."""
    sha256: str = ""
    """Of the data it was read from, where it is a user's own."""


class Bounds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Who walks out of this rectangle has left the scene."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float


class Wall(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An obstacle: a filled simple polygon, its corners in order, the last joined to the first."""

    name: str
    corners_m: tuple[tuple[float, float], ...]


class Motion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How persons move and end."""

    max_speed_mps: float
    person_radius_m: float
    """Radius of a person's disc in rays and overlaps."""
    goal_radius_m: float
    """A life ends when the way walked in a step comes this close to the goal."""


class Spawning(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """When an entering person waits."""

    clearance_m: float
    """An entry waits while someone already present is closer than this."""
    patience_s: float
    """After so long the person enters anyway."""


class Clustering(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of DBSCAN for starts and ends."""

    spawn_eps_m: float
    spawn_min_persons: int
    goal_eps_m: float
    goal_min_persons: int
    keep_noise: bool
    """True: persons in no cluster join the nearest one or a broad area of their own. False:
    they are left out, as in the founding paper."""


class Protocol(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the scene is scored."""

    block_s: float
    resample_s: float
    """Runs of consecutive scored blocks so long are resampled together."""
    fits: int
    """How many fits of a model that depends on chance are evaluated."""
    rollouts_per_fit: int
    scored: tuple[str, ...] = ()
    """The metrics that count, by `crowdbench power`."""


class _SceneFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    id: str
    title: str
    dt_s: float
    grid_s: float
    recording: Recording
    bounds: Bounds
    walls: tuple[Wall, ...] = ()
    motion: Motion
    spawning: Spawning
    clustering: dict[str, Clustering]
    protocol: Protocol


@dataclass(frozen=True)
class Scene:
    """A place and its rules, read from `scene.toml` by `load_scene`."""

    id: str
    title: str
    dt_s: float
    """Seconds from one frame to the next."""
    grid_s: float
    """Seconds of the grid on which the recording's arrivals were annotated."""
    recording: Recording
    bounds: Bounds
    walls: tuple[Wall, ...]
    motion: Motion
    spawning: Spawning
    clustering: dict[str, Clustering]
    protocol: Protocol
    folder: Path

    @property
    def asked(self) -> str:
        """How a user names the scene: its id, or the folder it lies in."""
        shipped = self.folder.parent == scenes_folder()
        return self.id if shipped else str(self.folder)

    @property
    def horizon_s(self) -> float:
        """Default length of a rollout: the recording's."""
        return self.recording.frames * self.dt_s

    def frames(self, duration_s: float) -> int:
        """The number of frames that `duration_s` fills, rounded up."""
        return int(np.ceil(duration_s / self.dt_s - 1e-6))

    @cached_property
    def obstacles(self) -> "shapely.Geometry":
        """Union of the walls."""
        import shapely

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
        """Index of the wall that each segment belongs to."""
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
        """Whether each point lies within the bounds and in no wall."""
        import shapely

        return self.inside(points) & ~shapely.intersects_xy(
            self.obstacles, points[:, 0], points[:, 1]
        )

    def nearest_walkable(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """The points, those outside the bounds or in a wall moved to the nearest walkable place."""
        import shapely

        lost = np.flatnonzero(~self.walkable(points))
        moved = points.copy()
        if len(lost):
            b = self.bounds
            whole = shapely.box(b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m)
            free = whole.difference(self.obstacles).buffer(-_MARGIN_M)
            ways = shapely.shortest_line(free, shapely.points(points[lost]))
            moved[lost] = shapely.get_coordinates(ways)[::2]
        return moved


def scenes_folder() -> Path:
    """The folder of the scenes that come with crowdbench."""
    package = Path(__file__).parent
    installed = package / "_scenes"  # where the wheel puts them
    return installed if installed.is_dir() else package.parent / "scenes"


def list_scenes() -> list[str]:
    """Ids of the scenes that come with crowdbench."""
    return sorted(path.parent.name for path in scenes_folder().glob("*/scene.toml"))


def load_scene(scene: str | Path | Scene) -> Scene:
    """A scene by its id, or from a folder that holds a `scene.toml`.

    A folder in the working directory whose name is an id is found by it too, unless a scene of
    that id comes with crowdbench.

    Raises:
        SceneError: there is no such scene, or its file is broken or contradicts itself.
    """
    if isinstance(scene, Scene):
        return scene
    folder = Path(scene)
    if _ID.fullmatch(str(scene)) and (scenes_folder() / str(scene)).is_dir():
        folder = scenes_folder() / str(scene)
    if not (folder / "scene.toml").is_file():
        raise SceneError(
            "scene",
            got=repr(str(scene)),
            expected=f"one of {', '.join(list_scenes())}, or a folder with a scene.toml",
        )
    path = folder / "scene.toml"
    file = read_struct(path, _SceneFile, SceneError, _HINT)
    _check(file, path)
    fields = {name: getattr(file, name) for name in file.__struct_fields__ if name != "schema"}
    return Scene(**fields, folder=folder)


def write_scored(scene: Scene, scored: Sequence[str]) -> Path:
    """Make these the metrics that count, in `scene.toml`, whose other lines stay as they are."""
    path = scene.folder / "scene.toml"
    lines = [f'    "{name}",' for name in scored]
    text = re.sub(r"^scored = \[[^\]]*\]\n", "", path.read_text(), flags=re.M).rstrip("\n")
    if not text.split("\n[")[-1].startswith("protocol]"):
        raise SceneError(
            path, got="[protocol] followed by another table", expected="[protocol] last"
        )
    write_text(path, "\n".join([text, "scored = [", *lines, "]", ""]))
    return path


def _check(file: _SceneFile, path: Path) -> None:
    import shapely

    def require(holds: bool, got: str, expected: str) -> None:
        if not holds:
            raise SceneError(path, got=got, expected=expected, hint=_HINT)

    b = file.bounds
    motion = file.motion
    require(file.schema == SCHEMA, f"schema = {file.schema}", f"schema = {SCHEMA}")
    require(bool(_ID.fullmatch(file.id)), f"id = {file.id!r}", "an id like name-v0")
    require(b.x_min_m < b.x_max_m and b.y_min_m < b.y_max_m, f"bounds {b}", "minima below maxima")
    positive = {
        "dt_s": file.dt_s,
        "grid_s": file.grid_s,
        "recording.frames": file.recording.frames,
        "recording.dwell_p99_s": file.recording.dwell_p99_s,
        "motion.max_speed_mps": motion.max_speed_mps,
        "motion.person_radius_m": motion.person_radius_m,
        "motion.goal_radius_m": motion.goal_radius_m,
        "protocol.block_s": file.protocol.block_s,
        "protocol.resample_s": file.protocol.resample_s,
        "protocol.fits": file.protocol.fits,
        "protocol.rollouts_per_fit": file.protocol.rollouts_per_fit,
    }
    for name, value in positive.items():
        require(math.isfinite(value) and value > 0, f"{name} = {value}", "a positive number")
    for name, value in (
        ("spawning.clearance_m", file.spawning.clearance_m),
        ("spawning.patience_s", file.spawning.patience_s),
    ):
        require(math.isfinite(value) and value >= 0, f"{name} = {value}", "zero or more")
    for name, value in msgspec.structs.asdict(b).items():
        require(math.isfinite(value), f"bounds.{name} = {value}", "a finite number")
    for key, settings in file.clustering.items():
        for name, value in msgspec.structs.asdict(settings).items():
            holds = name == "keep_noise" or (math.isfinite(value) and value > 0)
            require(holds, f"clustering.{key}.{name} = {value}", "a positive number")
    require("default" in file.clustering, "no [clustering.default]", "its DBSCAN settings")
    for wall in file.walls:
        require(len(wall.corners_m) >= 3, f"wall {wall.name!r}", "three corners or more")
        finite = bool(np.isfinite(wall.corners_m).all())
        require(finite, f"wall {wall.name!r} with a corner that is not finite", "metres")
        distinct = len(set(wall.corners_m)) == len(wall.corners_m)
        require(distinct, f"wall {wall.name!r} with a corner twice", "each corner once")
        polygon = shapely.Polygon(wall.corners_m)
        require(
            bool(polygon.is_valid), f"wall {wall.name!r} that crosses itself", "a simple polygon"
        )
