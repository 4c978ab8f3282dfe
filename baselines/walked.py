"""What people do who are walked by a policy: speeds, arrivals, stops and companions."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from crowdbench.data.stops import STANDING_MPS
from crowdbench.data.table import Trajectories
from crowdbench.metrics import METRICS
from crowdbench.metrics.groups import APART_M
from crowdbench.metrics.metric import total
from crowdbench.policies import Policy
from crowdbench.run.acting import settings_for
from crowdbench.run.episode import Recorder, begin, generator
from crowdbench.scene import Scene
from crowdbench.scoring.reference import read_reference
from crowdbench.simulation import Simulation
from crowdbench.simulation.state import GOAL, HORIZON, WAITING
from crowdbench.spawn import SpawnModel
from crowdbench.spawn.areas import read_areas


@dataclass(frozen=True)
class Walked:
    """Figures of a rollout. Those of speeds are means over persons, outside waiting times."""

    horizon_s: float
    trips: int
    """Number of trips that ended before the horizon."""
    arrived: float
    """Share of these that ended at the goal; NaN without any."""
    speed_mps: float
    preferred_mps: float
    recorded_mps: float
    """Mean speed of recorded people."""
    stood: float
    """Share of the waiting times at stops in which people stood; NaN without stops."""
    apart_m: float
    """Mean distance between two people who were sent as companions while both were there, clipped
    at 5 m as in `companion_distance`; NaN without companions."""
    recorded_apart_m: float
    """Mean of `companion_distance` in the recording; NaN if nobody was sent as companion."""

    def __str__(self) -> str:
        if not self.trips:
            return f"no trip ended within {self.horizon_s:.0f} s"
        parts = [
            f"rollout of {self.horizon_s:.0f} s: mean speed {self.speed_mps:.2f} m/s "
            f"(recorded {self.recorded_mps:.2f}), "
            f"{self.speed_mps / self.preferred_mps:.2f} of the preferred speed",
            f"{self.arrived:.1%} of {self.trips} persons arrive",
        ]
        if not np.isnan(self.stood):
            parts.append(f"{self.stood:.1%} of the waiting time at stops is spent standing")
        if not np.isnan(self.apart_m):
            recorded = f"{self.recorded_apart_m:.2f} m"
            parts.append(f"companions are {self.apart_m:.2f} m apart (recorded {recorded})")
        return ", ".join(parts)


def walked(
    scene: Scene, spawn: SpawnModel, policy: Policy, *, horizon_s: float, seed: int = 0
) -> Walked:
    """Figures of a rollout of `horizon_s` seconds, the same rollout as that of `rollout`."""
    simulation = Simulation(scene, settings=settings_for(policy))
    frames = scene.frames(horizon_s)
    actor = begin(simulation, spawn, seed=seed, frames=frames, start=None, walker=policy)
    actor.reset(generator(seed, 0, "policy"))
    recorder = Recorder(simulation)
    recorder.write()
    slots = simulation.slots
    steps = []
    for _ in range(frames - 1):  # the first frame is the beginning
        acted = np.flatnonzero(slots.alive[0])
        waits = slots.stage[0, acted] == WAITING
        actor.step()
        recorder.write()
        speed = np.hypot(*slots.velocity[0, acted].T)
        ended = slots.ended[0, acted]
        steps.append((slots.person[0, acted], speed, slots.speed[0, acted], waits, ended))
    person, speed, preferred, waits, ended = (np.concatenate(x) for x in zip(*steps, strict=True))
    over = ended[(ended != 0) & (ended != HORIZON)]
    apart_m = [np.minimum(gap, APART_M) for gap in _gaps(recorder.trajectories({}))]
    return Walked(
        horizon_s=horizon_s,
        trips=len(over),
        arrived=_mean(over == GOAL),
        speed_mps=_mean_of_persons(person[~waits], speed[~waits]),
        preferred_mps=_mean_of_persons(person[~waits], preferred[~waits]),
        recorded_mps=float(np.mean(read_areas(scene).speed_quantiles)),
        stood=_mean(speed[waits] < STANDING_MPS),
        apart_m=_mean(np.concatenate(apart_m)) if apart_m else np.nan,
        recorded_apart_m=_recorded_apart_m(scene) if apart_m else np.nan,
    )


def _gaps(crowd: Trajectories) -> Iterator[Float[np.ndarray, " n"]]:
    """Distances of each two companions in the frames in which both are there."""
    members = np.flatnonzero(crowd.group >= 0)
    members = members[np.argsort(crowd.group[members], kind="stable")]
    for group in np.split(members, np.flatnonzero(np.diff(crowd.group[members])) + 1):
        for one, other in combinations(group.tolist(), 2):
            first = max(crowd.first[one], crowd.first[other])
            stop = min(crowd.last[one], crowd.last[other]) + 1
            a, b = (
                crowd.xy[crowd.offsets[p] + first - crowd.first[p] :][: max(0, stop - first)]
                for p in (one, other)
            )
            yield np.hypot(*(a - b).T)


def _recorded_apart_m(scene: Scene) -> float:
    (metric,) = (m for m in METRICS if m.name == "companion_distance")
    reference = read_reference(scene)
    (recorded,), support = metric.aligned([reference.statistics[metric.name]], reference.blocks)
    return metric.typical(total(recorded), support, reference.blocks)


def _mean_of_persons(person: np.ndarray, values: np.ndarray) -> float:
    count = np.bincount(person)
    return _mean((np.bincount(person, values) / np.maximum(count, 1))[count > 0])


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else np.nan
