"""The figures of a walked policy are those of people whose walks are known."""

import math

import numpy as np
import pytest
from given import Given
from worlds import Person

from crowdbench import load_scene, rollout, spawn_model
from crowdbench.baselines.walked import walked
from crowdbench.data.table import OUTCOMES
from crowdbench.policies import StateView, Straight

PLAZA = load_scene("plaza-v0")
TWO = (
    Person(start=(4.0, 8.0), goal=(26.0, 8.0), group=0),
    Person(start=(4.0, 9.2), goal=(26.0, 9.2), group=0),
)
STOPS = Person(start=(4.0, 11.0), goal=(26.0, 11.0), speed=1.5, via=(12.0, 11.0), wait_s=8.0)


class East:
    """Walks east at half of the preferred speed, whatever there is."""

    name, sees = "east", "state"

    def reset(self, scene, rng) -> None:
        self.max_speed_mps = scene.motion.max_speed_mps

    def act(self, seen: StateView) -> np.ndarray:
        speed = 0.5 * seen.speed / self.max_speed_mps
        return np.stack([speed, np.zeros_like(speed)], axis=1)


def test_whoever_does_all_right() -> None:
    found = walked(PLAZA, Given(*TWO, STOPS), Straight(), horizon_s=80.0)
    assert (found.trips, found.arrived) == (3, 1.0)
    assert found.preferred_mps == pytest.approx(3.5 / 3)
    assert found.speed_mps == pytest.approx(3.5 / 3, rel=0.02)  # the last step to a stop is shorter
    assert found.stood >= 0.85  # some steps lead from its edge, 1 m away, to the stop
    assert found.apart_m == pytest.approx(1.2, abs=0.01)
    assert found.recorded_apart_m == pytest.approx(1.16, abs=0.01)  # as in docs/plans.md
    assert "100.0% of 3 persons arrive, " in str(found)
    assert "1.20 m apart (recorded 1.16 m)" in str(found)


def test_whoever_does_all_wrong() -> None:
    found = walked(PLAZA, Given(*TWO, STOPS), East(), horizon_s=80.0)
    assert found.speed_mps == pytest.approx(3.5 / 6, rel=0.01)
    assert found.stood == 0.0
    assert "0.50 of the preferred speed" in str(found)
    assert "0.0% of the waiting time at stops is spent standing" in str(found)


def test_companions_who_part_are_far_apart() -> None:
    apart = (TWO[0], Person(start=(4.0, 8.0), goal=(4.0, 18.0), group=0))
    assert walked(PLAZA, Given(*apart), Straight(), horizon_s=80.0).apart_m > 3.0


def test_nothing_is_said_of_stops_and_companions_that_are_not_sent() -> None:
    found = walked(
        PLAZA, Given(Person(start=(4.0, 8.0), goal=(26.0, 8.0))), Straight(), horizon_s=40.0
    )
    assert math.isnan(found.stood)
    assert math.isnan(found.apart_m)
    assert str(found).endswith("100.0% of 1 persons arrive")
    slow = Person(start=(4.0, 8.0), goal=(26.0, 8.0), speed=0.1)
    nobody = walked(PLAZA, Given(slow), Straight(), horizon_s=40.0)
    assert str(nobody) == "no trip ended within 40 s"


def test_the_crowd_is_that_of_a_rollout() -> None:
    spawn = spawn_model("cox-plans", PLAZA)
    found = walked(PLAZA, spawn, Straight(), horizon_s=60.0, seed=3)
    crowd = rollout(PLAZA, spawn, Straight(), seed=3, horizon_s=60.0)
    over = crowd.outcome[crowd.left]
    assert found.trips == len(over) > 0
    assert found.arrived == pytest.approx(np.mean(over == OUTCOMES.index("goal")))
