"""Rules that determine the settings of a new scene from its recording.

The shipped scenes follow these rules exactly or approximately. All settings can be changed in
`scene.toml` afterwards; then the scene must be fitted again.
"""

import math

import numpy as np

from crowdbench.data.blocks import FOLDS
from crowdbench.data.recordings.noise import noise_of
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError
from crowdbench.scene import Bounds, Clustering, Motion, Protocol, Spawning, Walking

MARGIN_M = 0.5
"""Bounds are at least this far from all positions, and are multiples of it."""
EPS_M = (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0)
"""Candidates for the radius ε of DBSCAN, in metres."""
LEFT_OUT = 0.1
"""The first of `EPS_M` is used that leaves less than this share of starts, and of ends, in no
cluster."""
WIDEST_M = 4.0
"""Largest standard deviation of an area; doors are narrower."""
PERSONS_ROOT = 6.0
"""A cluster has at least √(number of persons) / 6 persons, and at least three."""
BLOCKS_S = ((270.0, 20.0), (480.0, 30.0), (1800.0, 60.0), (7200.0, 120.0), (math.inf, 600.0))
"""Pairs of the maximum observed duration and the length of time blocks, both in seconds."""
LONG_BLOCK_S = 120.0
"""Blocks of at least this length are resampled in runs of three, because crowds drift."""
SHORT_BLOCK_S = 30.0
"""With blocks of at most this length recordings are short, so more rollouts are affordable."""
LEAST_BLOCKS = 3 * FOLDS
LEAST_PERSONS = 30
FITS = 5
WALK_ROLLOUTS = 10
BUSY_PERSON_S = 100_000.0
USUAL_SPEED_LIMIT_MPS = 5.0
RADIUS_M = 0.3
SPAWNING = Spawning(clearance_m=0.3, patience_s=2.0)
TICK_S = 0.4
"""Ticks are at least this long, unless a frame is longer."""
WINDOW_S = 3.2
LEAST_WINDOW = 7
"""Speeds are measured over at least this time and this number of ticks."""
BUSY_SHIFTS_S = (60.0,)
"""A single shift is sufficient where very many people meet."""


def check_size(crowd: Trajectories, where: object) -> None:
    """Check that a recording is long enough, and has enough people, for fits and scores.

    Raises:
        RecordingError: it is too short, or has too few people.
    """
    observed_s = _observed_s(crowd)
    block_s = BLOCKS_S[0][1]
    if observed_s < LEAST_BLOCKS * block_s:
        raise RecordingError(
            where,
            got=f"{observed_s:.0f} s of observation",
            expected=f"{LEAST_BLOCKS * block_s:.0f} s or more, for {LEAST_BLOCKS} time blocks of "
            f"{block_s:.0f} s",
            hint="Models are fitted on some time blocks and scored on others: use a longer "
            "recording.",
        )
    whole = int((crowd.entered & crowd.left & (crowd.last > crowd.first)).sum())
    if whole < LEAST_PERSONS:
        got = f"{whole} persons who were seen to enter and to leave"
        hint = "Areas, goals and dwell times are estimated from these people."
        raise RecordingError(where, got=got, expected=f"{LEAST_PERSONS} or more", hint=hint)


def bounds_of(crowd: Trajectories) -> Bounds:
    """The recorded extent plus a margin, rounded outwards."""
    xy = crowd.xy.astype(np.float64)
    low = np.floor((xy.min(axis=0) - MARGIN_M) / MARGIN_M) * MARGIN_M
    high = np.ceil((xy.max(axis=0) + MARGIN_M) / MARGIN_M) * MARGIN_M
    return Bounds(float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def motion_of(crowd: Trajectories) -> Motion:
    """Speed limit and radii.

    The speed limit is 5 m/s, or the speed that one step in a thousand exceeds if that is higher.
    The goal radius is half the median step, so that people neither step over a goal nor stop far
    from it.
    """
    ways = np.linalg.norm(np.diff(crowd.xy.astype(np.float64), axis=0), axis=1)
    ways = ways[np.diff(crowd.row_person()) == 0]
    fast = math.ceil(np.percentile(ways, 99.9) / crowd.dt_s)
    radius = round(float(np.median(ways)) / 2 / 0.05) * 0.05
    return Motion(
        max_speed_mps=max(USUAL_SPEED_LIMIT_MPS, float(fast)),
        person_radius_m=RADIUS_M,
        goal_radius_m=round(max(0.2, radius), 2),
    )


def clustering_of(crowd: Trajectories, where: object) -> Clustering:
    """Settings of DBSCAN: the smallest ε of `EPS_M` that leaves less than 10 % in no cluster.

    A small ε separates doors that a large ε would merge. Clusters that are still wide are split.

    Raises:
        RecordingError: too many starts or ends are in no cluster with any ε.
    """
    from sklearn.cluster import DBSCAN

    sides = [p.astype(np.float64) for p in (crowd.start[crowd.entered], crowd.end[crowd.left])]
    least = max(3, round(math.sqrt(len(sides[0])) / PERSONS_ROOT))
    for eps_m in EPS_M:
        cluster = DBSCAN(eps=eps_m, min_samples=least)
        left_out = [float((cluster.fit_predict(side) < 0).mean()) for side in sides]
        if max(left_out) < LEFT_OUT:
            return Clustering(
                spawn_eps_m=eps_m,
                spawn_min_persons=least,
                goal_eps_m=eps_m,
                goal_min_persons=least,
                keep_noise=True,
                widest_m=WIDEST_M,
            )
    raise RecordingError(
        where,
        got=f"{left_out[0]:.0%} of the starts and {left_out[1]:.0%} of the ends in no cluster of "
        f"{least} persons within {EPS_M[-1]:g} m",
        expected=f"areas where at least {1 - LEFT_OUT:.0%} of people enter and leave",
        hint="Tracks may be fragmented (join them), or the recording is too short.",
    )


def walking_of(crowd: Trajectories) -> Walking:
    """Time scales of the walking metrics.

    A tick is a step of the annotation grid, of 0.4 s or more. Speeds are measured over 3.2 s or
    more. The shortest lag of accelerations is the first at which people accelerate more than the
    noise of their positions makes them seem to, along and across their path; the others are 1⅓ and
    2 times as long.
    """
    tick = max(1, round(crowd.grid_s / crowd.dt_s), round(TICK_S / crowd.dt_s))
    tick_s = tick * crowd.dt_s
    window = 2 * math.ceil(WINDOW_S / tick_s / 2 - 1e-6) + 1
    lag = max(2, *(of_axis.lag_ticks for of_axis in noise_of(crowd, tick)))
    return Walking(
        tick_frames=tick,
        window_ticks=max(LEAST_WINDOW, window),
        lags_ticks=(lag, max(lag + 1, round(4 / 3 * lag)), 2 * lag),
        shifts_s=BUSY_SHIFTS_S if _busy(crowd) else Walking().shifts_s,
    )


def _busy(crowd: Trajectories) -> bool:
    """Whether so many people are present that rollouts take minutes."""
    return len(crowd.xy) * crowd.dt_s > BUSY_PERSON_S


def protocol_of(crowd: Trajectories, *, fits: int | None, rollouts_per_fit: int | None) -> Protocol:
    """Length of time blocks by the observed duration, and the number of fits and rollouts."""
    observed_s = _observed_s(crowd)
    block_s = next(block_s for longest_s, block_s in BLOCKS_S if observed_s <= longest_s)
    usual = 10 if block_s <= SHORT_BLOCK_S else 6
    if _busy(crowd):
        usual = 3
    return Protocol(
        block_s=block_s,
        resample_s=block_s * (3 if block_s >= LONG_BLOCK_S else 1),
        fits=fits or FITS,
        rollouts_per_fit=rollouts_per_fit or usual,
        walk_rollouts=WALK_ROLLOUTS,
    )


def _observed_s(crowd: Trajectories) -> float:
    return float(np.diff(crowd.observed, axis=1).sum() * crowd.dt_s)
