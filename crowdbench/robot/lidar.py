"""Range scans of robots: the nearest wall or person along each ray."""

import math

import numpy as np

from crowdbench.compilation import compiled
from crowdbench.simulation.rules import distance_to_segment

_TWO_PI = 2.0 * math.pi


@compiled
def scan(worlds, position, heading, segments, present, radius, range_m, out):
    """Write the ranges of a scan all around from the robots' centres.

    Ray r of R has the direction heading − π + 2π r / R: the rays begin at the back and turn to the
    left.

    Args:
        worlds: (n,) indices of worlds.
        position: (W, 2) of the robots, metres.
        heading: (W,) radians.
        segments: (S, 4) walls.
        present: the people, `Present`.
        radius: that of a person in metres; 0 if rays pass through people.
        range_m: largest range.
        out: (W, R) ranges in metres, which is written.
    """
    rays = out.shape[1]
    for w in worlds:
        x, y, back = position[w, 0], position[w, 1], heading[w] - math.pi
        for r in range(rays):
            out[w, r] = range_m
        for s in range(len(segments)):
            ax, ay = segments[s, 0] - x, segments[s, 1] - y
            bx, by = segments[s, 2] - x, segments[s, 3] - y
            if distance_to_segment(0.0, 0.0, ax, ay, bx, by) < range_m:
                _see_wall(ax, ay, bx, by, back, out[w])
        if radius == 0.0:
            continue
        for i in range(present.there.shape[1]):
            if present.there[w, i]:
                dx, dy = present.position[w, i, 0] - x, present.position[w, i, 1] - y
                if dx * dx + dy * dy < (range_m + radius) * (range_m + radius):
                    _see_disc(dx, dy, radius, back, out[w])


@compiled
def _see_wall(ax, ay, bx, by, back, ranges):
    """Shorten the rays that meet the wall from a to b, which are relative to the robot."""
    side = ax * by - ay * bx
    if side < 0.0:  # from the right to the left, as seen by the robot
        ax, ay, bx, by, side = bx, by, ax, ay, -side
    if side == 0.0:
        return
    step = _TWO_PI / len(ranges)
    low = (math.atan2(ay, ax) - back) % _TWO_PI
    wide = math.atan2(side, ax * bx + ay * by)
    for k in range(math.ceil(low / step - 1e-9), math.floor((low + wide) / step + 1e-9) + 1):
        angle = back + k * step
        across = math.cos(angle) * (by - ay) - math.sin(angle) * (bx - ax)
        if across > 0.0:
            r = k % len(ranges)
            ranges[r] = min(ranges[r], side / across)


@compiled
def _see_disc(dx, dy, radius, back, ranges):
    """Shorten the rays that meet the disc at d, which is relative to the robot."""
    squared = dx * dx + dy * dy
    if squared <= radius * radius:
        ranges[:] = 0.0
        return
    step = _TWO_PI / len(ranges)
    half = math.asin(radius / math.sqrt(squared))
    low = (math.atan2(dy, dx) - half - back) % _TWO_PI
    for k in range(math.ceil(low / step), math.floor((low + 2.0 * half) / step) + 1):
        angle = back + k * step
        cos, sin = math.cos(angle), math.sin(angle)
        along, off = dx * cos + dy * sin, dy * cos - dx * sin
        r = k % len(ranges)
        ranges[r] = min(ranges[r], along - math.sqrt(max(0.0, radius * radius - off * off)))


@compiled
def disturb(worlds, keys, steps, noise_m, drop_out, range_m, ranges):
    """Add normal noise to ranges, and replace some by the full range.

    The random numbers are a hash of a key per episode, the number of the step and the ray, so they
    do not depend on the number of worlds.

    Args:
        worlds: (n,) indices of worlds.
        keys: (W,) uint64.
        steps: (W,) number of steps of the episode.
        noise_m: standard deviation in metres.
        drop_out: probability that a ray shows the full range.
        range_m: largest range.
        ranges: (W, R) in metres, which is changed.
    """
    for w in worlds:
        for r in range(ranges.shape[1]):
            at = (np.uint64(steps[w]) * np.uint64(ranges.shape[1]) + np.uint64(r)) * np.uint64(3)
            one, two = _uniform(keys[w], at), _uniform(keys[w], at + np.uint64(1))
            if noise_m > 0.0 and ranges[w, r] < range_m:
                normal = math.sqrt(-2.0 * math.log(1.0 - one)) * math.cos(_TWO_PI * two)
                ranges[w, r] = min(range_m, max(0.0, ranges[w, r] + noise_m * normal))
            if _uniform(keys[w], at + np.uint64(2)) < drop_out:
                ranges[w, r] = range_m


@compiled
def _uniform(key, at):
    """A number from 0 to 1 (excluded): SplitMix64 (Steele, Lea and Flood 2014)."""
    z = key + (at + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) / 9007199254740992.0
