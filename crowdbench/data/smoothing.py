"""Smoothed paths: recorded positions without most of the noise of annotations."""

from dataclasses import replace

import numpy as np

from crowdbench.data.table import Trajectories

_DEGREE = 2  # degree of the polynomials: a constant acceleration is not changed


def smoothed(recording: Trajectories, window_s: float) -> Trajectories:
    """The recording with positions from a Savitzky-Golay filter of degree 2.

    Each position is that of the quadratic that fits best within a window of `window_s` seconds
    around it (Savitzky & Golay 1964, Analytical Chemistry 36, 1627), at the ends of a path within
    its first or last window. Paths that are shorter than the window are fitted as a whole. The
    first position of each path is kept. Windows of less than five frames change nothing.
    """
    frames = 2 * round(window_s / recording.dt_s / 2) + 1
    if frames <= _DEGREE + 1:
        return recording
    from scipy.signal import savgol_filter

    xy = recording.xy.astype(np.float64)
    for start, stop in zip(recording.offsets[:-1], recording.offsets[1:], strict=True):
        width = min(frames, (stop - start - 1) // 2 * 2 + 1)
        if width > _DEGREE + 1:
            path = savgol_filter(xy[start:stop], width, _DEGREE, axis=0, mode="interp")
            xy[start + 1 : stop] = path[1:]
    return replace(recording, xy=xy.astype(recording.xy.dtype))
