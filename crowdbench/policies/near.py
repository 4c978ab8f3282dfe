"""Who and which walls are near each person, for policies that move a whole crowd at once."""

import math

import numpy as np

from crowdbench.compilation import compiled


@compiled
def people_near(world, position, reach, group, by_x):
    """The others in the same world within reach of each person, in ascending order.

    Those of person a are `others[begins[a] : begins[a + 1]]`: companions, and whoever is within
    `reach[a]` metres. They are found among those who are near along the x-axis.

    Args:
        world: (A,) in ascending order.
        position: (A, 2) metres.
        reach: (A,) metres.
        group: (A,) group in the world, −1 if alone.
        by_x: (A,) persons in the order of x, world by world.
    """
    size = len(world)
    rank = np.empty(size, np.int64)
    for k in range(size):
        rank[by_x[k]] = k
    others = np.empty(16 * size, np.int64)
    begins = np.zeros(size + 1, np.int64)
    found = np.empty(size, np.int64)
    for a in range(size):
        count = 0
        for step in (-1, 1):
            k = rank[a] + step
            while 0 <= k < size and world[by_x[k]] == world[a]:
                b = by_x[k]
                dx, dy = position[a, 0] - position[b, 0], position[a, 1] - position[b, 1]
                if abs(dx) > reach[a]:
                    break
                if dx * dx + dy * dy <= reach[a] * reach[a] and not (
                    group[a] >= 0 and group[a] == group[b]
                ):
                    found[count] = b
                    count += 1
                k += step
        if group[a] >= 0:
            for b in range(size):
                if b != a and world[b] == world[a] and group[b] == group[a]:
                    found[count] = b
                    count += 1
        end = begins[a] + count
        if end > len(others):
            longer = np.empty(2 * end, np.int64)
            for k in range(begins[a]):
                longer[k] = others[k]
            others = longer
        for k in range(count):  # sorted by insertion: numpy's sort would take a second to compile
            at = begins[a] + k
            while at > begins[a] and others[at - 1] > found[k]:
                others[at] = others[at - 1]
                at -= 1
            others[at] = found[k]
        begins[a + 1] = end
    return others, begins


@compiled
def walls_near(position, reach, segments):
    """Wall segments (A, S) within reach (A,) of each person, and their number per person (A,)."""
    near = np.empty((len(position), len(segments)), dtype=np.int32)
    count = np.zeros(len(position), dtype=np.int32)
    for a in range(len(position)):
        for s in range(len(segments)):
            x, y = from_nearest(position[a, 0], position[a, 1], segments[s])
            if x * x + y * y <= reach[a] * reach[a]:
                near[a, count[a]] = s
                count[a] += 1
    return near, count


@compiled
def from_nearest(x, y, segment):
    """Vector from the nearest point of a segment to (x, y)."""
    ax, ay = segment[0], segment[1]
    ex, ey = segment[2] - ax, segment[3] - ay
    along = ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)
    along = min(1.0, max(0.0, along))
    return x - ax - along * ex, y - ay - along * ey


@compiled
def from_wall(x, y, segments, walls, near, k):
    """Vector from the nearest point of a wall to (x, y), its length, and where the next one begins.

    The wall is that of the segment `near[k]`; the segments of a wall follow each other in `near`.
    """
    wall = walls[near[k]]
    nearest, nx, ny = np.inf, 0.0, 0.0
    while k < len(near) and walls[near[k]] == wall:
        dx, dy = from_nearest(x, y, segments[near[k]])
        distance = math.sqrt(dx * dx + dy * dy)
        if distance < nearest:
            nearest, nx, ny = distance, dx, dy
        k += 1
    return nx, ny, nearest, k
