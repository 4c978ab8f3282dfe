"""The tests of RiMEA 4.1.1 (annex 1); several are tests of IMO and ISO 20414, too.

Rooms follow the guideline's figures. Where it asks for a judgement by eye, the limit is ours, and
`source` says so.
"""

from dataclasses import replace

import numpy as np

from crowdbench.exam.measures import (
    crossed_s,
    densities,
    flow_per_s,
    inside,
    last_left_s,
    left_s,
    speed_within,
    started_s,
)
from crowdbench.exam.rooms import (
    SPEED_MPS,
    Box,
    Room,
    beside,
    crowd,
    door_room,
    filled,
    scene_of,
    wall_with_doors,
)
from crowdbench.exam.trial import Limit, Run, Values, trial
from crowdbench.report.plots.flow import weidmann

OURS = "the guideline asks for a judgement by eye; the limit is ours"
RIMEA = "RiMEA 4.1.1, annex 1"
ALL = Limit(1.0, 1.0)


def speed_in_corridor(run: Run, speed: float) -> float:
    """Time of one person for the 40 m of a corridor 2 m wide, in seconds."""
    scene = scene_of(run.place, "corridor", (-2, 0, 44, 2))
    people = crowd(np.array([[0.0, 1.0]]), np.array([[43.0, 1.0]]), speed=speed)
    times = crossed_s(run.walk(Room(scene, people, 90.0)), (40.0, 0.0, 40.0, 2.0))
    return float(times[0])


@trial(
    "rimea-1", "Walking speed in a corridor", "RiMEA 1",
    limits={"time, s": Limit(26, 34)},
    source=f"{RIMEA}, test 1",
)  # fmt: skip
def corridor(run: Run) -> Values:
    """One person with a preferred speed of 1.33 m/s walks 40 m along a corridor 2 m wide."""
    return {"time, s": speed_in_corridor(run, SPEED_MPS)}


DENSITIES = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


@trial(
    "rimea-4", "Fundamental diagram of a corridor", "RiMEA 4", "ISO 20414 13",
    limits={
        "speed at 0.5 per m², m/s": Limit(0.9, 1.6),
        "speed at 4 per m², m/s": Limit(0.0, 0.7),
        "largest rise with density, m/s": Limit(high=0.1),
    },
    source=f"{RIMEA}, test 4 asks for a falling curve; {OURS}",
    seeds=1,
)  # fmt: skip
def fundamental_diagram(run: Run) -> Values:
    """A corridor 4 m wide and 30 m long is filled with 0.5 to 6 persons per m², who walk out of
    its open end. Speeds are measured in 2 × 2 m, 12 m before the end, in seconds 2 to 8.
    """
    scene = scene_of(run.place, "fundamental-diagram", (0, 0, 60, 4), open_=(0, 0, 62, 4))
    speeds = []
    for density in DENSITIES:
        start = filled((0, 0, 30, 4), round(density * 120), run.rng, margin_m=0.2)
        people = crowd(start, beside(61.0, (0.5, 3.5), len(start), run.rng))
        walked = run.walk(Room(scene, people, 10.0, line=(18, 0, 18, 4)))
        speeds.append(speed_within(walked, (17, 1, 19, 3), 2.0, 8.0))
    return {
        **{f"speed at {d:g} per m², m/s": v for d, v in zip(DENSITIES, speeds, strict=True)},
        "largest rise with density, m/s": float(np.diff(speeds).max()),
        "mean distance to Weidmann, m/s": float(
            np.abs(np.array(speeds) - weidmann(np.array(DENSITIES))).mean()
        ),
    }


@trial(
    "rimea-5", "Premovement time", "RiMEA 5", "IMO 5", "ISO 20414 1",
    limits={"largest deviation of a start, s": Limit(high=3.0), "share out": ALL},
    source=f"{RIMEA}, test 5: everyone starts at its time; the tolerance of 3 s is ours",
)  # fmt: skip
def premovement(run: Run) -> Values:
    """Ten people in a room of 8 × 5 m with a door of 1 m start after 10, 20, … 100 s."""
    room = door_room(run.place, run.rng)
    start = filled((0, 0, 8, 5), 10, run.rng, margin_m=0.8)
    wait_s = 10.0 * (1 + run.rng.permutation(10))
    people = crowd(start, beside(13.0, (1, 4), 10, run.rng), wait_s=wait_s)
    walked = run.walk(replace(room, people=people, horizon_s=160.0))
    # Half a metre away, half a metre of walking later.
    late = started_s(walked, 0.5) - people.wait_s - 0.5 / SPEED_MPS
    return {
        "largest deviation of a start, s": float(np.abs(late).max()),
        "share out": float(np.isfinite(left_s(walked)).mean()),
    }


@trial(
    "rimea-6", "Around a corner", "RiMEA 6", "IMO 6", "ISO 20414 4",
    limits={"share out": ALL, "share of positions in walls": Limit(high=0.0)},
    source=f"{RIMEA}, test 6",
)  # fmt: skip
def corner(run: Run) -> Values:
    """20 people walk around the corner of a corridor 2 m wide, with legs of 10 m."""
    block = (0.0, 2.0, 10.0, 12.0)
    scene = scene_of(run.place, "corner", (0, 0, 12, 12), blocks=[block])
    people = crowd(filled((0, 0, 6, 2), 20, run.rng), beside(11.0, (11.3, 11.6), 20, run.rng))
    walked = run.walk(Room(scene, people, 90.0))
    return {
        "share out": float(np.isfinite(left_s(walked)).mean()),
        "share of positions in walls": float(inside(walked, block).mean()),
        "last out, s": last_left_s(walked),
    }


AGES = {
    "under 30": (0.58, 1.61),
    "30 to 50": (1.41, 1.54),
    "over 50": (0.68, 1.41),
    "impaired": (0.46, 0.76),
}
"""Range of speeds of groups of people, in m/s (RiMEA 4.1.1, test 7, after Weidmann 1993)."""


@trial(
    "rimea-7", "Speeds of groups of people", "RiMEA 7", "IMO 7", "ISO 20414 5",
    limits={"share within the range of their group": Limit(low=0.95)},
    source=f"{RIMEA}, test 7; the tolerances of 5 % are ours",
    seeds=1,
)  # fmt: skip
def speeds_of_groups(run: Run) -> Values:
    """50 people, whose preferred speeds are drawn from the ranges of four groups (under 30:
    0.58–1.61, 30 to 50: 1.41–1.54, over 50: 0.68–1.41, impaired: 0.46–0.76 m/s), walk 20 m,
    each in a lane of its own.
    """
    ranges = np.array([list(AGES.values())[k % len(AGES)] for k in range(50)])
    speed = run.rng.uniform(ranges[:, 0], ranges[:, 1])
    y = 1.5 + 3.0 * np.arange(50)
    scene = scene_of(run.place, "lanes", (-1, 0, 23, 150))
    people = crowd(np.stack([0 * y, y], axis=1), np.stack([0 * y + 22, y], axis=1), speed=speed)
    walked = run.walk(Room(scene, people, 60.0))
    mean = 20.0 / crossed_s(walked, (20.0, 0.0, 20.0, 150.0))
    # People are sorted anew in a table; their goals tell who they are.
    lane = np.rint((walked.start[:, 1] - 1.5) / 3.0).astype(int)
    low, high = ranges[lane].T
    return {
        "share within the range of their group": float(
            ((mean >= 0.95 * low) & (mean <= 1.05 * high)).mean()
        ),
        "mean deviation from the preferred speed": float(np.abs(mean / speed[lane] - 1).mean()),
    }


@trial(
    "rimea-8", "Parameter study: preferred speed", "RiMEA 8",
    limits={"least gain by speed, s": Limit(low=-1.0), "share out": ALL},
    source=f"{RIMEA}, test 8 asks to show the effect of a parameter; {OURS}",
)  # fmt: skip
def parameter_study(run: Run) -> Values:
    """50 people with preferred speeds of 0.8, 1.1 and 1.4 m/s leave a room of 8 × 5 m through a
    door of 1 m.
    """
    last, out = [], []
    for speed in (0.8, 1.1, 1.4):
        room = door_room(run.place, run.rng, count=50, speed=speed)
        walked = run.walk(room)
        last.append(last_left_s(walked))
        out.append(np.isfinite(left_s(walked)).mean())
    return {
        **{f"last out at {v} m/s, s": t for v, t in zip((0.8, 1.1, 1.4), last, strict=True)},
        "least gain by speed, s": float(-np.diff(last).max()) if max(last) < np.inf else np.nan,
        "share out": float(min(out)),
    }  # fmt: skip


@trial(
    "rimea-9", "A crowd leaves a public space", "RiMEA 9", "IMO 9",
    limits={"time with two doors / with four": Limit(1.6, 2.4), "share out": ALL},
    source=f"{RIMEA}, test 9: about twice; limits as in the scripts of JuPedSim",
    seeds=1,
)  # fmt: skip
def public_space(run: Run) -> Values:
    """1,000 people leave a room of 30 × 20 m through four doors of 1 m, then through two."""
    last, out = {}, []
    for doors in (4, 2):
        walked = run.walk(public_room(run, doors))
        last[doors] = last_left_s(walked)
        out.append(np.isfinite(left_s(walked)).mean())
    return {
        "time with two doors / with four": last[2] / last[4] if np.isfinite(last[2]) else np.nan,
        "share out": float(min(out)),
        "last out through four, s": last[4],
        "last out through two, s": last[2],
    }


def public_room(run: Run, doors: int) -> Room:
    """A room of 30 × 20 m with 1,000 people and doors in its long walls."""
    gaps = [(7.5, 8.5), (21.5, 22.5)]
    blocks: list[Box] = []
    for y, gap in ((-0.4, gaps), (20.0, gaps if doors == 4 else [])):
        parts = wall_with_doors(y, (-0.5, 30.5), gap)
        blocks += [(low, y, high, y + 0.4) for _, low, _, high in parts]
    scene = scene_of(run.place, "public-space", (0, -5, 30, 25), blocks=blocks)
    start = filled((0, 0, 30, 20), 1000, run.rng)
    up = (start[:, 1] > 10) & (doors == 4)
    goal = np.stack([np.where(start[:, 0] < 15, 8.0, 22.0), np.where(up, 24.0, -4.0)], axis=1)
    goal += run.rng.uniform(-1, 1, goal.shape) * np.array([3.0, 0.5])
    return Room(scene, crowd(start, goal), 600.0, line=(7.5, -0.2, 8.5, -0.2))


@trial(
    "rimea-10", "Assigned exits", "RiMEA 10", "IMO 10", "ISO 20414 8",
    limits={"share out by its exit": ALL},
    source=f"{RIMEA}, test 10",
)  # fmt: skip
def assigned_exits(run: Run) -> Values:
    """23 people in twelve cabins on both sides of a corridor walk to the exits that they are
    assigned to: eight cabins to the main exit, four to the other one.
    """
    blocks: list[Box] = []
    start, goal = [], []
    for side, (low, high) in enumerate(((0.0, 3.0), (5.0, 8.0))):
        wall_y = 3.0 if side == 0 else 4.8
        doors = [(3.0 * k + 1.0, 3.0 * k + 2.0) for k in range(6)]
        blocks += [(a, wall_y, b, wall_y + 0.2)
                   for _, a, _, b in wall_with_doors(wall_y, (0.0, 18.0), doors)]  # fmt: skip
        blocks += [(3.0 * k - 0.1, low, 3.0 * k + 0.1, high) for k in range(1, 6)]
        for k in range(6):
            main = k < 4
            for n in range(2 if (side, k) != (1, 5) else 1):
                start.append((3.0 * k + 0.9 + 1.2 * n, (low + high) / 2))
                goal.append((-1.5 if main else 19.5, 4.0))
    scene = scene_of(run.place, "cabins", (-3, 0, 21, 8), blocks=[
        *blocks, (-3, 0, 0, 3.2), (-3, 4.8, 0, 8), (18, 0, 21, 3.2), (18, 4.8, 21, 8),
    ])  # fmt: skip
    people = crowd(np.array(start), np.array(goal))
    walked = run.walk(Room(scene, people, 90.0))
    near = np.linalg.norm(walked.end - walked.goal, axis=1) < 1.0
    return {
        "share out by its exit": float((near & np.isfinite(left_s(walked))).mean()),
        "last out, s": last_left_s(walked),
    }


@trial(
    "rimea-12", "A bottleneck", "RiMEA 12",
    limits={
        "flow through the corridor − through the exit, 1/s": Limit(low=-0.05),
        "density at the exit / at the corridor": Limit(high=1.0),
        "share out": ALL,
    },
    source=f"{RIMEA}, test 12; limit of the flows as in the scripts of JuPedSim",
)  # fmt: skip
def bottleneck(run: Run) -> Values:
    """150 people in a room of 10 × 10 m walk through a corridor of 1 × 5 m into a second room and
    leave it through an exit of 1 m. They must queue before the corridor, not at the exit.
    """
    blocks = [
        (10, 0, 15, 4.5),
        (10, 5.5, 15, 10),
        *wall_with_doors(25.0, (0.0, 10.0), [(4.5, 5.5)]),
    ]
    scene = scene_of(run.place, "bottleneck", (0, 0, 30, 10), blocks=blocks)
    start = filled((0, 0, 10, 10), 150, run.rng)
    people = crowd(start, beside(29.0, (2.0, 8.0), 150, run.rng))
    walked = run.walk(Room(scene, people, 400.0, line=(12.5, 4.5, 12.5, 5.5)))
    through, out = (crossed_s(walked, (x, 4.5, x, 5.5)) for x in (12.5, 25.2))
    before, at_exit = (densities(walked, (x, 4.0, x + 2, 6.0)).max() for x in (8.0, 23.0))
    return {
        "flow through the corridor − through the exit, 1/s": flow_per_s(through) - flow_per_s(out),
        "density at the exit / at the corridor": float(at_exit / before) if before > 0 else np.nan,
        "flow through the corridor, 1/s": flow_per_s(through),
        "share out": float(np.isfinite(left_s(walked)).mean()),
    }


@trial(
    "rimea-15", "A large crowd around a corner", "RiMEA 15",
    limits={
        "corner / short corridor": Limit(low=1.0),
        "corner / long corridor": Limit(high=1.05),
        "share out": ALL,
    },
    source=f"{RIMEA}, test 15: the corner takes longer than the short and not longer than the "
    "long corridor; the tolerance of 5 % is ours",
    seeds=1,
)  # fmt: skip
def large_corner(run: Run) -> Values:
    """500 people walk along a corridor 5 m wide: straight on over the length of the inner wall of
    a corner, around this corner, and straight on over the length of its outer wall.
    """
    last, out = {}, []
    leg, width, room_m = 15.0, 5.0, 35.0
    start = filled((0, 0, room_m, width), 500, run.rng)
    side = run.rng.uniform(0.5, width - 0.5, 500)
    for name, length in (("short", 2 * leg), ("long", 2 * (leg + width))):
        end = room_m + length
        scene = scene_of(run.place, f"{name}-corridor", (0, 0, end + 3, width))
        walked = run.walk(
            Room(scene, crowd(start, np.stack([0 * side + end + 1, side], axis=1)), 300.0)
        )
        last[name] = float(crossed_s(walked, (end, 0, end, width)).max())
        out.append(np.isfinite(left_s(walked)).mean())
    x, top = room_m + leg, leg + width
    scene = scene_of(run.place, "large-corner", (0, 0, x + width, top + 3),
                     blocks=[(0, width, x, top + 3)])  # fmt: skip
    goal = np.stack([x + side, 0 * side + top + 1], axis=1)
    walked = run.walk(Room(scene, crowd(start, goal), 300.0))
    last["corner"] = float(crossed_s(walked, (x, top, x + width, top)).max())
    out.append(np.isfinite(left_s(walked)).mean())
    return {
        "corner / short corridor": ratio(last["corner"], last["short"]),
        "corner / long corridor": ratio(last["corner"], last["long"]),
        **{f"last through the {name}, s": value for name, value in last.items()},
        "share out": float(min(out)),
    }


def ratio(a: float, b: float) -> float:
    """The ratio of two times; NaN if one of them is infinite."""
    return a / b if np.isfinite(a) and np.isfinite(b) else float("nan")


FILE_DENSITIES = (0.5, 1.0, 1.5, 2.0)


@trial(
    "rimea-16", "Single file", "RiMEA 16",
    limits={
        "speed at 0.5 per m, m/s": Limit(0.9, 1.6),
        "speed at 2 per m, m/s": Limit(0.0, 0.7),
        "largest rise with density, m/s": Limit(high=0.1),
    },
    source=f"{RIMEA}, test 16 compares with Seyfried et al. 2005 (0.13 m/s at 2 per m); {OURS}",
    seeds=1,
)  # fmt: skip
def single_file(run: Run) -> Values:
    """A passage 0.8 m wide and 30 m long is filled with 0.5 to 2 persons per metre in single file,
    who walk out of its open end. Speeds are measured on 4 m, 10 m before the end, in seconds 2
    to 8.
    """
    scene = scene_of(run.place, "single-file", (0, 0, 55, 0.8), open_=(0, 0, 57, 0.8))
    speeds = []
    for density in FILE_DENSITIES:
        x = np.linspace(0.5, 30.0, round(29.5 * density))
        x = x + run.rng.uniform(-0.05, 0.05, len(x))
        start = np.stack([x, 0 * x + 0.4], axis=1)
        people = crowd(start, np.stack([0 * x + 56.0, 0 * x + 0.4], axis=1))
        walked = run.walk(Room(scene, people, 10.0, line=(20, 0, 20, 0.8)))
        speeds.append(speed_within(walked, (18, 0, 22, 0.8), 2.0, 8.0))
    return {
        **{f"speed at {d:g} per m, m/s": v for d, v in zip(FILE_DENSITIES, speeds, strict=True)},
        "largest rise with density, m/s": float(np.diff(speeds).max()),
    }
