"""Derives the walls of gc-v0 from where nobody walks, and prints them for scene.toml.

    python scenes/gc-v0/walls.py DIR

DIR is a folder in OpenTraj's layout. A cell of 0.2 m that fewer than three of the 12,684 persons
crossed between two neighbouring annotations is closed, but for specks: closed ones narrower than
0.2 m, and open ones narrower than 0.4 m between closed ones. Closed regions of 0.4 m2 and more,
without open pockets, their outlines simplified to 0.1 m, are the walls. Where people stood in one,
they are cut back around that place: a few people stood for minutes where nobody else went. What
lies around the hall is cut into four parts, since a wall is a polygon without holes.
"""

import sys
from pathlib import Path

import numpy as np
import shapely
from scipy.spatial import cKDTree

from crowdbench.recordings.gc import HOMOGRAPHY, STEP, annotations, homography_of, metres, read_gc
from crowdbench.scene import load_scene
from crowdbench.trajectories.stops import standing
from crowdbench.trajectories.table import Trajectories

CELL_M = 0.2
DOOR_M = 1.0
"""Around places where five persons or more end within half a metre nothing is closed: there the
hall has a door or a stair, and goes on."""
PERSONS = 3
SPECK_M = 0.2
LEAST_M2 = 0.4
OPEN = (15.0, 52.6, 40.2, 53.4)
"""West, south, east, north of the picture's upper edge, beyond which people walk on, metres."""
POCKET_M2 = 2.0
TOLERANCE_M = 0.1
STOOD_S = 4.0
"""Cells in which people stood for this long in total lie outside the walls."""
BODY_M = 0.3
"""Radius of the place that a person who stands in a wall gets, before the outline is simplified."""


def closed_cells(
    files: dict[str, bytes], bounds: tuple[float, float, float, float]
) -> shapely.Geometry:
    """Union of the cells that fewer than three persons crossed."""
    tracks = annotations(files, "gc")
    rows = np.concatenate(list(tracks.values()))
    person = np.repeat(np.arange(len(tracks)), [len(each) for each in tracks.values()])
    xy = metres(rows[:, :2].astype(np.float64), homography_of(files[HOMOGRAPHY], "gc"))
    low, high = np.array(bounds[:2]), np.array(bounds[2:])
    same = np.flatnonzero((np.diff(person) == 0) & (np.diff(rows[:, 2]) == STEP))
    parts = np.linspace(0, 1, 16, endpoint=False)[:, None, None]
    points = (xy[same] + parts * (xy[same + 1] - xy[same])).reshape(-1, 2)
    who = np.tile(person[same], len(parts))
    inside = ((points >= low) & (points < high)).all(axis=1)
    shape = np.ceil((high - low) / CELL_M - 1e-9).astype(int)
    cell = ((points[inside] - low) / CELL_M).astype(int) @ [shape[1], 1]
    seen = np.unique(np.stack([cell, who[inside]], axis=1), axis=0)
    count = np.bincount(seen[:, 0], minlength=shape.prod()).reshape(shape)
    i, j = np.nonzero(count < PERSONS)
    x, y = low[0] + i * CELL_M, low[1] + j * CELL_M
    return shapely.union_all(shapely.box(x, y, x + CELL_M, y + CELL_M))


def doors_of(crowd: Trajectories) -> shapely.Geometry:
    """Where several persons end, and DOOR_M around it; and the picture's open edge."""
    ends = crowd.end[crowd.left]
    several = cKDTree(ends).query_ball_point(ends, 0.5, return_length=True) >= 5
    around = shapely.buffer(shapely.points(ends[several]), DOOR_M, quad_segs=2)
    return shapely.union_all([*around, shapely.box(*OPEN)])


def without_people(closed: shapely.Geometry, crowd: Trajectories) -> shapely.Geometry:
    """The walls, cut back around places where people stand and between these and the hall."""
    cell = np.floor(crowd.xy[standing(crowd)] / CELL_M).astype(np.int64)
    often, frames = np.unique(cell, axis=0, return_counts=True)
    at = shapely.points((often[frames * crowd.dt_s >= STOOD_S] + 0.5) * CELL_M)
    ways = shapely.shortest_line(at[shapely.intersects(closed, at)], closed.boundary)
    places = shapely.union_all(shapely.buffer(ways, BODY_M, quad_segs=2))
    return closed.difference(places).simplify(TOLERANCE_M)


def main() -> None:
    """Print the walls as TOML."""
    if len(sys.argv) != 2:
        raise SystemExit("usage: python scenes/gc-v0/walls.py DIR")
    b = load_scene("gc-v0").bounds
    frame = (b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m)
    margin = 1.0  # so that the frame's own edge is not rounded off
    folder = Path(sys.argv[1]) / "datasets/GC"
    names = [HOMOGRAPHY, *(f"Annotation/{p.name}" for p in (folder / "Annotation").glob("*.txt"))]
    files = {name: (folder / name).read_bytes() for name in sorted(names)}
    crowd = read_gc(files, folder)
    closed = closed_cells(files, frame)
    around = shapely.box(*frame).buffer(margin, join_style="mitre")
    closed = closed.union(around.difference(shapely.box(*frame).buffer(1e-6)))
    # Opening removes specks of closed cells in the crowd, closing the holes that strays made.
    closed = closed.buffer(-SPECK_M / 2 + 0.01).buffer(SPECK_M / 2 - 0.01)
    closed = closed.buffer(SPECK_M).buffer(-SPECK_M)
    closed = closed.simplify(TOLERANCE_M).intersection(shapely.box(*frame))
    doors, edge = doors_of(crowd), shapely.box(*frame).exterior
    parts = [p.difference(doors) if p.intersects(edge) else p for p in shapely.get_parts(closed)]
    closed = without_people(shapely.union_all(parts).simplify(TOLERANCE_M), crowd)
    walls = []
    x, y = (b.x_min_m + b.x_max_m) / 2, (b.y_min_m + b.y_max_m) / 2
    quarters = [
        ("south-west", shapely.box(b.x_min_m, b.y_min_m, x, y)),
        ("south-east", shapely.box(x, b.y_min_m, b.x_max_m, y)),
        ("north-west", shapely.box(b.x_min_m, y, x, b.y_max_m)),
        ("north-east", shapely.box(x, y, b.x_max_m, b.y_max_m)),
    ]
    for part in shapely.get_parts(closed):
        if not part.intersects(edge) and not part.interiors:
            walls.append(("inside", part))
            continue
        for name, quarter in quarters:
            walls += [(name, p) for p in shapely.get_parts(part.intersection(quarter))]
    print("# Printed by scenes/gc-v0/walls.py.")
    for name, polygon in walls:
        if polygon.area < LEAST_M2:
            continue
        pockets = [shapely.Polygon(ring).area for ring in polygon.interiors]
        if max(pockets, default=0.0) > POCKET_M2:
            raise SystemExit(f"{name} encloses {max(pockets):.1f} m2 where people walk")
        corners = np.round(np.array(polygon.exterior.coords)[:-1], 2) + 0.0
        keep = (corners != np.roll(corners, 1, axis=0)).any(axis=1)
        print(f'\n[[walls]]\nname = "{name}"\ncorners_m = {corners[keep].tolist()}')


if __name__ == "__main__":
    main()
