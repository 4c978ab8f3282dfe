"""Which encounters of a recording are typical, found by rules.

Pairs of strangers are considered when they are closest, if that is less than 2.5 m and both walk
(0.5 m/s or more) before. The angle between their velocities decides:

- `meeting`: more than 150°, and one of them has a companion;
- `crossing`: from 60° to 120°;
- `overtaking`: less than 30°, and one of them comes from behind the other and leaves in front.

A `stop` is a person's longest one. A `passage` is somebody who walks through the place where most
people come within 1 m of a wall. Of each kind, the encounter with the median distance, wait or
clearance is typical. Its window is from 4 s before it to 4 s after it. Its people are there all the
time, except in passages, which are often entrances.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.stops import STANDING_MPS
from crowdbench.data.table import Trajectories
from crowdbench.metrics.interaction import clearance
from crowdbench.scene import Scene
from crowdbench.spawn.recorded_plans import plans_of

AROUND_S = 4.0
NEAR_M = 2.5
WALKS_MPS = 0.5
WALL_M = 1.0
CELL_M = 1.0
_HEAD_ON, _ACROSS, _ALONG = 150.0, (60.0, 120.0), 30.0
_BEHIND_M = 0.5
_LEAST = 3
"""Fewer encounters of a kind have no typical one."""

UNITS = {
    "meeting": "closest distance, m",
    "crossing": "closest distance, m",
    "overtaking": "closest distance, m",
    "stop": "time stood, s",
    "passage": "closest wall, m",
}


@dataclass(frozen=True)
class Encounter:
    """An encounter of one or two people of a recording."""

    kind: str
    people: tuple[int, ...]
    """Indices in the recording."""
    frame: int
    first: int
    """First frame of the window that is shown."""
    stop: int
    """Frame after its last one."""
    chosen_from: int
    """Number of encounters of this kind in the recording."""
    walls: tuple[tuple[tuple[float, float], ...], ...] = ()

    @property
    def unit(self) -> str:
        """What is measured, with its unit."""
        return UNITS[self.kind]

    def measure(self, paths: Mapping[int, Float[np.ndarray, "_ 2"]], dt_s: float) -> float | None:
        """What is measured of its people, in metres or seconds; None if they are never there."""
        own = [paths[p] for p in self.people if p in paths]
        if len(own) < len(self.people):
            return None
        if self.kind == "stop":
            speed = np.hypot(*np.diff(own[0], axis=0).T) / dt_s
            return float((speed < STANDING_MPS).sum() * dt_s)  # NaN is not slow
        if self.kind == "passage":
            there = own[0][~np.isnan(own[0][:, 0])]
            return float(clearance(self.walls, there).min())
        gap = np.hypot(*(own[0] - own[1]).T)
        return None if np.isnan(gap).all() else float(np.nanmin(gap))


def typical_encounters(scene: Scene, crowd: Trajectories, blocks: TimeBlocks) -> list[Encounter]:
    """The typical encounter of each kind that the recording has, in the order of `UNITS`."""
    around = round(AROUND_S / crowd.dt_s)
    walls = tuple(wall.corners_m for wall in scene.walls)
    by_kind = _pairs(crowd, around) | {"stop": _stops(crowd, around)}
    if walls:
        by_kind["passage"] = _passages(crowd, walls)
    found = []
    for kind in UNITS:
        people, frame, value = by_kind.get(kind, _NONE)
        # The whole window lies in one block, so that a network was trained on none of it.
        block = np.searchsorted(blocks.frames[:, 0], frame, side="right") - 1
        inside = (block >= 0) & (frame - around >= blocks.frames[np.maximum(block, 0), 0])
        inside &= frame + around < blocks.frames[np.maximum(block, 0), 1]
        people, frame, value = people[inside], frame[inside], value[inside]
        if len(frame) < _LEAST:
            continue
        k = int(np.lexsort((frame, value))[len(value) // 2])
        at = int(frame[k])
        who = tuple(people[k].tolist())
        found.append(Encounter(kind, who, at, at - around, at + around + 1, len(frame), walls))
    return found


_Found = tuple[Int[np.ndarray, "n k"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]
"""People, frame and measure of each encounter."""
_NONE: _Found = (np.empty((0, 1), np.int64), np.empty(0, np.int64), np.empty(0))


def _pairs(crowd: Trajectories, around: int) -> dict[str, _Found]:
    """Meetings, crossings and overtakings."""
    people, frame, apart = _closest(crowd, around)
    row = crowd.offsets[people] + frame[:, None] - crowd.first[people]
    xy = crowd.xy.astype(np.float64)
    begin, before, after = row - around, row - around // 2, row + around
    velocity = (xy[before] - xy[begin]) / ((around - around // 2) * crowd.dt_s)
    speed = np.linalg.norm(velocity, axis=2)
    dot = (velocity[:, 0] * velocity[:, 1]).sum(axis=1)
    cosine = dot / np.maximum(speed.prod(axis=1), 1e-9)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    walk = (speed >= WALKS_MPS).all(axis=1)
    way = velocity.sum(axis=1)
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    ahead = [((xy[at[:, 0]] - xy[at[:, 1]]) * way).sum(axis=1) for at in (begin, after)]
    passes = (ahead[0] * ahead[1] < 0) & (np.abs(ahead) >= _BEHIND_M).all(axis=0)
    grouped = (crowd.group[people] >= 0).any(axis=1)
    kinds: dict[str, Bool[np.ndarray, " n"]] = {
        "meeting": (angle > _HEAD_ON) & grouped,
        "crossing": (angle >= _ACROSS[0]) & (angle <= _ACROSS[1]),
        "overtaking": (angle < _ALONG) & passes,
    }
    return {
        kind: (people[is_one & walk], frame[is_one & walk], apart[is_one & walk])
        for kind, is_one in kinds.items()
    }


def _closest(crowd: Trajectories, around: int) -> _Found:
    """Pairs of strangers who come near each other, with the frame in which they are closest."""
    from scipy.spatial import cKDTree

    frame, person = crowd.row_frame(), crowd.row_person()
    order = np.argsort(frame, kind="stable")
    edges = np.searchsorted(frame[order], np.arange(crowd.frames + 1))
    lots = [np.empty((0, 4))]
    for f, (a, b) in enumerate(pairwise(edges.tolist())):
        rows = order[a:b]
        near = cKDTree(crowd.xy[rows]).query_pairs(NEAR_M, output_type="ndarray")
        if len(near):
            one, other = np.sort(rows[near], axis=1).T
            gap = np.hypot(*(crowd.xy[one] - crowd.xy[other]).T)
            lots.append(np.stack([person[one], person[other], np.full(len(gap), f), gap], axis=1))
    one, other, at, gap = np.concatenate(lots).T
    strangers = (crowd.group[one.astype(int)] != crowd.group[other.astype(int)]) | (
        crowd.group[one.astype(int)] < 0
    )
    one, other, at, gap = (x[strangers] for x in (one, other, at, gap))
    order = np.lexsort((at, gap, other, one))
    new = np.r_[True, (np.diff(one[order]) != 0) | (np.diff(other[order]) != 0)][: len(order)]
    first = order[new]
    people = np.stack([one[first], other[first]], axis=1).astype(np.int64)
    frame = at[first].astype(np.int64)
    whole = (crowd.first[people] <= frame[:, None] - around).all(axis=1)
    whole &= (crowd.last[people] >= frame[:, None] + around).all(axis=1)
    return people[whole], frame[whole], gap[first][whole]


def _stops(crowd: Trajectories, around: int) -> _Found:
    """The longest stop of each person, from its begin on."""
    plans = plans_of(crowd)
    person = np.flatnonzero(plans.wait_s > 0)
    waited = np.round(plans.wait_s[person] / crowd.dt_s).astype(np.int64)
    row = plans.resumed[person] - waited
    frame = crowd.first[person] + row - crowd.offsets[person]
    whole = (crowd.first[person] <= frame - around) & (crowd.last[person] >= frame + around)
    return person[whole][:, None], frame[whole], plans.wait_s[person][whole]


def _passages(crowd: Trajectories, walls: tuple[tuple[tuple[float, float], ...], ...]) -> _Found:
    """People in the cell of a square metre, near walls, through which most people walk."""
    xy, person = crowd.xy.astype(np.float64), crowd.row_person()
    distance = clearance(walls, xy)
    near = np.flatnonzero((distance > 0) & (distance < WALL_M))
    cell = np.floor(xy[near] / CELL_M).astype(np.int64)
    visits = np.unique(np.column_stack([cell, person[near]]), axis=0)  # a person counts once
    if len(visits) == 0:
        return _NONE
    cells, count = np.unique(visits[:, :2], axis=0, return_counts=True)
    here = near[(cell == cells[count.argmax()]).all(axis=1)]
    order = np.lexsort((distance[here], person[here]))
    nearest = here[order][np.r_[True, np.diff(person[here][order]) != 0]]
    return person[nearest][:, None], crowd.row_frame()[nearest], distance[nearest]
