"""The adapter hands people over to another simulator, and counts what that cannot do."""

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from conftest import need
from msgspec import structs
from worlds import Person, events, simulate, square

from crowdbench.policies import Policy, Straight
from crowdbench.run.acting import Actor
from crowdbench.scene import Scene
from examples.peers.adapter import COUNTED, Newcomer, PeerPolicy, steps_of

OPEN = square()
DT = 0.4


class Plain:
    """People walk straight to their targets. It refuses, moves or loses whom it is told to."""

    def __init__(self, scene: Scene, *, refuses: dict[int, int], moves: set[int], loses: set[int]):
        self.dt_s, self.at = scene.dt_s, dict[int, np.ndarray]()
        self.refuses, self.moves, self.loses = dict(refuses), moves, set(loses)
        self.going: dict[int, tuple[np.ndarray, float]] = {}
        self.newcomers: list[Newcomer] = []
        self.advanced = 0
        self.gone: list[int] = []

    def enter(self, newcomer: Newcomer) -> str:
        self.newcomers.append(newcomer)
        person = newcomer.person
        if self.refuses.get(person, 0) > 0:
            self.refuses[person] -= 1
            return "refused"
        beside = (0.0, 0.5) if person in self.moves else (0.0, 0.0)
        self.at[person] = np.array(newcomer.position) + beside
        return "moved" if person in self.moves else "entered"

    def leave(self, person: int) -> None:
        self.gone.append(person)
        del self.at[person]

    def steer(self, persons: Sequence[int], target: np.ndarray, speed_mps: np.ndarray) -> None:
        self.going = {
            person: (to, speed)
            for person, to, speed in zip(persons, target, speed_mps.tolist(), strict=True)
        }

    def advance(self) -> Sequence[int]:
        self.advanced += 1
        for person in self.at:
            to, speed = self.going[person]
            way = to - self.at[person]
            length = max(float(np.hypot(*way)), 1e-9)
            self.at[person] = self.at[person] + way / length * min(length, speed * self.dt_s)
        lost = [person for person in self.at if person in self.loses]
        for person in lost:
            self.loses.discard(person)
            del self.at[person]
        return lost

    def positions(self, persons: Sequence[int]) -> np.ndarray:
        return np.array([self.at[person] for person in persons])


class Handed(PeerPolicy):
    name = "handed"

    def __init__(self, refuses=None, moves=(), loses=()):
        self.wanted = {"refuses": refuses or {}, "moves": set(moves), "loses": set(loses)}
        self.crowds: list[Plain] = []

    def crowd(self, scene: Scene) -> Plain:
        self.crowds.append(Plain(scene, **self.wanted))
        return self.crowds[-1]


def paths_of(policy: Policy, scene: Scene, *people: Person, frames: int) -> np.ndarray:
    """Positions (frames, people, 2); NaN while somebody is not there."""
    simulation = simulate(scene, *people)
    actor = Actor(policy, simulation)
    actor.reset(np.random.default_rng(0))
    found = np.full((frames, len(people), 2), np.nan)
    for frame in range(frames):
        slots = simulation.slots
        here = np.flatnonzero(slots.alive[0])
        found[frame, slots.event[0, here]] = slots.position[0, here]
        actor.step()
    return found


def two_people() -> tuple[Person, ...]:
    return (
        Person(start=(-4, 0), goal=(6, 1), speed=1.3),
        Person(time_s=2.0, start=(3, 5), goal=(3, -6), speed=0.9, via=(3, 1), wait_s=3.0),
    )


def test_people_go_where_the_simulator_says() -> None:
    handed, straight = (
        paths_of(policy, OPEN, *two_people(), frames=50) for policy in (Handed(), Straight())
    )
    np.testing.assert_allclose(handed, straight, atol=1e-4)


def test_it_is_told_who_enters() -> None:
    policy = Handed()
    person = Person(start=(-4, 0), goal=(6, 1), speed=1.3, velocity=(1.0, 0.5), group=3)
    paths_of(policy, OPEN, person, replace(person, start=(-4, 1)), frames=1)
    first, second = policy.crowds[0].newcomers
    assert first.position == (-4, 0)
    assert first.velocity == (1.0, 0.5)
    assert first.target == (6, 1)
    assert first.speed_mps == pytest.approx(1.3)
    assert first.group == second.group >= 0
    assert not first.beside


def test_who_is_refused_stands_and_is_asked_again_and_may_then_enter_beside() -> None:
    policy = Handed(refuses={0: 8})
    walked = paths_of(policy, OPEN, *two_people(), frames=20)
    assert (walked[:9, 0] == walked[0, 0]).all()
    assert walked[12, 0, 0] > walked[0, 0, 0]
    patience = OPEN.frames(OPEN.spawning.patience_s)
    asked = [of.beside for of in policy.crowds[0].newcomers if of.person == 0]
    assert asked == [k >= patience for k in range(9)]
    assert policy.counts == dict.fromkeys(COUNTED, 0) | {"entered": 2, "waited": 1}


def test_who_is_never_taken_in_is_counted_once_whether_there_or_gone() -> None:
    leaves = Person(start=(0, 0), goal=(6, 0), leave_frame=5)
    stays = Person(start=(0, 3), goal=(6, 3))
    policy = Handed(refuses={0: 1000, 1: 1000})
    paths_of(policy, OPEN, leaves, stays, frames=10)
    assert policy.counts == dict.fromkeys(COUNTED, 0) | {"refused": 2}


def test_who_enters_elsewhere_is_there_a_frame_later() -> None:
    policy = Handed(moves={0})
    walked = paths_of(policy, OPEN, two_people()[0], frames=3)
    assert walked[0, 0, 1] == 0
    assert walked[1, 0, 1] > 0.4
    assert policy.counts["moved"] == 1
    assert policy.counts["entered"] == 0


def test_who_escapes_is_put_in_again_where_it_was() -> None:
    policy = Handed(loses={0})
    walked = paths_of(policy, OPEN, two_people()[0], frames=8)
    assert (walked[0, 0] == walked[1, 0]).all()
    assert (np.diff(walked[1:, 0, 0]) > 0).all()
    assert policy.counts == dict.fromkeys(COUNTED, 0) | {"entered": 1, "escaped": 1}


def test_who_cannot_go_back_in_stands_and_is_counted_and_may_then_enter_beside() -> None:
    policy = Handed(loses={0})
    simulation = simulate(OPEN, two_people()[0])
    actor = Actor(policy, simulation)
    actor.reset(np.random.default_rng(0))
    actor.step()  # it escapes
    policy.crowds[0].refuses[0] = 7
    for _ in range(10):
        actor.step()
    assert policy.counts == dict.fromkeys(COUNTED, 0) | {"entered": 1, "escaped": 1, "stood": 7}
    assert policy.crowds[0].newcomers[-1].beside
    assert simulation.slots.position[0, 0, 0] > -4


def test_who_walks_too_fast_is_put_back() -> None:
    fast = Person(start=(-9, 0), goal=(9, 0), speed=5.0)
    scene = replace(OPEN, motion=structs.replace(OPEN.motion, max_speed_mps=2.0))
    policy = Handed()
    walked = paths_of(policy, scene, fast, frames=5)
    np.testing.assert_allclose(np.diff(walked[:, 0, 0]), 2.0 * DT, atol=1e-5)
    assert policy.counts["put back"] == 4  # of five frames, not before the first


def test_a_long_step_is_shortened_not_bent() -> None:
    fast = Person(start=(-5, -5), goal=(5, 0), speed=9.0)
    step = np.diff(paths_of(Handed(), OPEN, fast, frames=2)[:, 0], axis=0)[0]
    assert np.hypot(*step) == pytest.approx(OPEN.motion.max_speed_mps * DT, rel=1e-4)
    assert step[0] == pytest.approx(2 * step[1], rel=1e-4)


def test_the_simulator_goes_on_when_the_last_person_has_left() -> None:
    """JuPedSim takes people out only when it goes on; otherwise they would stand in the way."""
    policy = Handed(refuses={1: 1})
    person = Person(start=(0, 0), goal=(6, 0), leave_frame=3)
    later = Person(time_s=1.6, start=(0, 0), goal=(6, 0))
    paths_of(policy, OPEN, person, later, frames=6)
    assert policy.crowds[0].gone == [0]
    assert policy.crowds[0].advanced == 5


def test_worlds_are_apart() -> None:
    policy = Handed()
    for _ in range(2):
        policy.reset(OPEN, np.random.default_rng(0))
    assert policy.counts == dict.fromkeys(COUNTED, 0)


@pytest.mark.parametrize(
    ("dt_s", "longest_s", "steps"), [(0.4, 0.01, 40), (4 / 9, 0.01, 45), (0.4, 1.0, 1)]
)
def test_steps_divide_a_frame(dt_s: float, longest_s: float, steps: int) -> None:
    assert steps_of(dt_s, longest_s) == steps
    assert dt_s / steps <= longest_s + 1e-12


@pytest.mark.long
def test_orca_through_the_adapter_scores_like_orca() -> None:
    need(find_spec("pyrvo"), "the extra orca")
    from examples.peers.check import compare

    for of in compare("plaza-v0", 4):
        assert of.adapted[0] == pytest.approx(of.direct[0], abs=0.1), of
        assert of.direct[1] > 0  # nudges matter


def test_events_have_what_the_adapter_needs() -> None:
    assert events(*two_people()).group.tolist() == [-1, -1]
