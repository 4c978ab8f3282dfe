"""The baselines do what their page says."""

import numpy as np

from crowdbench.baselines.heuristic import Heuristic
from crowdbench.data.table import OUTCOMES
from crowdbench.registry import spawn_model
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.simulation.observations import GOAL_RANGE_M

MAX_SPEED = load_scene("plaza-v0").motion.max_speed_mps


def seeing(goal_m: float, goal_angle: float, rays: list[float]) -> np.ndarray:
    """An observation of a person at rest."""
    return np.array(
        [
            [
                0,
                0,
                goal_m / GOAL_RANGE_M,
                np.cos(goal_angle),
                np.sin(goal_angle),
                1.34 / MAX_SPEED,
                *rays,
            ]
        ],
        np.float32,
    )


def walker() -> Heuristic:
    heuristic = Heuristic()
    heuristic.reset(load_scene("plaza-v0"), np.random.default_rng(0))
    return heuristic


def test_the_heuristic_walks_to_the_goal_where_the_way_is_free() -> None:
    action = walker().act(seeing(8.0, 0.3, [1.0] * 32))[0] * MAX_SPEED
    np.testing.assert_allclose(action, 1.34 * np.array([np.cos(0.3), np.sin(0.3)]), rtol=1e-5)


def test_the_heuristic_goes_round_what_stands_in_its_way() -> None:
    rays = [1.0] * 32
    rays[31] = rays[0] = rays[1] = 0.05  # half a metre ahead
    action = walker().act(seeing(8.0, 0.0, rays))[0] * MAX_SPEED
    angle = abs(np.arctan2(action[1], action[0]))
    assert 0.3 < angle < 1.0


def test_the_heuristic_stops_where_nothing_is_free() -> None:
    action = walker().act(seeing(8.0, 0.0, [0.03] * 32))
    np.testing.assert_allclose(action, 0.0, atol=1e-6)


def test_the_heuristic_brings_almost_everyone_to_the_goal() -> None:
    scene = load_scene("plaza-v0")
    spawn = spawn_model("poisson-gmm", scene)
    crowd = rollout(scene, spawn, Heuristic(), seed=0, horizon_s=240.0)
    over = crowd.left.sum()
    assert over > 50
    assert (crowd.outcome == OUTCOMES.index("goal")).sum() > 0.9 * over
