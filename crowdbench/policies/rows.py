"""Test of row independence: a network must compute each person's action from that person's row.

The file alone does not show this, so it is tested by running the network. Before rollouts, actions
of single rows are compared with those of batches of many sizes and orders, on random observations.
During rollouts, the batch is regularly split into two parts and evaluated again, also whenever it
is larger than before: this finds networks that mix rows only in some states of a crowd.

A network with a memory could write what it learns of others into a state, by less than the
tolerance, and read it in the next step. So its states are rounded far coarser before they are kept,
and in tests they must be equal but for few; and it is given the persons in small parts at random.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Int
from numpy.random import Generator

from crowdbench.errors import WeightsError

TOLERANCE = 1e-5
"""Tolerance for the components of an action, which lie in [−1, 1]. Sums in a batch may be computed
in another order than for a single row, which changes the actions of shipped networks by up to
1.2e-6."""
GRID = 2.0**-12
"""States are rounded to multiples of this, beyond ±1 of as much of the power of two below them."""
FLIPS = 0.02
"""Largest share of persons for whom rounding may change one number of the state. It is 0.4 % where
sums in a batch change states by 1e-6."""
PART = 8
"""Largest number of persons that a network with a memory is given at once."""
EVERY = 16
"""Interval between two tests in a rollout, in steps."""
SIZES = (2, 3, 4, 5, 8, 13, 34, 100, 1000, 4096)
"""Sizes of the batches that are tested before rollouts; larger ones are tested when they occur."""
ROWS = 256
"""Number of observations to test before rollouts."""

Fed = dict[str, np.ndarray]
Run = Callable[[Fed], Float32[np.ndarray, "A _"]]
"""A network: actions (A, 2) and, beside them, next states (A, M) of the inputs."""


def check_rows(where: object, run: Run, fed: Fed) -> None:
    """Compare the actions of batches of rows with those of the single rows.

    Raises:
        WeightsError: the actions differ.
    """
    rng = np.random.default_rng(0)
    rows = len(fed["observation"])
    alone = np.concatenate([run(_rows(fed, np.array([k]))) for k in range(rows)])
    orders = [rng.permutation(rows), np.arange(rows)[::-1]]
    orders += [rng.integers(rows, size=size) for size in SIZES]
    for order in orders:
        together = run(_rows(fed, order))
        wrong = _gap(alone[order], together) > TOLERANCE
        if too_many(wrong.sum(), len(order)):
            k = int(np.flatnonzero(wrong)[0])
            raise _mixes(where, (together[k], len(order)), (alone[order[k]], 1))
        _check_flips(where, _flips(alone[order], together), len(order))


class Watch:
    """Tests row independence during one rollout."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._calls = self._most = 0
        self._wrong = self._rows = 0
        self._flips: np.ndarray | int = 0

    def look(self, run: Run, fed: Fed, action: Float32[np.ndarray, "A _"]) -> None:
        """Evaluate the batch again in two parts, if a test is due.

        Raises:
            WeightsError: the actions differ.
        """
        self._calls += 1
        persons = len(action)
        if persons < 2 or not (self._calls % EVERY == 0 or persons > 1.05 * self._most):
            return
        self._most = max(self._most, persons)
        # A separate generator, so that the test does not change the crowd.
        rng = np.random.default_rng(self._calls)
        order = rng.permutation(persons)
        cut = int(rng.integers(1, persons))
        for part in (order[:cut], order[cut:]):
            again = run(_rows(fed, part))
            wrong = _gap(action[part], again) > TOLERANCE
            self._wrong, self._rows = self._wrong + int(wrong.sum()), self._rows + len(part)
            if too_many(wrong.sum(), len(part)) or too_many(self._wrong - 1, self._rows, 1000):
                k = int(np.flatnonzero(wrong)[0])
                raise _mixes(self._path, (action[part[k]], persons), (again[k], len(part)))
            self._flips = self._flips + _flips(action[part], again)
            _check_flips(self._path, self._flips, self._rows)


def _gap(
    one: Float32[np.ndarray, "A _"], other: Float32[np.ndarray, "A _"]
) -> Float32[np.ndarray, " A"]:
    """Largest difference in each row, of actions after clipping to [−1, 1] as in a rollout.

    Of states beyond ±1, the relative difference counts. NaN remains: rollouts reject it elsewhere.
    """
    size = np.ones_like(one)
    size[:, 2:] = np.maximum(1, np.abs(one[:, 2:]))
    with np.errstate(invalid="ignore"):
        apart = np.abs(one - other)
        apart[:, :2] = np.abs(one[:, :2].clip(-1, 1) - other[:, :2].clip(-1, 1))
        gap: np.ndarray = (apart / size).max(axis=1)
    return gap


def kept(states: Float32[np.ndarray, "A M"]) -> Float32[np.ndarray, "A M"]:
    """States as they are kept: rounded, so that sums in a batch hardly ever change them."""
    with np.errstate(invalid="ignore", over="ignore"):
        step = GRID * np.exp2(np.floor(np.log2(np.maximum(1, np.abs(states)))))
        return np.asarray(np.rint(states / step) * step, dtype=np.float32)


def in_parts(run: Run, fed: Fed, rng: Generator) -> Float32[np.ndarray, "A _"]:
    """The answers of a network to all rows, given to it in parts of up to `PART` at random."""
    order = rng.permutation(len(fed["observation"]))
    parts = np.array_split(order, -(-len(order) // PART))
    found = np.concatenate([run(_rows(fed, part)) for part in parts])
    answers = np.empty_like(found)
    answers[order] = found
    return answers


def _flips(
    one: Float32[np.ndarray, "A _"], other: Float32[np.ndarray, "A _"]
) -> Int[np.ndarray, " M"]:
    """For how many persons each number of the kept state differs."""
    return np.asarray((kept(one[:, 2:]) != kept(other[:, 2:])).sum(axis=0))


def _check_flips(where: object, flips: np.ndarray | int, rows: int) -> None:
    """Raises WeightsError if a number of the state differs for more persons than by rounding."""
    most = int(np.max(flips, initial=0))
    if most > 2 + FLIPS * rows:
        raise WeightsError(
            where,
            got=f"a network that mixes rows: one number of the next state of {most} of {rows} "
            "persons depends on who else is in the batch",
            expected=f"at most {FLIPS:.0%}, by rounding to multiples of 1/{1 / GRID:g}",
            hint="Remove operations over the persons (axis 0).",
        )


def too_many(wrong: int | np.integer, rows: int, one_in: int = 100) -> bool:
    """Whether so many differing rows cannot be due to rounding.

    A few differing rows are allowed: in a network that chooses between actions, rounding may change
    the choice.
    """
    return bool(wrong > 1 + rows / one_in)


def _rows(fed: Fed, which: Int[np.ndarray, " n"]) -> Fed:
    return {name: np.ascontiguousarray(values[which]) for name, values in fed.items()}


def _mixes(
    where: object, one: tuple[np.ndarray, int], other: tuple[np.ndarray, int]
) -> WeightsError:
    def told(answer: tuple[np.ndarray, int]) -> str:
        action, persons = answer
        among = "alone" if persons == 1 else f"in a batch of {persons}"
        return f"({action[0]:.4g}, {action[1]:.4g}) {among}"

    gap = float(_gap(one[0][None], other[0][None])[0])
    of_state = float(_gap(one[0][None, :2], other[0][None, :2])[0]) <= TOLERANCE
    return WeightsError(
        where,
        got=f"a network that mixes rows: the same person gets {told(one)} and {told(other)}, "
        f"a difference of {gap:.2g}" + " in the next state" * of_state,
        expected=f"the same action within {TOLERANCE:g}, computed from the person's row alone",
        hint="Remove operations over the persons (axis 0): means, sums, softmax, attention, batch "
        "statistics, dynamic quantisation.",
    )
