"""TripMixtures as they are written in `plans.json`, and checked when they are read."""

import msgspec
import numpy as np
from jaxtyping import Float, Int

from crowdbench.errors import WeightsError
from crowdbench.spawn.areas import as_array
from crowdbench.spawn.plans.mixtures import DECIMALS
from crowdbench.spawn.plans.trip_mixtures import TRIP, Places, TripMixtures


class _Places(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    area: list[int]
    weight: list[float]
    mean: list[list[float]]
    covariance: list[list[list[float]]]


class TripsFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Arrays of `TripMixtures`, as nested lists."""

    starts: _Places
    goals: _Places
    log_speed: list[float]
    weight: list[list[float]]
    own: list[tuple[int, int]]
    mean: list[list[float]]
    covariance: list[list[list[float]]]


def written_trips(trips: TripMixtures) -> TripsFile:
    """TripMixtures with rounded numbers, to be written."""

    def rounded(values: np.ndarray) -> list:
        return values.round(DECIMALS).tolist()

    starts, goals = (
        _Places(
            area=of.area.tolist(),
            weight=rounded(of.weight),
            mean=rounded(of.mean),
            covariance=rounded(of.covariance),
        )
        for of in (trips.starts, trips.goals)
    )
    return TripsFile(
        starts=starts,
        goals=goals,
        log_speed=rounded(trips.log_speed),
        weight=rounded(trips.weight),
        own=[(i, j) for i, j in trips.own.tolist()],
        mean=rounded(trips.mean),
        covariance=rounded(trips.covariance),
    )


def read_trips(file: TripsFile, areas: tuple[int, int], where: str, hint: str) -> TripMixtures:
    """TripMixtures between so many spawn and goal areas.

    Raises:
        WeightsError: arrays have other shapes than they should, or impossible values.
    """
    starts = _read_places(file.starts, areas[0], f"{where}.starts", hint)
    goals = _read_places(file.goals, areas[1], f"{where}.goals", hint)
    weight = as_array(file.weight, (len(starts), len(goals)), f"{where}.weight", hint)
    # Weights in the rows and columns of two areas sum to 1.
    rows = np.stack([weight[starts.area == a].sum(axis=0) for a in range(areas[0])])
    _check_shares(weight, rows, goals.area, f"{where}.weight", hint)
    log_speed = as_array(file.log_speed, (2,), f"{where}.log_speed", hint)
    _check(float(log_speed[1]) > 0, f"{where}.log_speed", "a mean and a positive variance", hint)
    count = len(file.own)
    known = all(0 <= i < len(starts) and 0 <= j < len(goals) for i, j in file.own)
    different = known and len(set(file.own)) == count
    _check(different, f"{where}.own", "different pairs of places", hint)
    own = np.array(file.own, dtype=np.int64).reshape(-1, 2)
    mean, covariance = np.zeros((0, TRIP)), np.zeros((0, TRIP, TRIP))
    if count or file.mean or file.covariance:
        mean = as_array(file.mean, (count, TRIP), f"{where}.mean", hint)
        covariance = as_array(file.covariance, (count, TRIP, TRIP), f"{where}.covariance", hint)
        check_covariances(covariance, f"{where}.covariance", hint)
    return TripMixtures(starts, goals, log_speed, weight, own, mean, covariance)


def _read_places(file: _Places, areas: int, where: str, hint: str) -> Places:
    """Places in so many areas.

    Raises:
        WeightsError: arrays have other shapes than they should, or impossible values.
    """
    every = set(file.area) == set(range(areas))
    _check(every, f"{where}.area", f"places in all of {areas} areas", hint)
    area = np.array(file.area, dtype=np.int64)
    weight = as_array(file.weight, (len(area),), f"{where}.weight", hint)
    _check_shares(weight, weight[None], area, f"{where}.weight", hint)
    covariance = as_array(file.covariance, (len(area), 2, 2), f"{where}.covariance", hint)
    check_covariances(covariance, f"{where}.covariance", hint)
    return Places(
        area, weight, as_array(file.mean, (len(area), 2), f"{where}.mean", hint), covariance
    )


def _check_shares(
    weight: np.ndarray,
    rows: Float[np.ndarray, "K J"],
    area: Int[np.ndarray, " J"],
    where: str,
    hint: str,
) -> None:
    """Check that weights are not negative, and that those of an area sum to 1 in each row."""
    sums = np.stack([rows[:, area == g].sum(axis=1) for g in np.unique(area)])
    shares = bool((weight >= 0).all() and np.allclose(sums, 1, atol=1e-3))
    _check(shares, where, "shares that sum to 1", hint)


def check_covariances(covariance: Float[np.ndarray, "*n D D"], where: str, hint: str) -> None:
    """Check that they are symmetric and positive definite.

    Raises:
        WeightsError: some are not.
    """
    symmetric = bool(np.allclose(covariance, covariance.swapaxes(-1, -2)))
    definite = bool((np.linalg.eigvalsh(covariance) > 0).all()) if covariance.size else True
    _check(symmetric and definite, where, "symmetric, positive definite matrices", hint)


def _check(holds: bool, where: str, expected: str, hint: str) -> None:
    if not holds:
        raise WeightsError(where, got="invalid values", expected=expected, hint=hint)
