"""Smoothed paths: what is kept, and how much noise is left."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench.data.table import Trajectories, from_rows
from crowdbench.envs.demonstrations import smoothed

DT_S, WINDOW_S = 0.4, 3.2


def crowd(paths: list[np.ndarray]) -> Trajectories:
    """People who enter one after the other and walk along paths (n, 2)."""
    frame = np.concatenate([np.arange(len(path)) for path in paths])
    person = np.repeat(np.arange(len(paths)), [len(path) for path in paths])
    return from_rows(
        scene="made-up",
        dt_s=DT_S,
        person_id=person,
        frame=frame,
        xy=np.concatenate(paths),
        where="test",
    )


@given(
    st.lists(st.integers(2, 40), min_size=1, max_size=4),
    st.lists(st.floats(-3, 3), min_size=6, max_size=6),
)
@settings(max_examples=30, deadline=None)
def test_constant_accelerations_are_kept(lengths: list[int], numbers: list[float]) -> None:
    start, velocity, acceleration = np.reshape(numbers, (3, 2))
    times = [DT_S * np.arange(n)[:, None] for n in lengths]
    paths = crowd([start + velocity * t + 0.05 * acceleration * t * t for t in times])
    np.testing.assert_allclose(smoothed(paths, WINDOW_S).xy, paths.xy, atol=1e-3)


def test_noise_shrinks_as_in_a_quadratic_fit_and_everyone_begins_where_recorded() -> None:
    rng = np.random.default_rng(0)
    straight = np.stack([1.3 * DT_S * np.arange(60), np.zeros(60)], axis=1)
    noisy = crowd([straight + rng.normal(0, 0.05, straight.shape) for _ in range(300)])
    found = smoothed(noisy, WINDOW_S)
    first = noisy.offsets[:-1]
    np.testing.assert_array_equal(found.xy[first], noisy.xy[first])
    off = (found.xy - np.tile(straight, (300, 1))).reshape(300, 60, 2)[:, 10:-10]
    # The middle weight of nine points and degree 2 is 59/231: the variance that is left.
    assert off.std() == pytest.approx(0.05 * np.sqrt(59 / 231), rel=0.05)


def test_short_windows_change_nothing_and_short_paths_are_fitted_as_a_whole() -> None:
    rng = np.random.default_rng(1)
    paths = crowd([rng.normal(size=(n, 2)) for n in (2, 3, 4, 5, 7)])
    assert smoothed(paths, 0.0) is paths
    assert smoothed(paths, 0.8) is paths
    found = smoothed(paths, WINDOW_S)
    kept = paths.offsets[3]  # paths of two, three and four points have no more than three to fit
    np.testing.assert_array_equal(found.xy[:kept], paths.xy[:kept])
    assert not np.array_equal(found.xy[kept:], paths.xy[kept:])
    assert replace(found, xy=paths.xy).offsets is paths.offsets
