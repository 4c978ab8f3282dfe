"""Arrivals in files for other simulators: who enters when, where and whereto, and between walls."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import shapely

from crowdbench.errors import OutputError
from crowdbench.files import write_text
from crowdbench.scene import Scene
from crowdbench.spawn.events import SpawnEvents, write_events

BEYOND_M = 10.0
"""How far the walkable area reaches beyond a scene's bounds, because these are no walls."""
TABLES = (".csv", ".parquet")


def write_arrivals(events: SpawnEvents, scene: Scene, path: str | Path, *, frames: int) -> None:
    """Write arrivals in `frames` to a file, atomically: a table (`.csv`, `.parquet`), or `.json`.

    A table has the columns of `SpawnEvents`, see `write_events`. A JSON file also has what another
    simulator has to know of the scene; its walkable area is well-known text, from which JuPedSim
    makes a geometry.

    Raises:
        OutputError: the file has another ending, or cannot be written.
    """
    path = Path(path)
    if path.suffix in TABLES:
        write_events(events, path)
        return
    if path.suffix != ".json":
        raise OutputError(
            path, got=f"a file {path.suffix}", expected=f"{', '.join(TABLES)} or .json"
        )
    told = {
        "scene": scene.id,
        "dt_s": scene.dt_s,
        "frames": frames,
        "goal_radius_m": scene.motion.goal_radius_m,
        "walkable_area": walkable_area(scene).wkt,
    }
    persons = ",\n  ".join(map(_json, _persons(events, scene.dt_s)))
    lines = [f" {_json(name)}: {_json(value)}," for name, value in told.items()]
    write_text(path, "\n".join(["{", *lines, f' "persons": [\n  {persons}\n ]', "}\n"]))


def walkable_area(scene: Scene) -> shapely.Polygon:
    """Where people can walk: the bounds and `BEYOND_M` around them, without walls, in metres.

    If walls cut it apart, it is the part with most of the scene.
    """
    b = scene.bounds
    inside = shapely.box(b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m)
    free = inside.buffer(BEYOND_M, join_style="mitre").difference(scene.obstacles)
    return max(getattr(free, "geoms", [free]), key=lambda part: part.intersection(inside).area)


def _persons(events: SpawnEvents, dt_s: float) -> list[dict[str, Any]]:
    """The people in order of entry. Where `until_s` is no null, a person is removed at that time,
    because the recording is cut off there.
    """
    members: dict[int, list[int]] = {}
    for person, group in enumerate(events.group.tolist()):
        if group >= 0:
            members.setdefault(group, []).append(person)
    found = []
    for k in range(len(events)):
        last = int(events.leave_frame[k])
        stops = not np.isnan(events.via[k]).any()
        found.append(
            {
                "id": k,
                "time_s": round(max(0.0, float(events.time_s[k])), 3),
                "start": _point(events.start[k]),
                "goal": _point(events.goal[k]),
                "speed_mps": round(float(events.speed[k]), 4),
                "companions": [p for p in members.get(int(events.group[k]), []) if p != k],
                "via": _point(events.via[k]) if stops else None,
                "wait_s": round(float(events.wait_s[k]), 3),
                "until_s": None if last < 0 else round(last * dt_s, 3),
            }
        )
    return found


def _json(value: object) -> str:
    return msgspec.json.encode(value).decode()


def _point(at: np.ndarray) -> list[float]:
    return [round(float(value), 4) for value in at]
