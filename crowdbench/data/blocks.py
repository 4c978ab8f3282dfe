"""Time blocks: the parts of a recording's duration in which crowds are compared.

Observed intervals are cut into blocks of about the same length. Statistics are kept per block, so
that blocks can be dealt into folds (fit on some, score others) and resampled.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.table import PERSON_COLUMNS, Trajectories, is_within

FOLDS = 3
SPLITS = ("full", *(f"fold{k}" for k in range(FOLDS)))
"""The splits that models are fitted for. `full` is the whole recording (protocol `full`). For each
fold of the protocol `heldout`, a model is fitted on the blocks outside the fold and scored on those
in it."""

HELD_OUT = "held-out"
"""Name of rollouts in which those networks walk that were not trained on the current time block."""

_TOLERANCE = 1e-6  # in grid steps, for rounding errors in times


@dataclass(frozen=True, eq=False)
class TimeBlocks:
    """`B` disjoint blocks of frames, in ascending order."""

    frames: Int[np.ndarray, "B 2"]
    """[start, stop) of each block."""
    since: Int[np.ndarray, " B"]
    """First frame of the observed interval in which each block lies."""
    dt_s: float
    """Seconds from one frame to the next."""
    grid_s: float
    """Step of the annotation grid, seconds."""

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def opens(self) -> Bool[np.ndarray, " B"]:
        """True if observation begins with the block.

        People in its first frame were there before, so arrivals are counted from its second
        frame on.
        """
        return self.frames[:, 0] == self.since

    def in_split(self, split: str) -> Bool[np.ndarray, " B"]:
        """Whether each block is scored for models fitted for `split` (one of `SPLITS`).

        Folds are interleaved.
        """
        if split == "full":
            return np.ones(len(self), dtype=bool)
        return np.arange(len(self)) % FOLDS == SPLITS.index(split) - 1

    def turns(self) -> list[tuple[int, str]]:
        """First frame of each block, and the fold that it is scored in; the first is frame 0."""
        starts = [0, *self.frames[1:, 0].tolist()]
        return [(start, SPLITS[1 + k % FOLDS]) for k, start in enumerate(starts)]

    def scored(self, split: str) -> "TimeBlocks":
        """The blocks that models fitted for `split` are scored on."""
        return self.take(self.in_split(split))

    def training(self, split: str) -> "TimeBlocks":
        """The blocks that models are fitted on for `split`."""
        inside = self.in_split(split)
        return self.take(inside if split == "full" else ~inside)

    def take(self, chosen: Bool[np.ndarray, " B"] | Int[np.ndarray, " b"]) -> "TimeBlocks":
        """A subset of the blocks, by mask or by ascending indices."""
        return TimeBlocks(self.frames[chosen], self.since[chosen], self.dt_s, self.grid_s)

    @property
    def arrival_s(self) -> Float[np.ndarray, "B 2"]:
        """Interval [from, to) of each block in which arrivals are counted, seconds."""
        start = self.frames[:, 0] + self.opens
        return np.stack([start, self.frames[:, 1]], axis=1) * self.dt_s

    def exposure_s(self) -> float:
        """Total time in which arrivals are counted, seconds."""
        return float(np.diff(self.arrival_s, axis=1).sum())

    def of_arrivals(
        self, trajectories: Trajectories
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """People who enter in a block: person index, block, and arrival time in grid steps.

        The arrival time is the first grid point at or after `spawn_s`, because an annotator sees a
        person at the first grid point after the entry. Simulated arrivals are treated the same way.
        """
        persons, block, tick = _arrivals(self, trajectories)
        return persons.copy(), block.copy(), tick.copy()  # what is kept is nobody's to change

    def parts(self, trajectories: Trajectories) -> Trajectories:
        """The crowd in these blocks alone: each uninterrupted part of a path is a person.

        Areas, group, goal, entry times and outcome of a part are those of its person.
        """
        seen = is_within(self.frames, trajectories.frames)
        edges = np.flatnonzero(np.diff(seen, prepend=False, append=False))
        frame, person = trajectories.row_frame(), trajectories.row_person()
        rows = np.flatnonzero(seen[frame])
        # From one person to the next, the frame may rise by one, too.
        goes_on = (np.diff(frame[rows]) == 1) & (np.diff(person[rows]) == 0)
        begin = np.flatnonzero(np.r_[True, ~goes_on][: len(rows)])
        size, first = np.diff(np.r_[begin, len(rows)]), frame[rows[begin]]
        order = np.argsort(first, kind="stable")
        offsets = np.concatenate([[0], np.cumsum(size[order])])
        chosen = np.arange(len(rows)) + np.repeat(begin[order] - offsets[:-1], size[order])
        whose = person[rows[begin]][order]
        parts = replace(
            trajectories,
            person_id=np.arange(len(order)),
            first=first[order],
            offsets=offsets,
            xy=trajectories.xy[rows[chosen]],
            **{name: getattr(trajectories, name)[whose] for name in PERSON_COLUMNS},
        )
        return parts.observed_in(edges.reshape(-1, 2))


@lru_cache(maxsize=1)  # several metrics use the arrivals of the same crowd
def _arrivals(
    blocks: TimeBlocks, trajectories: Trajectories
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    persons = np.flatnonzero(trajectories.entered)
    tick = np.ceil(trajectories.spawn_s[persons] / blocks.grid_s - _TOLERANCE).astype(np.int64)
    at = tick * blocks.grid_s + _TOLERANCE * blocks.grid_s
    begin, stop = blocks.arrival_s.T
    block = np.searchsorted(begin, at, side="right") - 1
    inside = (block >= 0) & (at < stop[np.maximum(block, 0)])
    order = np.lexsort((persons[inside], tick[inside]))
    return persons[inside][order], block[inside][order], tick[inside][order]


def cut(
    observed: Int[np.ndarray, "I 2"], *, block_s: float, dt_s: float, grid_s: float
) -> TimeBlocks:
    """Cut each observed interval into equal blocks, as close to `block_s` in length as possible.

    Every observed frame belongs to a block: an interval shorter than `block_s` is one block.
    """
    frames: list[tuple[int, int]] = []
    since: list[int] = []
    for start, stop in observed:
        count = max(1, round((stop - start) * dt_s / block_s))
        edges = np.linspace(start, stop, count + 1).round().astype(np.int64)
        frames += pairwise(edges)
        since += [start] * count
    return TimeBlocks(np.array(frames), np.array(since), dt_s, grid_s)
