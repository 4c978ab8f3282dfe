"""Figure `policies`: recorded paths, and the paths of the same people under policies."""

from collections.abc import Mapping

import numpy as np

from crowdbench.colours import COLOURS
from crowdbench.data.table import Trajectories
from crowdbench.scene import Scene
from studies.figures.ways import (
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

_Taken = dict[tuple[float, ...], np.ndarray]


def draw_policies(
    scene: Scene, recording: Trajectories, walked: Mapping[str, Trajectories]
) -> tuple[bytes, Numbers]:
    """The picture and its numbers; `walked` are crowds under the recorded arrivals, by policy.

    A policy's `off_m` is the distance between a person's simulated and recorded positions at equal
    fractions of the path lengths, averaged over the path and over all people who arrive.
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
    """The complete paths at fractions of their lengths, by the entry of the person."""
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
    """A route's people and mean paths; the recorded mean only if people are not identifiable."""
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
