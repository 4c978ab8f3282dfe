"""A summary of a recording as a table of figures."""

import numpy as np

from crowdbench.data.table import Trajectories

_PERCENTILES = (5, 50, 95, 99)


def describe(crowd: Trajectories) -> dict[str, str]:
    """Summary figures of a crowd by name, as text for a table."""
    observed = np.diff(crowd.observed, axis=1)[:, 0]
    present = crowd.present()[crowd.is_observed()]
    begins_with = int((crowd.first == 0).sum())
    dwell = (crowd.last - crowd.first)[crowd.entered & crowd.left] * crowd.dt_s
    person = crowd.row_person()
    steps = np.linalg.norm(np.diff(crowd.xy, axis=0), axis=1)[np.diff(person) == 0] / crowd.dt_s
    intervals = f"{len(observed)} interval{'s' * (len(observed) != 1)}"
    of_one = f" of one of the {intervals}" if len(observed) > 1 else ""
    notes = crowd.provenance.get("notes", {})
    return {
        **{name: str(fact) for name, fact in notes.items()},
        "persons": f"{len(crowd)}",
        "rows": f"{len(crowd.xy)}",
        "frames": f"{crowd.frames} of {crowd.dt_s:.4g} s",
        "observed": f"{observed.sum() * crowd.dt_s:.1f} s in {intervals}",
        "total duration": f"{crowd.duration_s:.1f} s",
        "in frame 0": f"{begins_with}",
        "entered": f"{crowd.entered.sum()} ({_were(~crowd.entered)} there at the start{of_one})",
        "left": f"{crowd.left.sum()} ({_were(~crowd.left)} still there at the end{of_one})",
        "agents at once": f"mean {present.mean():.2f}, max {present.max()}",
        "dwell time": _percentiles(dwell, "s"),
        "speed": _percentiles(steps, "m/s"),
    }


def _were(those: np.ndarray) -> str:
    number = int(those.sum())
    return f"{number} {'was' if number == 1 else 'were'}"


def _percentiles(values: np.ndarray, unit: str) -> str:
    if len(values) == 0:
        return "none"
    numbers = np.percentile(values, _PERCENTILES)
    parts = (f"p{p} {v:.2f}" for p, v in zip(_PERCENTILES, numbers, strict=True))
    return f"{', '.join(parts)} {unit}"
