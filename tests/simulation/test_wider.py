"""Who is wider than a person, such as a robot: nobody walks into it, and all see its size."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import FAR, Person, disc_distances, events, simulate, slot_of, square, standing, step

from crowdbench.baselines.orca import ORCA
from crowdbench.policies import Policy, SocialForce, SpeedModel
from crowdbench.policies.social_force import GroupForce
from crowdbench.registry import policy as named_policy
from crowdbench.run.acting import Actor, settings_for
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import head_of
from crowdbench.simulation.social import OFFSET, PRESENT, RANGE_M, neighbours_of

OPEN = square()
RADIUS, BODY = 0.3, 0.15
TOLERANCE_M = 1e-4
widths = st.floats(0.0, 0.6)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), excess=st.tuples(widths, widths), stands=st.booleans())
def test_bodies_come_no_nearer_than_the_sum_of_their_radii(
    seed: int, excess: tuple[float, float], stands: bool
) -> None:
    rng = np.random.default_rng(seed)
    xy = 1.6 * np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2) - 2.0
    people = [Person(start=tuple(point), goal=(9.5, 9.5)) for point in xy.tolist()]
    simulation = simulate(
        square(body_radius_m=BODY), *people, settings=Settings(max_alive=len(people), rays=1)
    )
    slots = simulation.slots
    slots.wider[0, :2] = excess
    slots.scripted[0, 0] = stands  # it is never pushed aside
    radius = BODY + slots.wider[0].astype(np.float64)
    upper = np.triu_indices(len(xy), 1)
    close = 0
    for _ in range(40):
        inwards = np.clip(slots.position[0, 0] - slots.position, -1, 1)
        commands = (inwards + rng.normal(0, 0.3, inwards.shape)).astype(np.float32)
        commands[0, 0] *= 0.0 if stands else 1.0
        simulation.step(commands)
        at = slots.position[0].astype(np.float64)
        gaps = np.linalg.norm(at[:, None] - at, axis=2) - radius[:, None] - radius
        gaps[~slots.alive[0]] = gaps[:, ~slots.alive[0]] = np.inf  # they have left the scene
        assert gaps[upper].min() >= -TOLERANCE_M
        close += int((gaps[0, 1:] < 0.01).sum())
    assert close > 0


@pytest.mark.parametrize("body", [0.0, BODY])
def test_people_wait_to_enter_until_a_wide_one_has_left_enough_room(body: float) -> None:
    scene = square(body_radius_m=body)
    late = Person(time_s=0.4, start=(1.0, 0.0))
    for excess, enters in ((0.0, True), (0.6, True), (0.8, False)):
        simulation = simulate(scene, Person(start=(0.0, 0.0)), late)
        simulation.slots.wider[0, slot_of(simulation, 0)] = excess
        step(simulation)
        assert simulation.slots.spawned.any() == enters


def test_whoever_enters_is_as_wide_as_a_person() -> None:
    simulation = simulate(OPEN, Person(leave_frame=1), Person(time_s=1.6, start=(5.0, 0.0)))
    simulation.slots.wider[:] = 0.4
    for _ in range(4):
        step(simulation)
    assert simulation.slots.wider[0, slot_of(simulation, 1)] == 0


def nearest_pass(policy: Policy, excess: float, worlds: int = 1) -> float:
    """Mean least distance in metres between somebody who walks and a wide one who stands aside."""
    walker = Person(start=(-4.0, 0.0), goal=(6.0, 0.0), velocity=(1.2, 0.0), speed=1.2)
    stander = Person(start=(0.0, 0.2), goal=(0.0, 9.0), speed=0.0)
    sizes = settings_for(policy, Settings(max_alive=2))
    simulation = Simulation(OPEN, worlds=worlds, settings=sizes)
    simulation.reset([events(walker, stander)] * worlds, horizon=FAR)
    simulation.slots.wider[:, 1] = excess
    actor = Actor(policy, simulation)
    actor.reset(*[np.random.default_rng(k) for k in range(worlds)])
    least = np.full(worlds, np.inf)
    for _ in range(20):
        actions = actor.actions()
        actions[:, 1] = 0
        simulation.step(actions, own_frame=actor.own_frame)
        at = simulation.slots.position.astype(np.float64)
        least = np.minimum(least, np.linalg.norm(at[:, 0] - at[:, 1], axis=1))
    return float(least.mean())


@pytest.mark.parametrize("kind", [SocialForce, GroupForce, SpeedModel, ORCA])
def test_models_keep_more_distance_from_who_is_wider(kind: type[Policy]) -> None:
    if kind is ORCA:
        pytest.importorskip("pyrvo")
    passes = [nearest_pass(kind(), excess) for excess in (0.0, 0.2, 0.5)]
    assert np.diff(passes).min() > 0.05


def test_networks_that_anticipate_keep_more_distance_from_who_is_wider() -> None:
    pytest.importorskip("onnxruntime")
    policy = named_policy("anticipate", "hotel-v0")
    person, robot = (nearest_pass(policy, excess, worlds=200) for excess in (0.0, 0.4))
    assert robot > person + 0.1


@settings(max_examples=25, deadline=None, derandomize=True)
@given(x=st.floats(1.0, 9.0), y=st.floats(-3.0, 3.0), excess=widths)
def test_rays_end_at_the_disc_of_who_is_wider(x: float, y: float, excess: float) -> None:
    rays, reach = 64, 6.0
    xy = np.array([[-4.0, 0.0], [x - 4.0, y]])
    simulation = standing(OPEN, xy, rays=rays, ray_range_m=reach)
    simulation.slots.wider[0, 1] = excess
    seen = simulation.observe()[0, 0, head_of("lidar-2") :] * reach
    lower, upper = (disc_distances(xy, rays, RADIUS + excess + by)[0] for by in (-1e-3, 1e-3))
    assert (seen <= np.minimum(lower, reach) + 1e-4).all()
    assert (seen >= np.minimum(upper, reach) - 1e-4).all()
    if np.hypot(x, y) < reach:
        assert simulation.nearest[0, 0] == pytest.approx(
            max(0.0, np.hypot(x, y) - excess), abs=1e-4
        )


def test_social_1_shows_the_wide_nearer_by_as_much_along_the_line_of_sight() -> None:
    xy = np.array([[0.0, 0.0], [3.0, 4.0], [0.0, 5.5], [6.3, 0.0], [0.1, 0.0]])
    simulation = standing(OPEN, xy, observation="social-1")
    simulation.slots.heading[:] = (1.0, 0.0)
    simulation.slots.wider[0] = (0.2, 0.5, 0.0, 0.4, 0.3)
    others = neighbours_of(simulation.observe()[0, 0].copy())
    seen = others[others[:, PRESENT.start] == 1][:, OFFSET] * RANGE_M
    np.testing.assert_allclose(seen, [[0.0, 0.0], [2.7, 3.6], [0.0, 5.5], [5.9, 0.0]], atol=1e-5)
    assert simulation.nearest[0, :3].tolist() == pytest.approx(
        [0.0, np.hypot(3, 1.5), np.hypot(3, 1.5) - 0.5], abs=1e-4
    )


def test_the_width_of_somebody_in_one_world_changes_no_other_world() -> None:
    people = events(Person(), Person(start=(1.0, 0.5)))
    seen = []
    for excess in (0.0, 0.5):
        simulation = Simulation(OPEN, worlds=2, settings=Settings(max_alive=2))
        simulation.reset([people, people], horizon=FAR)
        simulation.slots.wider[1, 1] = excess
        seen.append(simulation.observe().copy())
    assert (seen[0][0] == seen[1][0]).all()
    assert (seen[0][1, 0] != seen[1][1, 0]).any()
