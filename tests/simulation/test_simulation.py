"""The rules of a life, each as the docstring of `Simulation` states it."""

import numpy as np
import pytest
from worlds import FAR, Person, alive, ended, events, simulate, slot_of, square, step

from crowdbench.errors import ActionError, SettingError
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.state import EXIT, GOAL, HORIZON, RECORDED, TIMEOUT

DT = 0.4
OPEN = square()
AT_GOAL = Person(start=(1.0, 1.0), goal=(1.0, 1.0))


def test_an_episode_may_begin_with_nobody() -> None:
    simulation = simulate(OPEN, Person(time_s=3 * DT))
    present = [alive(simulation)]
    for _ in range(4):
        step(simulation)
        present.append(alive(simulation))
    assert present == [[], [], [], [0], [0]]


def test_a_person_due_between_frames_enters_at_the_next_one() -> None:
    simulation = simulate(OPEN, Person(time_s=1.5 * DT))
    step(simulation)
    assert alive(simulation) == []
    step(simulation)
    assert alive(simulation) == [0]


def test_someone_enters_after_a_gap_with_nobody() -> None:
    simulation = simulate(OPEN, AT_GOAL, Person(time_s=5 * DT))
    present = []
    for _ in range(5):
        step(simulation)
        present.append(alive(simulation))
    assert present == [[], [], [], [], [1]]


def test_a_person_whose_goal_is_at_its_start_lives_one_step() -> None:
    simulation = simulate(OPEN, AT_GOAL)
    assert (alive(simulation), ended(simulation)) == ([0], {})
    step(simulation)
    assert (alive(simulation), ended(simulation)) == ([], {0: GOAL})
    step(simulation)
    assert (alive(simulation), ended(simulation)) == ([], {})


def test_one_ends_and_another_enters_in_the_same_step() -> None:
    simulation = simulate(OPEN, AT_GOAL, Person(time_s=DT))
    step(simulation)
    assert (alive(simulation), ended(simulation)) == ([1], {0: GOAL})


def test_who_ended_does_not_block_the_place_where_it_ended() -> None:
    simulation = simulate(OPEN, AT_GOAL, Person(time_s=DT, start=AT_GOAL.start))
    step(simulation)
    assert alive(simulation) == [1]


def test_entries_are_marked_in_their_step_only() -> None:
    simulation = simulate(OPEN, Person(), Person(time_s=DT, start=(0, 5)))
    step(simulation)
    assert simulation.slots.person[simulation.slots.spawned].tolist() == [1]
    step(simulation)
    assert not simulation.slots.spawned.any()


def test_a_person_enters_with_its_velocity_goal_speed_and_place() -> None:
    simulation = simulate(OPEN, Person(start=(1, 2), goal=(3, 4), speed=1.25, velocity=(0.5, -1)))
    slots = simulation.slots
    got = [slots.position, slots.goal, slots.velocity]
    assert [array[0, 0].tolist() for array in got] == [[1, 2], [3, 4], [0.5, -1]]
    assert slots.speed[0, 0] == 1.25


@pytest.mark.parametrize(("gap_m", "waits"), [(0.29, True), (0.31, False)])
def test_a_person_waits_for_someone_nearer_than_the_clearance(gap_m: float, waits: bool) -> None:
    simulation = simulate(OPEN, Person(), Person(time_s=DT, start=(gap_m, 0.0)))
    step(simulation)
    assert alive(simulation) == ([0] if waits else [0, 1])


def test_who_waits_enters_as_soon_as_the_way_is_free() -> None:
    simulation = simulate(OPEN, Person(), Person(time_s=DT))
    step(simulation)
    assert alive(simulation) == [0]
    step(simulation, {0: (1.0, 0.0)})
    assert alive(simulation) == [0, 1]
    waited = simulation.waited(0, np.array([1]), simulation.slots.born[0, 1:2])
    assert waited.tolist() == [1]


def test_who_has_waited_out_its_patience_enters_anyway() -> None:
    simulation = simulate(OPEN, Person(), Person(time_s=DT))
    frames_alone = 0
    while alive(simulation) == [0]:
        step(simulation)
        frames_alone += 1
    # Due in frame 1, it waits for the frames of 2 s.
    assert frames_alone - 1 == round(2.0 / DT)


def test_someone_behind_a_waiting_person_in_the_queue_enters_before_it() -> None:
    simulation = simulate(
        OPEN, Person(), Person(time_s=DT), Person(time_s=2 * DT, start=(0.0, 5.0))
    )
    step(simulation)
    step(simulation)
    events_there = simulation.slots.event[0, simulation.slots.alive[0]].tolist()
    assert events_there == [0, 2]


def test_a_group_enters_in_one_frame_at_one_spot() -> None:
    simulation = simulate(OPEN, *[Person(time_s=DT)] * 3)
    step(simulation)
    assert alive(simulation) == [0, 1, 2]


@pytest.mark.parametrize(
    "unwaiting", [Person(time_s=DT, entered=False), Person(time_s=DT, scripted=True, leave_frame=9)]
)
def test_recorded_people_never_wait(unwaiting: Person) -> None:
    simulation = simulate(OPEN, Person(), unwaiting)
    step(simulation)
    assert alive(simulation) == [0, 1]


def test_a_slot_is_free_only_in_the_step_after_the_end_of_a_life() -> None:
    simulation = simulate(
        OPEN,
        AT_GOAL,
        Person(time_s=DT, start=(0, 5)),
        Person(time_s=2 * DT, start=(0, -5)),
        settings=Settings(max_alive=1),
    )
    step(simulation)
    assert (alive(simulation), simulation.clock.no_slot.tolist()) == ([], [1])
    step(simulation)
    assert simulation.slots.event[0, simulation.slots.alive[0]].tolist() == [2]


def test_who_finds_no_slot_is_dropped_and_counted() -> None:
    simulation = simulate(OPEN, *[Person()] * 3, settings=Settings(max_alive=2))
    step(simulation)
    assert alive(simulation) == [0, 1]
    assert (simulation.clock.no_slot.tolist(), simulation.clock.no_id.tolist()) == ([1], [0])


def test_who_finds_no_id_is_dropped_and_counted() -> None:
    people = [AT_GOAL, Person(time_s=2 * DT), Person(time_s=3 * DT, start=(0, 5))]
    simulation = simulate(OPEN, *people, settings=Settings(max_alive=4, max_persons=2))
    for _ in range(4):
        step(simulation)
    assert alive(simulation) == [1]
    assert (simulation.clock.no_slot.tolist(), simulation.clock.no_id.tolist()) == ([0], [1])


def test_slots_are_used_again_and_ids_never() -> None:
    people = [Person(time_s=k * DT, start=(1, k % 5), goal=(1, k % 5)) for k in range(40)]
    simulation = simulate(OPEN, *people, settings=Settings(max_alive=3))
    seen = []
    for _ in range(40):
        seen += simulation.slots.person[simulation.slots.spawned].tolist()
        step(simulation)
    assert seen == list(range(40))


def test_everyone_ends_at_the_horizon_and_nobody_enters_there() -> None:
    simulation = simulate(
        OPEN, Person(), Person(time_s=DT, start=(0, 5)), Person(time_s=2 * DT), horizon=2
    )
    step(simulation)
    step(simulation)
    assert (alive(simulation), ended(simulation)) == ([], {0: HORIZON, 1: HORIZON})
    assert simulation.clock.ids.tolist() == [2]


def test_the_first_rule_that_applies_says_how_a_life_ends() -> None:
    out_of_bounds_at_the_goal = Person(start=(9.0, 0.0), goal=(10.5, 0.0))
    simulation = simulate(OPEN, out_of_bounds_at_the_goal, horizon=1)
    step(simulation, {0: (1.5 / DT, 0.0)})
    assert ended(simulation) == {0: GOAL}


def test_who_walks_out_of_the_bounds_exits() -> None:
    simulation = simulate(OPEN, Person(start=(9.5, 0.0), goal=(0, 0)))
    step(simulation, {0: (1.0, 0.0)})
    assert alive(simulation) == [0]
    step(simulation, {0: (1.0, 0.0)})
    assert ended(simulation) == {0: EXIT}


def test_a_life_ends_at_twice_the_99th_percentile_of_dwell() -> None:
    simulation = simulate(square(dwell_p99_s=3 * DT), Person(time_s=2 * DT))
    while not ended(simulation):
        step(simulation)
    assert ended(simulation) == {0: TIMEOUT}
    assert simulation.clock.frame[0] - 2 == 6


@pytest.mark.parametrize(("beside_m", "reached"), [(0.29, True), (0.31, False)])
def test_a_goal_that_a_step_passes_by_is_reached(beside_m: float, reached: bool) -> None:
    simulation = simulate(OPEN, Person(goal=(0.8, beside_m)))
    step(simulation, {0: (4.0, 0.0)})  # from 0 to 1.6 m: both ends are far from the goal
    assert ended(simulation) == ({0: GOAL} if reached else {})


def test_a_person_cut_off_in_the_recording_leaves_at_its_last_frame() -> None:
    simulation = simulate(OPEN, Person(leave_frame=2))
    step(simulation)
    assert ended(simulation) == {}
    step(simulation)
    assert ended(simulation) == {0: RECORDED}


def test_a_scripted_person_leaves_for_no_other_reason() -> None:
    scene = square(dwell_p99_s=DT)
    simulation = simulate(scene, Person(goal=(0, 0), scripted=True, leave_frame=8))
    outcomes = []
    for _ in range(8):
        step(simulation, {0: (5.0, 0.0)})
        outcomes.append(ended(simulation).get(0, 0))
    assert outcomes == [0] * 7 + [RECORDED]
    assert simulation.slots.position[0, 0, 0] > scene.bounds.x_max_m


@pytest.mark.parametrize(
    ("action", "velocity"),
    [
        ((0.5, 0.0), (2.5, 0.0)),
        ((3.0, 0.0), (5.0, 0.0)),
        ((0.6, 0.8), (3.0, 4.0)),
        # First to the square, (1, 0.5), then to the disc: the order matters.
        ((2.0, 0.5), (5.0 / np.hypot(1, 0.5), 2.5 / np.hypot(1, 0.5))),
        ((-9.0, -9.0), (-5.0 / np.sqrt(2), -5.0 / np.sqrt(2))),
    ],
)
def test_actions_are_clipped_to_the_square_and_then_to_the_greatest_speed(
    action: tuple[float, float], velocity: tuple[float, float]
) -> None:
    simulation = simulate(OPEN, Person(goal=(-9, 9)))
    actions = np.zeros((1, 16, 2), np.float32)
    actions[0, slot_of(simulation, 0)] = action
    simulation.step(actions)
    np.testing.assert_allclose(simulation.slots.velocity[0, 0], velocity, rtol=1e-5)
    np.testing.assert_allclose(
        simulation.slots.position[0, 0], np.array(velocity) * DT, rtol=1e-5, atol=1e-6
    )


def test_actions_that_are_no_numbers_leave_everyone_in_reach() -> None:
    simulation = simulate(OPEN, Person())
    simulation.step(np.full((1, 16, 2), np.nan, np.float32))
    assert np.linalg.norm(simulation.slots.position[0, 0]) <= 5.0 * DT + 1e-6


def test_actions_of_another_shape_are_refused() -> None:
    simulation = simulate(OPEN, Person())
    with pytest.raises(ActionError, match=r"\(1, 3, 2\)"):
        simulation.step(np.zeros((1, 3, 2), np.float32))


@pytest.mark.parametrize(
    "wrong",
    [{"max_alive": 0}, {"max_persons": 0}, {"rays": 0}, {"ray_range_m": 0.0}],
)
def test_sizes_that_make_no_sense_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(SettingError, match=next(iter(wrong))):
        Settings(**wrong)


def test_a_reset_forgets_the_episode_before() -> None:
    simulation = simulate(OPEN, *[Person()] * 20)
    step(simulation)
    simulation.reset([events(Person(time_s=DT))], horizon=FAR)
    assert (alive(simulation), simulation.clock.no_slot.tolist()) == ([], [0])
    step(simulation)
    assert alive(simulation) == [0]


def test_numbering_anew_keeps_the_order_of_ids() -> None:
    people = [AT_GOAL, Person(start=(0, 3)), Person(start=(0, 5)), Person(time_s=2 * DT)]
    simulation = simulate(OPEN, *people)
    step(simulation)
    step(simulation)  # the last person takes the slot of the first
    simulation.number_anew()
    assert [int(simulation.slots.event[0, slot_of(simulation, k)]) for k in range(3)] == [1, 2, 3]


def test_ids_go_on_after_numbering_anew() -> None:
    simulation = simulate(OPEN, AT_GOAL, Person(start=(0, 3)), Person(time_s=2 * DT))
    step(simulation)
    simulation.number_anew()
    step(simulation)
    assert alive(simulation) == [0, 1]


def test_who_is_turned_away_in_a_warm_up_stays_counted() -> None:
    simulation = simulate(OPEN, *[Person()] * 3, settings=Settings(max_alive=2))
    simulation.number_anew()
    assert simulation.clock.no_slot.tolist() == [1]


def test_empty_frames_can_be_skipped_up_to_the_next_arrival() -> None:
    simulation = Simulation(OPEN, settings=Settings(max_alive=4))
    simulation.reset([events(AT_GOAL, Person(time_s=50 * DT))], horizon=FAR)
    step(simulation)
    assert simulation.next_due() == 50
    simulation.skip_to(50)
    step(simulation)
    assert (alive(simulation), int(simulation.clock.frame[0])) == ([1], 50)
    assert simulation.next_due() is None
