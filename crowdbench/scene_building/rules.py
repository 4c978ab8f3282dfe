"""The rules by which a new scene's settings follow from its recording.

They are those that the shipped scenes follow, or come near to: what a person would look up there.
All of them can be changed in `scene.toml` afterwards; then fit again.
"""

import math

import numpy as np
from jaxtyping import Float

from crowdbench.errors import RecordingError
from crowdbench.scene import Bounds, Clustering, Motion, Protocol, Spawning
from crowdbench.trajectories.blocks import FOLDS
from crowdbench.trajectories.table import Trajectories

MARGIN_M = 0.5
"""Bounds are this far from the outermost positions, and on multiples of it."""
EPS_M = (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0)
LEFT_OUT = 0.1
"""The first of `EPS_M` that leaves less than this share of starts, and of ends, in no cluster."""
PERSONS_ROOT = 6.0
"""A cluster has √(number of persons) / 6 persons at least, and three."""
BLOCKS_S = ((270.0, 20.0), (480.0, 30.0), (1800.0, 60.0), (7200.0, 120.0), (math.inf, 600.0))
"""Recordings that were observed up to so many seconds have time blocks of so many seconds."""
LONG_BLOCK_S = 120.0
"""Blocks so long are resampled in runs of three: crowds drift."""
SHORT_BLOCK_S = 30.0
"""Blocks so short, or shorter, are few: more rollouts are quickly made."""
LEAST_BLOCKS = 3 * FOLDS
LEAST_PERSONS = 30
FITS = 5
BUSY_PERSON_S = 100_000.0
USUAL_SPEED_LIMIT_MPS = 5.0
RADIUS_M = 0.3
SPAWNING = Spawning(clearance_m=0.3, patience_s=2.0)


def check_size(crowd: Trajectories, where: object) -> None:
    """Refuse a recording that is too short or too empty to learn from and to score.

    Raises:
        RecordingError: it is.
    """
    observed_s = _observed_s(crowd)
    block_s = BLOCKS_S[0][1]
    if observed_s < LEAST_BLOCKS * block_s:
        raise RecordingError(
            where,
            got=f"{observed_s:.0f} s of observation",
            expected=f"{LEAST_BLOCKS * block_s:.0f} s or more, for {LEAST_BLOCKS} time blocks of "
            f"{block_s:.0f} s",
            hint="Some are held against what was seen in the others: record for longer.",
        )
    whole = int((crowd.entered & crowd.left & (crowd.last > crowd.first)).sum())
    if whole < LEAST_PERSONS:
        raise RecordingError(
            where,
            got=f"{whole} persons who were seen to enter and to leave",
            expected=f"{LEAST_PERSONS} or more",
            hint="Where people enter, whither they go and how long they stay is learned from them.",
        )


def bounds_of(crowd: Trajectories) -> Bounds:
    """The recorded extent, a margin wider, rounded outward."""
    xy = crowd.xy.astype(np.float64)
    low = np.floor((xy.min(axis=0) - MARGIN_M) / MARGIN_M) * MARGIN_M
    high = np.ceil((xy.max(axis=0) + MARGIN_M) / MARGIN_M) * MARGIN_M
    return Bounds(float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def motion_of(crowd: Trajectories) -> Motion:
    """Speed limit and radii.

    The limit is 5 m/s, or what one step in a thousand exceeds, if that is more. The goal radius
    is half of the median step, so that nobody steps over a goal or ends far from it.
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
    """Settings of DBSCAN: the smallest ε of a ladder that leaves out less than 10 %.

    A small ε tells doors apart that a large one takes together.

    Raises:
        RecordingError: people start or end all over the place.
    """
    sides = crowd.start[crowd.entered], crowd.end[crowd.left]
    least = max(3, round(math.sqrt(len(sides[0])) / PERSONS_ROOT))
    for eps_m in EPS_M:
        if all(_noise(side.astype(np.float64), eps_m, least) < LEFT_OUT for side in sides):
            return Clustering(
                spawn_eps_m=eps_m,
                spawn_min_persons=least,
                goal_eps_m=eps_m,
                goal_min_persons=least,
                keep_noise=True,
            )
    raise RecordingError(
        where,
        got=f"starts or ends of which {_noise(sides[0].astype(np.float64), EPS_M[-1], least):.0%} "
        f"and {_noise(sides[1].astype(np.float64), EPS_M[-1], least):.0%} have fewer than {least} "
        f"others within {EPS_M[-1]:g} m",
        expected=f"areas where {1 - LEFT_OUT:.0%} of people enter and leave",
        hint="Tracks may be cut into pieces (join them), or the recording is too short.",
    )


def _noise(points: Float[np.ndarray, "n 2"], eps_m: float, least: int) -> float:
    from sklearn.cluster import DBSCAN

    return float((DBSCAN(eps=eps_m, min_samples=least).fit_predict(points) < 0).mean())


def protocol_of(crowd: Trajectories, *, fits: int | None, rollouts_per_fit: int | None) -> Protocol:
    """Time blocks by the length of the observation, and how many rollouts."""
    observed_s = _observed_s(crowd)
    block_s = next(block_s for longest_s, block_s in BLOCKS_S if observed_s <= longest_s)
    usual = 10 if block_s <= SHORT_BLOCK_S else 6
    if len(crowd.xy) * crowd.dt_s > BUSY_PERSON_S:  # rollouts take minutes
        usual = 3
    return Protocol(
        block_s=block_s,
        resample_s=block_s * (3 if block_s >= LONG_BLOCK_S else 1),
        fits=fits or FITS,
        rollouts_per_fit=rollouts_per_fit or usual,
    )


def _observed_s(crowd: Trajectories) -> float:
    return float(np.diff(crowd.observed, axis=1).sum() * crowd.dt_s)
