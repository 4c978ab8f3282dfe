"""Scorecards: how resamples are stored."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.scorecard import STEPS, pack, unpack


@given(centre=st.floats(-1e6, 1e6), spread=st.floats(0, 1e6), off=st.floats(-1e6, 1e6))
def test_packed_resamples_are_as_fine_as_their_spread(
    centre: float, spread: float, off: float
) -> None:
    resampled = centre + off + spread * np.random.default_rng(0).standard_normal(RESAMPLES)
    largest = np.abs(resampled - centre).max()
    found = unpack(centre, pack(centre, resampled))
    allowed = max(resampled.std() / STEPS / 2, largest / np.iinfo(np.int16).max)
    assert (
        np.abs(found - resampled).max() <= allowed + 1e-15 * abs(centre) + np.finfo(np.float32).tiny
    )


def test_equal_resamples_stay_equal() -> None:
    assert np.array_equal(
        unpack(-1.0, pack(-1.0, np.full(RESAMPLES, -1.0))), np.full(RESAMPLES, -1.0)
    )
