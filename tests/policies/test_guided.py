"""The guided walker: what each cost does, how people walk with it, and its file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import Person, box, simulate, square

from crowdbench.errors import WeightsError
from crowdbench.policies import GuidedWalker
from crowdbench.policies.guided import (
    ANYWHERE,
    CANDIDATES,
    FILE,
    Parameters,
    chosen,
    draw,
    of_companion,
    of_stranger,
    parameters_of,
    probed,
)
from crowdbench.policies.memory import Memory
from crowdbench.registry import policy, policy_source
from crowdbench.run.acting import Actor
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, social

OPEN = square()
CALM = ANYWHERE._replace(speed_mps=0.001, side_mps=0.001, bow=0.001)
"""People who hardly vary."""


def crowd(
    *people: Person, of: Parameters = ANYWHERE, frames: int = 15, scene: Scene = OPEN
) -> np.ndarray:
    """(frames + 1, N, 2) positions, NaN after the arrival."""
    walker = GuidedWalker(of)
    shown = Settings(max_alive=len(people), observation=walker.observation)
    simulation = simulate(scene, *people, settings=shown)
    actor = Actor(walker, simulation)
    actor.reset(np.random.default_rng(0))
    path = [simulation.slots.position[0].copy()]
    for _ in range(frames):
        actor.step()
        there = simulation.slots.alive[0] | (simulation.slots.ended[0] != 0)
        path.append(np.where(there[:, None], simulation.slots.position[0], np.nan))
    return np.array(path)


def test_who_is_alone_and_calm_walks_straight_at_its_preferred_speed() -> None:
    path = crowd(
        Person(start=(-4, -3), goal=(8, 6), speed=1.5, velocity=(1.2, 0.9)), of=CALM, frames=10
    )
    along = 1.5 * 0.4 * np.arange(11)[:, None]
    np.testing.assert_allclose(path[:, 0], [-4, -3] + along * [0.8, 0.6], atol=0.15)


def test_velocities_vary_as_much_as_the_parameters_say() -> None:
    """Without costs, velocities along and across the way have their standard deviations."""
    free = ANYWHERE._replace(avoid=0.0, delay=0.0, miss=0.0, wall=0.0, bow=0.0, plan=1e9)
    people = [Person(start=(-55, 0), goal=(55, 0), velocity=(1.2, 0), speed=1.2)] * 300
    path = crowd(*people, of=free, frames=30, scene=square(60.0))
    velocity = np.diff(path[10:], axis=0) / 0.4
    assert velocity[..., 0].mean() == pytest.approx(1.2, abs=0.02)
    assert velocity[..., 0].std() == pytest.approx(free.speed_mps, rel=0.05)
    assert velocity[..., 1].std() == pytest.approx(free.side_mps, rel=0.05)
    after_s = 1.2
    kept = np.corrcoef(velocity[:-3, :, 0].ravel(), velocity[3:, :, 0].ravel())[0, 1]
    assert kept == pytest.approx(np.exp(-after_s / free.speed_s), abs=0.03)


def test_two_who_meet_pass_each_other_at_a_distance() -> None:
    nearest = []
    for y in np.linspace(-0.2, 0.2, 9).tolist():
        path = crowd(
            Person(start=(-5, y), goal=(9, y), velocity=(1.3, 0), speed=1.3),
            Person(start=(5, 0), goal=(-9, 0), velocity=(-1.3, 0), speed=1.3),
        )
        nearest.append(np.nanmin(np.linalg.norm(path[:, 0] - path[:, 1], axis=1)))
    assert np.mean(nearest) > 0.6
    assert min(nearest) > 0.3


def test_companions_walk_side_by_side() -> None:
    """Also those who begin one behind the other."""
    people = [
        Person(start=(-9, 0), goal=(9, 0), speed=1.2, velocity=(1.2, 0), group=0),
        Person(start=(-7.5, 0), goal=(9, 0.5), speed=1.2, velocity=(1.2, 0), group=0),
    ]
    path = crowd(*people, frames=30)[15:]
    ahead, beside = np.abs(path[:, 0] - path[:, 1]).T
    assert np.nanmean(beside) > np.nanmean(ahead)
    assert 0.5 < np.nanmean(np.hypot(ahead, beside)) < 1.5


def test_who_waits_stands_at_its_stop() -> None:
    path = crowd(
        Person(start=(-4, 0), goal=(8, 0), speed=1.2, velocity=(1.2, 0), via=(0, 0), wait_s=8.0),
        frames=34,
    )[:, 0]
    standing = (np.linalg.norm(np.diff(path, axis=0), axis=1) < 0.3 * 0.4).sum()
    assert 8.0 / 0.4 - 5 < standing < 8.0 / 0.4 + 6


def test_nobody_walks_through_walls() -> None:
    scene = square(10.0, box(-1.0, -3.0, 1.0, 3.0))
    path = crowd(Person(start=(-5, 0), goal=(5, 0.5)), scene=scene, frames=60)[:, 0]
    x, y = path[np.isfinite(path).all(axis=1)].T
    assert not ((abs(x) < 1.0) & (abs(y) < 3.0)).any()
    assert x[-1] > 1.0


def test_an_action_depends_on_nobody_elses_row() -> None:
    rng = np.random.default_rng(0)
    seen = rng.uniform(-1, 1, (40, social.SIZE)).astype(np.float32)
    style = rng.standard_normal((40, 1)).astype(np.float32)
    noise = rng.standard_normal((40, GuidedWalker.noise)).astype(np.float32)

    def acted(rows: slice) -> np.ndarray:
        of = seen[rows]
        people = np.arange(len(of))
        memory = Memory(
            state=np.zeros((len(of), 0), np.float32), style=style[rows], noise=noise[rows],
            world=people, person=people, entered=np.zeros(len(of), bool),
        )  # fmt: skip
        walker = GuidedWalker()
        walker.reset(OPEN, np.random.default_rng(0))
        return walker.act(of, memory)

    assert np.isfinite(acted(slice(None))).all()
    np.testing.assert_array_equal(acted(slice(7, 20)), acted(slice(None))[7:20])


@given(x=st.floats(-3, 3), y=st.floats(-3, 3), u=st.floats(-3, 3), v=st.floats(-3, 3))
def test_strangers_cost_the_more_the_nearer_and_sooner_they_pass(x, y, u, v) -> None:
    here = of_stranger(x, y, u, v, ANYWHERE)
    assert 0 <= here <= ANYWHERE.avoid
    assert of_stranger(x, y, 0.0, 0.0, ANYWHERE) <= here * (1 + 1e-9) or here > 0
    # Who comes straight at me costs more than who comes from twice as far, and who moves away.
    assert of_stranger(2.0, 0.0, -1.0, 0.0, ANYWHERE) > of_stranger(4.0, 0.0, -1.0, 0.0, ANYWHERE)
    assert of_stranger(2.0, 0.0, -1.0, 0.0, ANYWHERE) > of_stranger(2.0, 0.0, 1.0, 0.0, ANYWHERE)


def test_a_companion_at_the_side_costs_least() -> None:
    def cost(x: float, y: float) -> float:
        return of_companion(x, y, 1.0, 0.0, ANYWHERE)

    best = cost(0.0, ANYWHERE.beside_m)
    assert best == pytest.approx(0.0, abs=1e-9)
    assert cost(0.0, -ANYWHERE.beside_m) == pytest.approx(best)
    for x, y in ((1.0, 0.0), (0.0, 0.2), (0.0, 2.5), (-1.0, 0.9), (6.0, 0.0)):
        assert cost(x, y) > best + 0.5


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_distance_from_walls_is_interpolated_between_the_probes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen = rng.uniform(0, 1, social.SIZE).astype(np.float32)
    probes = seen[social.PROBES]
    for point, value in zip(social.PROBE_POINTS, probes, strict=True):
        assert probed(seen, *point) == pytest.approx(value, abs=1e-5)
    x, y = rng.uniform(-3, 3, 2)
    assert probes.min() - 1e-6 <= probed(seen, x, y) <= probes.max() + 1e-6
    assert probed(seen, x, y) == pytest.approx(probed(seen, x + 1e-9, y), abs=1e-6)


def test_candidates_are_drawn_by_their_costs() -> None:
    cost = np.array([0.0, 1.0, 3.0])
    normals = np.random.default_rng(0).standard_normal(20000)
    shares = np.bincount([chosen(cost, z) for z in normals], minlength=3) / len(normals)
    np.testing.assert_allclose(shares, np.exp(-cost) / np.exp(-cost).sum(), atol=0.01)
    assert chosen(np.array([1e6, 0.0]), -9.0) == 1  # no overflow


def test_a_way_is_bowed_by_the_style_and_less_near_the_target() -> None:
    def turned(style: float, left_m: float) -> float:
        velocity = np.empty((CANDIDATES + 1, 2))
        noise = np.zeros(GuidedWalker.noise)
        of = ANYWHERE._replace(bow=0.1, side_s=1e-6)  # it takes up the new direction at once
        draw(1.0, 0.0, 1.0, 0.0, left_m, 1.0, False, style, noise, 5.0, 0.4, of, velocity)
        return float(np.arctan2(velocity[0, 1], velocity[0, 0]))

    assert turned(2.0, 9.0) == pytest.approx(0.2, rel=1e-3)
    assert turned(-2.0, 9.0) == pytest.approx(-0.2, rel=1e-3)
    assert turned(2.0, 1.0) == pytest.approx(0.05, rel=1e-3)


def test_a_scene_may_have_parameters_of_its_own(tmp_path: Path) -> None:
    plaza = load_scene("plaza-v0")
    assert parameters_of(plaza, "full") == ANYWHERE
    own = replace(plaza, folder=tmp_path)
    splits = {
        split: (ANYWHERE._replace(bow=bow))._asdict()
        for split, bow in (("full", 0.01), ("fold0", 0.02))
    }
    file = tmp_path / FILE
    file.write_text(
        json.dumps({"command": "none", "elsewhere": ANYWHERE._asdict(), "splits": splits})
    )
    assert parameters_of(own, "fold0").bow == 0.02
    assert policy("guided-walker", own, "full").parameters.bow == 0.01
    source = policy_source("guided-walker", own)
    assert source.per_split
    assert source.dependencies("full").files == (file,)
    assert not policy_source("guided-walker", plaza).per_split
    with pytest.raises(WeightsError, match="got no parameters for fold1; expected a number for"):
        parameters_of(own, "fold1")
    splits["full"]["avoid_m"], splits["full"]["bow"] = -1.0, float("nan")
    file.write_text(json.dumps({"command": "none", "elsewhere": {}, "splits": splits}))
    with pytest.raises(WeightsError, match="expected valid JSON"):
        parameters_of(own, "full")
    splits["full"]["bow"] = 0.0
    file.write_text(json.dumps({"command": "none", "elsewhere": {}, "splits": splits}))
    with pytest.raises(WeightsError, match="got bow = 0, avoid_m = -1 for full; expected positive"):
        parameters_of(own, "full")
    del splits["full"]["bow"]
    file.write_text(json.dumps({"command": "none", "elsewhere": {}, "splits": splits}))
    with pytest.raises(WeightsError, match="expected a number for each of speed_s"):
        parameters_of(own, "full")


def test_the_people_of_the_plaza_arrive() -> None:
    from crowdbench.registry import spawn_model
    from crowdbench.run.rollout import rollout

    plaza = load_scene("plaza-v0")
    crowd = rollout(
        plaza, spawn_model("poisson-gmm", plaza), policy("guided-walker", plaza), seed=0
    )
    assert (crowd.outcome == 1).sum() > 0.98 * np.isin(crowd.outcome, (1, 2, 3)).sum()
