"""The founding paper's preprocessing, which drops people. crowdbench itself keeps everyone.

The paper leaves out "agents that hardly move" and those with fewer than 20 or more than 100 steps.
It does not say how it counts. Its published code (`code/src/data/load_data.py`) drops people whose
squared distance from start to end is at most 2 m², and those with 100 positions or more. With this
and 20 steps or more, 258 people are left on ETH, as in the paper. The order of the rules does not
matter for who is left.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool

from crowdbench.data.table import PERSON_COLUMNS, Trajectories

LEAST_SQUARED_M2 = 2.0
SHORTEST_STEPS = 20
LONGEST_POSITIONS = 99


def paper_preprocessed(crowd: Trajectories) -> tuple[Trajectories, dict[str, str]]:
    """The people that the paper keeps, and how many are left after each rule, as text for a table.

    The last count is that of the published code: positions on the annotation grid, and no lower
    limit of steps.
    """
    way = crowd.end.astype(np.float64) - crowd.start
    positions = np.diff(crowd.offsets)
    annotated = (positions - 1) * crowd.dt_s / crowd.grid_s + 1
    moving = (way * way).sum(axis=1) > LEAST_SQUARED_M2
    long_enough = moving & (positions - 1 >= SHORTEST_STEPS)
    kept = long_enough & (positions <= LONGEST_POSITIONS)
    coarse = moving & (np.round(annotated) <= LONGEST_POSITIONS)
    fewer = f"fewer than {LONGEST_POSITIONS + 1}"
    return only(crowd, kept), {
        "recorded": f"{len(crowd)} people",
        "who move": f"{moving.sum()} end more than 1.41 m from their start",
        "not too short": f"{long_enough.sum()} of them have {SHORTEST_STEPS} steps or more",
        "not too long": f"{kept.sum()} of them have {fewer} positions",
        "published code": f"{coarse.sum()} move and have {fewer} annotated positions",
    }


def only(crowd: Trajectories, chosen: Bool[np.ndarray, " P"]) -> Trajectories:
    """The crowd of the chosen people."""
    rows = chosen[crowd.row_person()]
    lengths = np.diff(crowd.offsets)[chosen]
    columns = ("person_id", "first", *PERSON_COLUMNS)
    persons: dict[str, Any] = {name: getattr(crowd, name)[chosen] for name in columns}
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    return replace(crowd, xy=crowd.xy[rows], offsets=offsets, **persons)
