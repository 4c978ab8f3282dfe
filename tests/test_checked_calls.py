"""Wrong shapes are found in the first calls of each test, however often a function is called."""

import numpy as np
import pytest
from checked_calls import CALLS, check_again

from crowdbench.policies import Straight
from crowdbench.run.acting import checked_actions
from crowdbench.spawn.events import SpawnEvents, no_events

WRONG = "not a number of persons"


def call(persons: object) -> None:
    checked_actions(np.zeros((3, 2)), persons, Straight())  # type: ignore[arg-type]


def test_the_first_calls_are_checked() -> None:
    with pytest.raises(TypeError, match="persons"):
        call(WRONG)


def test_later_calls_are_not_and_those_of_the_next_test_are_again() -> None:
    for _ in range(CALLS):
        call(3)
    with pytest.raises(Exception, match="one action for each of not a number"):
        call(WRONG)  # only the function itself objects
    check_again()
    with pytest.raises(TypeError, match="persons"):
        call(WRONG)


def test_methods_are_called_without_checks_too() -> None:
    events: SpawnEvents = no_events()
    for _ in range(CALLS):
        events.shifted(1.0)
    events.shifted(np.float32(1.0))  # type: ignore[arg-type]
    check_again()
    with pytest.raises(TypeError, match="by_s"):
        events.shifted("1")  # type: ignore[arg-type]
