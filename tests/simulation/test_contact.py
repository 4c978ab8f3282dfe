"""Bodies: nobody walks through anybody or through a wall, and the jammed find a way out."""

from collections.abc import Iterator

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import (
    BODY_M,
    FAR,
    Person,
    actions_of,
    box,
    ended,
    events,
    place,
    simulate,
    square,
    step,
    with_bodies,
)

import crowdbench
from crowdbench.errors import SceneError
from crowdbench.scene import LARGEST_BODY_M, Scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.contact import PART_MPS
from crowdbench.simulation.half_planes import project
from crowdbench.simulation.rules import uniform

RADIUS = BODY_M
TOLERANCE_M = 1e-4
"""Positions are rounded to float32: at 100 m from the origin to 8e-6 m, in each of many steps."""
DT = 0.4


def standing(scene: Scene, xy: np.ndarray) -> Simulation:
    """A simulation in which people stand at these points, far from their goals."""
    people = [Person(start=tuple(point), goal=(0.0, 9.5)) for point in xy.tolist()]
    return simulate(scene, *people, settings=Settings(max_alive=len(people), rays=1))


def gaps(simulation: Simulation, world: int = 0) -> np.ndarray:
    """Distances of all pairs present."""
    xy = simulation.slots.position[world, simulation.slots.alive[world]].astype(np.float64)
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    return apart[np.triu_indices(len(xy), 1)]


def pushing(simulation: Simulation, seed: int) -> Iterator[np.ndarray]:
    """Random commands of up to 5 m/s, kept for ten frames, most of them to the scene's middle."""
    rng = np.random.default_rng(seed)
    b = simulation.scene.bounds
    middle = np.array([b.x_min_m + b.x_max_m, b.y_min_m + b.y_max_m]) / 2
    shape = simulation.slots.alive.shape
    while True:
        random, inwards = rng.uniform(-1, 1, (*shape, 2)), rng.random(shape) < 0.8
        for _ in range(10):
            way = np.clip(middle - simulation.slots.position, -1, 1)
            yield np.where(inwards[..., None], way, random).astype(np.float32)


def check_bodies(scene: Scene, steps: int, seed: int = 0) -> int:
    """Push people of the scene's own arrivals around; returns the number of close pairs met."""
    scene = with_bodies(scene)
    spawn = crowdbench.spawn_model("poisson-gmm", scene)
    arrivals = spawn.sample(steps * scene.dt_s, scene, np.random.default_rng(seed))
    simulation = Simulation(scene, settings=Settings(max_alive=100, rays=1))
    simulation.reset([arrivals], horizon=steps + 1)
    walls = scene.obstacles
    close = 0
    before = np.full(100, np.inf)
    commands = pushing(simulation, seed)
    for _ in range(steps):
        simulation.step(next(commands))
        slots = simulation.slots
        pairs = gaps(simulation)
        assert pairs.min(initial=np.inf) >= 2 * RADIUS - TOLERANCE_M
        close += int((pairs < 2 * RADIUS + 0.01).sum())
        now = shapely.distance(walls, shapely.points(slots.position[0].astype(np.float64)))
        there = slots.alive[0] & ~slots.spawned[0]
        assert (now >= np.minimum(RADIUS, before) - TOLERANCE_M)[there].all()
        before = np.where(slots.alive[0], now, np.inf)
    return close


@pytest.mark.parametrize("name", ["plaza-v0", "eth-v0"])
def test_bodies_never_overlap_whatever_people_are_commanded(name: str) -> None:
    assert check_bodies(crowdbench.load_scene(name), 500) > 100


@pytest.mark.long
@pytest.mark.parametrize("name", crowdbench.list_scenes())
def test_bodies_never_overlap_in_ten_thousand_steps(name: str) -> None:
    assert check_bodies(crowdbench.load_scene(name), 10_000, seed=1) > 200


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), radius=st.floats(0.05, LARGEST_BODY_M))
def test_those_who_overlap_come_no_nearer_and_part(seed: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    scene = square(10.0, box(-10, -1.2, 10, -1), box(-10, 1, 10, 1.2), body_radius_m=radius)
    xy = rng.uniform(-0.7, 0.7, (12, 2))
    simulation = standing(scene, np.linspace(-9, 9, 12)[:, None] * [1, 0])
    place(simulation, xy)
    nearest = gaps(simulation)
    for _ in range(40):
        simulation.step(rng.uniform(-1, 1, (1, 12, 2)).astype(np.float32) * 0.2)
        now = gaps(simulation)
        assert (now >= np.minimum(nearest, 2 * radius) - TOLERANCE_M).all()
        nearest = now
    for _ in range(int(2 * radius * 12 / (PART_MPS * DT)) + 10):
        simulation.step(np.zeros((1, 12, 2), np.float32))
    assert gaps(simulation).min() >= 2 * radius - 0.01


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_numbering_of_people_changes_no_byte(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = square(10.0, box(2, -9, 3, 5), body_radius_m=RADIUS)
    xy = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2) * 0.31
    xy = (xy + rng.uniform(-0.004, 0.004, xy.shape)).astype(np.float32)
    order = rng.permutation(len(xy))
    commands = rng.uniform(-0.4, 0.4, (30, len(xy), 2)).astype(np.float32)
    ends = []
    for numbering in (np.arange(len(xy)), order):
        simulation = standing(scene, xy[numbering])
        for command in commands:
            simulation.step(command[None, numbering])
        ends.append(simulation.slots.position[0, np.argsort(numbering)].tobytes())
    assert ends[0] == ends[1]


def test_without_a_radius_people_pass_through_each_other() -> None:
    simulation = standing(square(), np.array([[0.0, 0.0], [2.0, 0.0]]))
    for _ in range(4):
        step(simulation, {0: (1.0, 0.0), 1: (-1.0, 0.0)})
    np.testing.assert_allclose(simulation.slots.position[0, :2, 0], [1.6, 0.4], atol=1e-5)


def test_a_free_walker_walks_as_commanded() -> None:
    simulation = standing(square(body_radius_m=RADIUS), np.array([[0.0, 0.0], [0.0, 5.0]]))
    step(simulation, {0: (1.0, 0.5)})
    np.testing.assert_allclose(simulation.slots.position[0, 0], [0.4, 0.2], atol=1e-6)
    np.testing.assert_allclose(simulation.slots.velocity[0, 0], [1.0, 0.5], atol=1e-5)
    assert simulation.slots.blocked[0, 0] == 0


@pytest.mark.parametrize("offset", [0.0, 0.001, -0.001])
def test_two_who_meet_head_on_pass_each_other_on_the_right(offset: float) -> None:
    simulation = standing(square(body_radius_m=RADIUS), np.array([[-2.0, 0.0], [2.0, offset]]))
    beside = []
    for _ in range(20):
        step(simulation, {0: (1.2, 0.0), 1: (-1.2, 0.0)})
        (x0, y0), (x1, y1) = simulation.slots.position[0, :2]
        if abs(x0 - x1) < 0.3:
            beside.append(y0 - y1)
    assert simulation.slots.position[0, 0, 0] > 2
    assert simulation.slots.position[0, 1, 0] < -2
    assert max(beside) < 0


def test_a_walker_gets_past_somebody_who_stands_exactly_in_the_way() -> None:
    simulation = standing(square(body_radius_m=RADIUS), np.array([[-1.0, 0.0], [0.5, 0.0]]))
    for _ in range(60):
        step(simulation, {0: (1.2, 0.0)})
    assert simulation.slots.position[0, 0, 0] > 2
    np.testing.assert_array_equal(simulation.slots.position[0, 1], [0.5, 0.0])


def test_commanded_and_walked_velocity_tell_who_is_stopped() -> None:
    wall = box(1, -5, 2, 5)
    simulation = standing(square(10.0, wall, body_radius_m=RADIUS), np.array([[0.0, 0.0]]))
    for _ in range(5):
        step(simulation, {0: (1.0, 0.0)})
    slots = simulation.slots
    np.testing.assert_allclose(slots.commanded[0, 0], [1.0, 0.0], atol=1e-6)
    assert slots.hit_wall[0, 0]
    assert slots.blocked[0, 0] > 0
    assert slots.position[0, 0, 0] == pytest.approx(1 - RADIUS, abs=TOLERANCE_M)


def test_nobody_enters_into_a_body() -> None:
    scene = square(body_radius_m=RADIUS)
    people = [Person(start=(0.0, 0.0)), Person(start=(0.1, 0.0)), Person(time_s=2.0)]
    simulation = simulate(scene, *people)
    assert simulation.slots.alive.sum() == 1
    for _ in range(20):  # longer than anybody is patient without bodies
        step(simulation)
        assert simulation.slots.alive.sum() == 1
    while simulation.slots.alive.sum() < 3:
        step(simulation, {0: (1.0, 0.0), 1: (0.0, 1.0)})
        assert gaps(simulation).min(initial=np.inf) >= 2 * RADIUS - TOLERANCE_M


def test_recorded_people_walk_as_recorded_and_stop_others() -> None:
    scene = square(body_radius_m=RADIUS)
    people = [
        Person(start=(-1.0, 0.0), scripted=True, leave_frame=FAR - 1),
        Person(start=(0.0, 0.0)),
    ]
    simulation = simulate(scene, *people)
    for _ in range(10):
        step(simulation, {0: (0.25, 0.0), 1: (-0.25, 0.0)})
    slots = simulation.slots
    np.testing.assert_allclose(slots.position[0, 0], [0.0, 0.0], atol=1e-5)
    assert gaps(simulation)[0] > 2 * RADIUS - 0.1


def test_a_crowd_leaves_through_a_door() -> None:
    xy = np.stack(np.meshgrid(np.linspace(0, 3.5, 8), np.linspace(-2, 2, 8)), axis=-1)
    people = [Person(start=tuple(p), goal=(8.0, p[1] / 2), speed=1.3) for p in xy.reshape(-1, 2)]
    door = [box(4, -10, 4.4, -0.5), box(4, 0.5, 4.4, 10)]
    scene = square(10.0, *door, body_radius_m=RADIUS, dwell_p99_s=300.0)
    policy = crowdbench.policy("straight", scene)
    policy.reset(scene, np.random.default_rng(0))
    simulation = Simulation(scene, settings=Settings(max_alive=64))
    simulation.reset([events(*people)], horizon=FAR)
    arrived, frames = 0, 0
    while arrived < 64 and frames < 250:
        simulation.step(actions_of(policy, simulation))
        arrived += len(ended(simulation))
        frames += 1
    assert arrived == 64
    assert 64 / (frames * DT) < 4.0  # without bodies they leave within 6 s


def test_a_projection_is_the_nearest_allowed_vector() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        count = rng.integers(1, 7)
        angle = rng.uniform(0, 2 * np.pi, count)
        plane = np.stack([np.cos(angle), np.sin(angle), rng.uniform(0, 0.5, count)], axis=1)
        wish = rng.uniform(-1, 1, 2)
        found = np.array(project(*wish, plane, count))
        assert (plane[:, :2] @ found <= plane[:, 2] + 1e-9).all()
        others = rng.uniform(-1, 1, (4000, 2))
        allowed = others[(others @ plane[:, :2].T <= plane[:, 2]).all(axis=1)]
        best = np.linalg.norm(allowed - wish, axis=1).min(initial=np.inf)
        assert np.linalg.norm(found - wish) <= best + 1e-9


def test_random_numbers_of_positions_are_uniform() -> None:
    xy = np.random.default_rng(0).uniform(-50, 50, (20_000, 2))
    drawn = np.array([uniform(x, y, k % 7) for k, (x, y) in enumerate(xy)])
    assert 0 <= drawn.min() < drawn.max() < 1
    assert np.abs(np.histogram(drawn, 20, (0, 1))[0] / 1000 - 1).max() < 0.15
    near = np.array([uniform(1.0 + k * 1e-6, 2.0, 3) for k in range(2000)])
    assert abs(np.corrcoef(near[1:], near[:-1])[0, 1]) < 0.1


@pytest.mark.parametrize("radius", [-0.1, 0.2, float("nan")])
def test_a_radius_beyond_the_clearance_of_paths_is_refused(
    radius: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("scene") / "eth-v0"
    folder.mkdir()
    text = (crowdbench.load_scene("eth-v0").folder / "scene.toml").read_text()
    changed = text.replace("body_radius_m = 0.15", f"body_radius_m = {radius}", 1)
    (folder / "scene.toml").write_text(changed)
    with pytest.raises(SceneError, match=r"motion.body_radius_m .* expected 0 \(no bodies\) to"):
        crowdbench.load_scene(folder)
