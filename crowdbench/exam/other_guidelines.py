"""Tests of IMO and ISO 20414 that RiMEA does not have, and the flow through a door."""

import numpy as np

from crowdbench.exam.measures import (
    crossed_s,
    densities,
    flow_per_s,
    last_left_s,
    left_s,
    nearest_m,
)
from crowdbench.exam.rimea import ALL, OURS, speed_in_corridor
from crowdbench.exam.rooms import (
    Room,
    beside,
    crowd,
    door_room,
    filled,
    scene_of,
)
from crowdbench.exam.trial import Limit, Run, Values, trial

AGAINST = (0, 10, 50, 100)


@trial(
    "counterflow", "Counterflow", "IMO 8", "ISO 20414 6",
    limits={"least rise of the time, s": Limit(low=0.0), "share arrived": ALL},
    source="MSC.1/Circ.1238, annex 3, test 8: the time rises with the number of people who come",
    seeds=2,
)  # fmt: skip
def counterflow(run: Run) -> Values:
    """Two rooms of 10 × 10 m are joined by a corridor of 2 × 10 m. 100 people walk from one to the
    other, against 0, 10, 50 and 100 who come towards them.
    """
    scene = scene_of(run.place, "counterflow", (0, 0, 30, 10),
                     blocks=[(10, 0, 20, 4), (10, 6, 20, 10)])  # fmt: skip
    last, arrived = [], []
    for against in AGAINST:
        rng = run.rng
        ahead = filled((0, 0, 10, 10), 100, rng, margin_m=0.5)
        back = (filled((20, 0, 30, 10), 100, rng, margin_m=0.5)[rng.permutation(100)])[:against]
        goal = [beside(29.0, (1.0, 9.0), 100, rng), beside(1.0, (1.0, 9.0), against, rng)]
        people = crowd(np.r_[ahead, back], np.r_[goal[0], goal[1]])
        walked = run.walk(Room(scene, people, 600.0, line=(15, 4, 15, 6)))
        mine = walked.start[:, 0] < 15
        last.append(float(left_s(walked)[mine].max()))
        arrived.append(np.isfinite(left_s(walked)[mine]).mean())
    finite = bool(np.isfinite(last).all())
    return {
        "least rise of the time, s": float(np.diff(last).min()) if finite else np.nan,
        "share arrived": float(min(arrived)),
        **{f"last against {n}, s": t for n, t in zip(AGAINST, last, strict=True)},
    }


@trial(
    "door", "Flow through a door", "ISO 20414 11",
    limits={"flow, 1/(m s)": Limit(1.3, 3.3), "share out": ALL},
    source="Daamen and Hoogendoorn 2012: doors of 2.02 to 3.31 persons per metre and second "
    "in the mean; the lower limit is the design value of IMO",
    seeds=5,
)  # fmt: skip
def door(run: Run) -> Values:
    """100 people leave a room of 8 × 5 m through a door of 1 m."""
    room = door_room(run.place, run.rng)
    walked = run.walk(room)
    assert room.line is not None
    return {
        "flow, 1/(m s)": flow_per_s(crossed_s(walked, room.line)),
        "share out": float(np.isfinite(left_s(walked)).mean()),
        "last out, s": last_left_s(walked),
        "highest density before the door, 1/m²": float(densities(walked, (7, 2, 8, 3)).max()),
        "least distance, m": nearest_m(walked),
    }


@trial(
    "imo-1", "Walking speed of 1 m/s in a corridor", "IMO 1", "ISO 20414 2",
    limits={"time, s": Limit(38, 42)},
    source="MSC.1/Circ.1238, annex 3, test 1: 40 s; the tolerance of 5 % is ours",
)  # fmt: skip
def slow_corridor(run: Run) -> Values:
    """One person with a preferred speed of 1 m/s walks 40 m along a corridor 2 m wide."""
    return {"time, s": speed_in_corridor(run, 1.0)}


@trial(
    "imo-4", "Limit of the flow through an exit", "IMO 4",
    limits={"flow over the whole time, 1/s": Limit(high=1.33), "share out": ALL},
    source="MSC.1/Circ.1238, annex 3, test 4: at most 1.33 persons per second, which is less than "
    "at real doors",
)  # fmt: skip
def exit_flow(run: Run) -> Values:
    """100 people leave a room of 8 × 5 m through an exit of 1 m."""
    room = door_room(run.place, run.rng)
    walked = run.walk(room)
    assert room.line is not None
    passed = crossed_s(walked, room.line)
    passed = passed[np.isfinite(passed)]
    flow = len(passed) / passed.max() if len(passed) else float("nan")
    return {
        "flow over the whole time, 1/s": float(flow),
        "share out": float(np.isfinite(left_s(walked)).mean()),
    }


@trial(
    "iso-7", "Overtaking people with disabilities", "ISO 20414 7",
    limits={"share who overtake": Limit(low=0.9), "share out": ALL},
    source=f"ISO 20414:2020, test 7; {OURS}",
)  # fmt: skip
def overtaking(run: Run) -> Values:
    """24 people with 1.25 m/s walk 30 m along a corridor 3 m wide behind one with 0.5 m/s."""
    scene = scene_of(run.place, "overtaking", (0, 0, 38, 3))
    start = np.r_[[[8.0, 1.5]], filled((0, 0, 6, 3), 24, run.rng)]
    people = crowd(
        start, beside(37.0, (0.5, 2.5), 25, run.rng), speed=np.r_[0.5, np.full(24, 1.25)]
    )
    walked = run.walk(Room(scene, people, 120.0))
    times = crossed_s(walked, (35.0, 0.0, 35.0, 3.0))
    slow = walked.start[:, 0] > 7
    ahead = times[~slow] < times[slow][0]
    return {
        "share who overtake": float(ahead.mean()),
        "share out": float(np.isfinite(left_s(walked)).mean()),
    }
