"""Comparison of a scene's crowd with and without a scenario: tables and pictures."""

from collections.abc import Callable
from pathlib import Path

from crowdbench.files import replacing
from crowdbench.registry import policy as find_policy
from crowdbench.report.steering.changes import (
    AreaChange,
    GoalChange,
    Steering,
    area_changes,
    goal_changes,
    steering,
)
from crowdbench.report.steering.maps import areas_picture, changes_picture
from crowdbench.report.steering.rates import rates_picture
from crowdbench.run.rollout import rollout

WALKED = 5
"""Number of seeds with rollouts, for the map; sampling alone takes little time."""


def draw_steering(
    found: Steering,
    out: Path,
    *,
    policy: str = "straight",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Path]:
    """Draw `<scenario>-rates.png` and `<scenario>-map.png` into `out` and return their paths.

    The map shows rollouts of the first seeds with `policy`. `progress(done, total)` is called
    before the first rollout and after each.

    Raises:
        SettingError, WeightsError: there is no such policy.
        OutputError: a picture cannot be written.
    """
    walker = find_policy(policy, found.scene)
    models = list(zip(found.usual, found.steered, strict=True))[:WALKED]
    name = found.scenario.name
    paths = [out / f"{name}-rates.png", out / f"{name}-map.png"]
    with replacing(paths[0]) as temporary:
        temporary.write_bytes(rates_picture(found))
    crowds = []
    progress(0, 2 * len(models))
    with replacing(paths[1]) as temporary:
        for seed, pair in enumerate(models):
            crowds += [rollout(found.scene, model, walker, seed=seed) for model in pair]
            progress(len(crowds), 2 * len(models))
        temporary.write_bytes(changes_picture(found, crowds[::2], crowds[1::2]))
    return paths


__all__ = [
    "AreaChange",
    "GoalChange",
    "Steering",
    "area_changes",
    "areas_picture",
    "draw_steering",
    "goal_changes",
    "steering",
]
