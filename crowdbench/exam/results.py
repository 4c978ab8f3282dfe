"""Results of an exam."""

from collections.abc import Sequence

import msgspec
import numpy as np

from crowdbench.exam.trial import Trial, Values

SCHEMA = 1


class Measured(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A measured value over the seeds. None stands for what did not happen, such as an arrival."""

    name: str
    """What is measured, with its unit."""
    mean: float | None
    low: float | None
    """Smallest value of a seed."""
    high: float | None
    """Largest value of a seed."""
    limit: str | None
    """Where the mean must lie; None if the value is for information."""
    holds: bool | None
    """Whether it does; None without a limit."""


class TrialResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The result of a policy in one test."""

    id: str
    title: str
    guidelines: tuple[str, ...]
    seeds: int
    measured: tuple[Measured, ...]
    passed: bool
    random_passes: bool | None
    """Whether random walkers pass, too: then passing says little. None if it was not asked."""


class Certificate(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The results of a policy in all tests."""

    schema: int = SCHEMA
    crowdbench: str
    policy: str
    scene: str
    """The scene whose time step, limits of motion and trained policies were used."""
    dt_s: float
    body_radius_m: float
    tests: tuple[TrialResult, ...]

    @property
    def passed(self) -> int:
        """Number of tests passed."""
        return sum(test.passed for test in self.tests)


def result_of(
    trial: Trial, values: Sequence[Values], *, random_passes: bool | None = None
) -> TrialResult:
    """The result of a test from the values of each seed."""
    measured = tuple(_measured(trial, name, [of[name] for of in values]) for name in values[0])
    return TrialResult(
        id=trial.id,
        title=trial.title,
        guidelines=trial.guidelines,
        seeds=len(values),
        measured=measured,
        passed=all(of.holds for of in measured if of.limit is not None),
        random_passes=random_passes,
    )


def failed(trial: Trial) -> TrialResult:
    """The result of a policy that raised an error."""
    return TrialResult(
        id=trial.id,
        title=trial.title,
        guidelines=trial.guidelines,
        seeds=0,
        measured=(),
        passed=False,
        random_passes=None,
    )


def _measured(trial: Trial, name: str, values: Sequence[float]) -> Measured:
    limit = trial.limits.get(name)
    mean, low, high = float(np.mean(values)), float(np.min(values)), float(np.max(values))

    def known(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return Measured(
        name=name,
        mean=known(mean),
        low=known(low),
        high=known(high),
        limit=None if limit is None else str(limit),
        holds=None if limit is None else limit.holds(mean),
    )
