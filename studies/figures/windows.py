"""Windows of 20 s of a crowd, and distances between two such windows.

All parts of the distance are counted in people, so that they can be added.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.spawn.areas import Areas

WINDOW_S = 20.0
STARTS = 10
"""Number of windows that begin within the length of one window."""
GROUP_S = 0.8
"""People who enter at the same area within one step of this many seconds form a group. It is the
coarsest annotation grid of all scenes, so that groups are defined equally in all of them."""
_LARGEST = 40
"""Maximum group size that is counted exactly; further members are added to the last count."""


@dataclass(frozen=True, eq=False)
class Windows:
    """`n` windows of `T` frames, which may overlap; every frame is observed."""

    start: Int[np.ndarray, " n"]
    """First frame of each window."""
    ways: Int[np.ndarray, "n C"]
    """Number of people who enter, by spawn and goal area; the last area is the unknown one."""
    members: Int[np.ndarray, "n 40"]
    """Number of people who enter as the first, second, … member of a group (see `GROUP_S`)."""
    present: Int[np.ndarray, "n T"]
    """Number of people present in each frame."""

    @classmethod
    def of(cls, crowd: Trajectories, areas: Areas) -> "Windows":
        """All windows of a crowd whose people are labelled with areas."""
        frames = round(WINDOW_S / crowd.dt_s)
        step = max(1, round(frames / STARTS))
        start = np.concatenate([np.arange(a, b - frames + 1, step) for a, b in crowd.observed])
        blocks = TimeBlocks(crowd.observed, crowd.observed[:, 0], crowd.dt_s, crowd.grid_s)
        who, _, tick = blocks.of_arrivals(crowd)
        spawns, goals = len(areas.spawn) + 1, len(areas.goal) + 1
        spawn, goal = crowd.spawn_area[who] % spawns, crowd.goal_area[who] % goals  # −1 is last
        moment = _whole(tick * crowd.grid_s / GROUP_S)
        at = _whole(tick * crowd.grid_s / crowd.dt_s)
        low, high = np.searchsorted(at, start), np.searchsorted(at, start + frames)
        seen = np.repeat(low - np.r_[0, (high - low).cumsum()[:-1]], high - low)
        seen += np.arange(len(seen))  # arrivals, window by window
        window = np.repeat(np.arange(len(start)), high - low)
        ways = np.zeros((len(start), spawns * goals), np.int16)
        np.add.at(ways, (window, spawn[seen].astype(np.int64) * goals + goal[seen]), 1)
        members = np.zeros((len(start), _LARGEST), np.int16)
        place = _place_in_group(np.stack([window, spawn[seen], moment[seen]], axis=1))
        np.add.at(members, (window, np.minimum(place, _LARGEST - 1)), 1)
        present = crowd.present()[start[:, None] + np.arange(frames)].astype(np.int16)
        return cls(start, ways, members, present)

    def __len__(self) -> int:
        return len(self.start)

    @property
    def frames(self) -> int:
        """Number of frames per window."""
        return self.present.shape[1]

    @property
    def entered(self) -> Int[np.ndarray, " n"]:
        """Number of people who enter in each window."""
        return self.members.sum(axis=1)

    @property
    def largest(self) -> Int[np.ndarray, " n"]:
        """Size of the largest group in each window; 0 if nobody enters."""
        return (self.members > 0).sum(axis=1)

    @property
    def alone(self) -> Int[np.ndarray, " n"]:
        """Number of people who enter alone in each window."""
        return self.members[:, 0] - self.members[:, 1]

    def apart(self, other: "Windows", k: int) -> Float[np.ndarray, "n 3"]:
        """Distances of each window from window `k` of `other`: by routes, groups and presence.

        Routes: sum over pairs of spawn and goal area of the absolute differences in the numbers of
        people who enter. Groups: the same sum over first, second, … members of groups. Presence:
        mean over time of the absolute difference in people present. The distance is their sum.
        """
        return np.stack(
            [
                np.abs(self.ways - other.ways[k]).sum(axis=1, dtype=np.float64),
                np.abs(self.members - other.members[k]).sum(axis=1, dtype=np.float64),
                np.abs(self.present - other.present[k]).mean(axis=1, dtype=np.float64),
            ],
            axis=1,
        )

    def away_from(self, k: int) -> np.ndarray:
        """Whether each window shares no frame with window `k`."""
        return np.abs(self.start - self.start[k]) >= self.frames


def situations(windows: Windows, areas: Areas) -> dict[str, tuple[int, int]]:
    """Index of one window of each kind, and the number of people who show it; none overlap.

    large group: the window with the largest group. small group: the window whose largest group is
    smallest, but has at least two people. single walkers: the most people who enter alone. strong
    flow: the most people from one spawn area to one goal area. Ties are resolved by the fewest
    people who enter, then by the most people present.
    """
    shape = (len(windows), len(areas.spawn) + 1, len(areas.goal) + 1)
    strongest = windows.ways.reshape(shape)[:, :-1, :-1].max(axis=(1, 2))
    grouped = np.where(windows.largest >= 2, windows.largest, 0)
    shown = {
        "large group": (grouped, grouped),
        "small group": (grouped, np.where(grouped > 0, _LARGEST + 1 - grouped, 0)),
        "single walkers": (windows.alone, windows.alone),
        "strong flow": (strongest, strongest),
    }
    free = np.ones(len(windows), dtype=bool)
    found = {}
    for kind, (people, wanted) in shown.items():
        rank = np.where(free, wanted, 0).astype(np.int64)
        k = int(np.lexsort((-windows.present.sum(axis=1), windows.entered, -rank))[0])
        if rank[k] > 0:
            found[kind] = (k, int(people[k]))
            free &= windows.away_from(k)
    return found


def _whole(steps: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Number of whole steps, tolerating rounding errors of times."""
    return np.floor(steps + 1e-6).astype(np.int64)


def _place_in_group(group: Int[np.ndarray, "n k"]) -> Int[np.ndarray, " n"]:
    """0 for the first member of each group, 1 for the second, and so on."""
    order = np.lexsort(group.T)
    new = np.r_[True, (np.diff(group[order], axis=0) != 0).any(axis=1)][: len(group)]
    first = np.maximum.accumulate(np.where(new, np.arange(len(group)), 0))
    place = np.empty(len(group), dtype=np.int64)
    place[order] = np.arange(len(group)) - first
    return place
