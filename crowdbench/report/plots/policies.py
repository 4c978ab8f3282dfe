"""Figure `policies`: the ways of recorded people, and how policies walk the same people."""

from collections.abc import Mapping

import numpy as np

from crowdbench.colours import COLOURS
from crowdbench.report.plots.ways import (
    LEAST_PEOPLE,
    Numbers,
    by_fraction,
    common_ways,
    draw_ways,
    entries,
    mean_way,
    walking,
    whole,
)
from crowdbench.scene import Scene
from crowdbench.trajectories.table import Trajectories

_Taken = dict[tuple[float, ...], np.ndarray]


def draw_policies(
    scene: Scene, recording: Trajectories, walked: Mapping[str, Trajectories]
) -> tuple[bytes, Numbers]:
    """The picture and its numbers; `walked` are crowds under the recorded arrivals, by policy.

    A policy is *off* by the distance between where a person is and where the same one was recorded
    at the same fraction of the way: the mean over ways, then over people who arrive.
    """
    recorded = _taken(recording)
    found = {policy: _against(recorded, _taken(crowd)) for policy, crowd in walked.items()}
    titles = [
        (policy if (off := found[policy]["off_m"]) is None else f"{policy}: {off:.2f} m off", crowd)
        for policy, crowd in walked.items()
    ]
    ways = common_ways(recording, len(COLOURS)).tolist()
    return draw_ways(scene, recording, titles), {
        "people": len(recorded),
        "policies": found,
        "ways": [_way(k, g, recording, walked) for k, g in ways],
    }


def _taken(crowd: Trajectories) -> _Taken:
    """The paths of those who walk all of a way, by their entries, at fractions of their length."""
    known = entries(crowd)
    return {known[p]: by_fraction(crowd.path(p)) for p in np.flatnonzero(whole(crowd)).tolist()}


def _against(recorded: _Taken, walked: _Taken) -> Numbers:
    both = [who for who in recorded if who in walked]
    off = [np.linalg.norm(walked[who] - recorded[who], axis=1).mean() for who in both]
    return {
        "arrived": round(len(both) / max(1, len(recorded)), 4),
        "off_m": round(float(np.mean(off)), 3) if off else None,
    }


def _way(k: int, g: int, recording: Trajectories, walked: Mapping[str, Trajectories]) -> Numbers:
    """A way's people and mean paths: of the recording where they are too many to be told apart."""
    who = walking(recording, k, g)
    found: Numbers = {"spawn_area": k, "goal_area": g, "people": len(who)}
    if len(who) >= LEAST_PEOPLE:
        found["recorded"] = mean_way([recording.path(p) for p in who.tolist()]).numbers()
    arrived = {policy: walking(crowd, k, g).tolist() for policy, crowd in walked.items()}
    return found | {
        "walked": {
            policy: mean_way([walked[policy].path(p) for p in people]).numbers()
            for policy, people in arrived.items()
            if people
        }
    }
