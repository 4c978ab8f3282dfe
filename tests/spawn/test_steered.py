"""Steered spawn models: what was asked for changes, and nothing else, to the last bit."""

from collections.abc import Callable
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import AREAS, GRID_S, poisson, random_ntpp, renewal

from crowdbench.run.episode import arrivals, warm_up_s
from crowdbench.scene import load_scene
from crowdbench.spawn import Addition, Arrivals, Change, Scenario, SpawnEvents, SpawnModel, Steered
from crowdbench.spawn.steering.scenario import Profile
from crowdbench.spawn.steering.steered import TimeChange
from crowdbench.spawn.times.groups import HasHazards, kolmogorov_smirnov, rescaled

ETH = load_scene("eth-v0")
HORIZON_S = 120.0
EXIT = 0.7
WIDE = replace(AREAS, flow=np.array([[0.2, 0.8], [EXIT, 1 - EXIT]]))
MODELS: dict[str, Callable[[], SpawnModel]] = {
    "poisson": lambda: replace(poisson(), areas=WIDE),
    "renewal": lambda: replace(renewal(), areas=WIDE),
    "ntpp": lambda: replace(random_ntpp(), areas=WIDE),
}


def steered(model: SpawnModel, *change: Change, **more: object) -> Steered:
    scenario = Scenario(name="s", scene="eth-v0", change=change, **more)  # type: ignore[arg-type]
    return Steered(model, scenario, WIDE)


def sample(model: SpawnModel, seed: int, horizon_s: float = HORIZON_S) -> SpawnEvents:
    return model.sample(horizon_s, ETH, np.random.default_rng(seed))


def same(one: SpawnEvents, other: SpawnEvents, *but: str) -> bool:
    """Whether they are equal to the last bit, these columns excepted."""
    names = [f.name for f in fields(SpawnEvents) if f.name not in but]
    return all(np.array_equal(getattr(one, n), getattr(other, n), equal_nan=True) for n in names)


def of(events: SpawnEvents, area: int) -> SpawnEvents:
    return events[events.spawn_area == area]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    "change",
    [
        Change(area=0, factor=0.0),
        Change(area=0, factor=((30.0, 4.0), (60.0, 0.5))),
        Change(area=0, shift_s=40.0),
        Change(area=0, goals={0: 1.0}),
    ],
    ids=("closed", "factor", "shift", "goals"),
)
def test_the_other_areas_people_are_the_usual_ones(model: str, change: Change) -> None:
    usual = MODELS[model]()
    addition = Addition(mean_m=(5.0, 5.0), sd_m=(1.0, 1.0), persons_per_min=9.0, goals={0: 1.0})
    other = steered(usual, change, add=(addition,))
    for seed in range(5):
        assert same(of(sample(other, seed), 1), of(sample(usual, seed), 1))
        assert not same(of(sample(other, seed), 0), of(sample(usual, seed), 0))


@pytest.mark.parametrize("model", MODELS)
def test_until_its_first_step_an_areas_people_are_the_usual_ones(model: str) -> None:
    usual = MODELS[model]()
    other = steered(usual, Change(area=0, factor=((50.0, 3.0), (80.0, 1.0))))
    before, after = of(sample(usual, 3), 0), of(sample(other, 3), 0)
    assert same(before[before.time_s < 50], after[after.time_s < 50])
    assert (before.time_s < 50).any()


def test_a_scenario_that_changes_nothing_changes_nothing() -> None:
    usual = MODELS["renewal"]()
    change = Change(area=0, factor=((50.0, 1.0),), goals={0: 0.2, 1: 0.8})
    assert same(sample(steered(usual, change), 1), sample(usual, 1))


@pytest.mark.parametrize("model", ["poisson", "renewal"])  # which are stationary by construction
def test_the_expected_number_in_each_stretch_is_the_rate_times_the_factor(model: str) -> None:
    usual, samples = MODELS[model](), 150
    factors = (1.0, 2.5, 0.0, 0.4)
    edges = (0.0, 30.0, 60.0, 80.0, HORIZON_S)
    profile = tuple(zip(edges, factors, strict=False))
    other = steered(usual, Change(area=0, factor=profile))
    counts = np.array(
        [np.histogram(of(sample(other, k), 0).time_s, edges)[0] for k in range(samples)]
    )
    plain = np.array([len(of(sample(usual, k), 0)) for k in range(1000, 1000 + samples)])
    share = np.array(factors) * np.diff(edges) / HORIZON_S
    error = np.sqrt((counts.var(axis=0) + share**2 * plain.var()) / samples)
    assert (np.abs(counts.mean(axis=0) - plain.mean() * share) < 4.5 * error + 1e-9).all()


@pytest.mark.parametrize("model", ["renewal", "ntpp"])
def test_in_its_own_clocks_time_a_steered_area_is_the_model(model: str) -> None:
    usual, factor = MODELS[model](), 1.6
    assert isinstance(usual, HasHazards)
    other = steered(usual, Change(area=0, factor=factor), Change(area=1, factor=factor))
    horizon_s = 4000.0  # of which the clock makes more than one sample
    events = sample(other, 0, horizon_s)
    tick = np.round(events.time_s * factor / GRID_S).astype(np.int64)
    own = Arrivals(
        tick=tick,
        area=events.spawn_area.astype(np.int64),
        windows=np.array([[0, int(factor * horizon_s / GRID_S)]]),
        areas=2,
        grid_s=GRID_S,
    )
    rng = np.random.default_rng(1)
    for what in ("gap", "size"):
        assert kolmogorov_smirnov(rescaled(usual, own, rng, what)).p > 0.01  # type: ignore[arg-type]
    # Without the change of time it is not.
    wall = replace(own, tick=np.floor(events.time_s / GRID_S).astype(np.int64))
    assert kolmogorov_smirnov(rescaled(usual, wall, rng)).p < 1e-4


@given(
    steps=st.lists(
        st.tuples(st.floats(0.0, 200.0), st.sampled_from([0.0, 0.3, 1.0, 7.0])),
        min_size=1,
        max_size=6,
        unique_by=lambda step: step[0],
    ),
    warm_up_s=st.floats(0.0, 50.0),
    share=st.lists(st.floats(0.0, 0.999), min_size=1, max_size=9),
)
def test_a_clock_reads_what_it_should_when_it_says(
    steps: list[tuple[float, float]], warm_up_s: float, share: list[float]
) -> None:
    profile = tuple(sorted(steps))
    clock = TimeChange.of(profile, 1.0, HORIZON_S, warm_up_s)
    reading = np.sort(share) * clock.end_s
    if clock.end_s == 0:
        return
    when = clock.when(reading)
    assert (np.diff(when) >= 0).all()
    assert ((when >= 0) & (when < HORIZON_S + 1e-9)).all()
    for u, t in zip(reading.tolist(), when.tolist(), strict=True):
        assert integral(profile, warm_up_s, t) == pytest.approx(u, abs=1e-6)


def integral(profile: tuple[tuple[float, float], ...], warm_up_s: float, until: float) -> float:
    """Of the factor over [0, until), stretch by stretch."""
    first = profile[0][1] if profile[0][0] == 0 else 1.0
    edges = [0.0, *(t + warm_up_s for t, _ in profile), np.inf]
    factors = [first, *(f for _, f in profile)]
    return sum(
        max(0.0, min(stop, until) - start) * f
        for (start, stop), f in zip(pairwise(edges), factors, strict=True)
    )


@pytest.mark.parametrize("shift_s", [35.0, -35.0])
def test_a_shift_moves_people_in_time_and_fills_what_it_leaves(shift_s: float) -> None:
    usual = MODELS["poisson"]()
    other = steered(usual, Change(area=0, shift_s=shift_s))
    before, after = of(sample(usual, 2), 0), of(sample(other, 2), 0)
    moved = before.time_s + shift_s
    kept = (moved >= 0) & (moved < HORIZON_S)
    old = np.isin(after.time_s, moved)
    assert same(after[old], before[kept].shifted(shift_s))
    fresh = after[~old].time_s
    assert len(fresh) > 5  # half a person per second, 35 s
    assert (fresh < 35).all() if shift_s > 0 else (fresh >= HORIZON_S - 35).all()


def test_members_of_a_group_stay_together() -> None:
    usual = MODELS["renewal"]()
    other = steered(usual, Change(area=0, factor=0.5))
    before, after = of(sample(usual, 4), 0), of(sample(other, 4), 0)
    sizes = [np.unique(e.time_s, return_counts=True)[1] for e in (before, after)]
    assert np.array_equal(sizes[1], sizes[0][: len(sizes[1])])
    assert sizes[1].max() > 1


def test_a_closed_goal_moves_those_who_walk_there_and_nobody_else() -> None:
    usual = MODELS["renewal"]()
    before, after = sample(usual, 5), sample(steered(usual, closed_goals=(0,)), 5)
    assert same(before, after, "goal", "goal_area", "velocity")
    others = before.goal_area != 0
    assert same(before[others], after[others])
    assert (after.goal_area == 1).all()
    way = after.goal - after.start
    heading = way / np.linalg.norm(way, axis=1, keepdims=True)
    np.testing.assert_allclose(after.velocity, heading * after.speed[:, None], atol=1e-5)


def test_changed_goals_are_drawn_as_asked_and_as_few_people_change_theirs_as_can_be() -> None:
    usual = MODELS["poisson"]()
    other = steered(usual, Change(area=0, goals={0: 0.5, 1: 0.5}))
    before, after = of(sample(usual, 6, 8000.0), 0), of(sample(other, 6, 8000.0), 0)
    assert same(before, after, "goal", "goal_area", "velocity")
    error = 0.5 / np.sqrt(len(after))
    assert abs((after.goal_area == 0).mean() - 0.5) < 4.5 * error
    # From 0.2 and 0.8 to 0.5 each three tenths have to move, and all of them from 1 to 0.
    moved = before.goal_area != after.goal_area
    assert abs(moved.mean() - 0.3) < 4.5 * error
    assert (after.goal_area[moved] == 0).all()
    assert same(before[~moved], after[~moved])


def test_an_added_area_has_its_rate_groups_and_goals_and_the_next_number() -> None:
    usual = MODELS["poisson"]()
    addition = Addition(
        mean_m=(5.0, 3.0),
        sd_m=(0.2, 0.4),
        persons_per_min=((100.0, 60.0), (4100.0, 0.0)),
        group_size=1.5,
        goals={0: 0.25, 1: 0.75},
    )
    events = sample(steered(usual, add=(addition,)), 7, 5000.0)
    new = of(events, 2)
    assert same(events[events.spawn_area < 2], sample(usual, 7, 5000.0))
    assert ((new.time_s >= 100) & (new.time_s < 4100)).all()
    sizes = np.unique(new.time_s, return_counts=True)[1]
    # Geometric sizes of mean m: the variance of the number of persons is n (2 m − 1).
    assert abs(len(new) - 4000) < 4.5 * np.sqrt(4000 * 2)
    assert sizes.mean() == pytest.approx(1.5, abs=0.08)
    np.testing.assert_allclose(new.start.mean(axis=0), [5.0, 3.0], atol=0.05)
    np.testing.assert_allclose(new.start.std(axis=0), [0.2, 0.4], atol=0.05)
    assert (new.goal_area == 1).mean() == pytest.approx(0.75, abs=0.05)
    assert new.speed.min() >= 1.0
    assert new.speed.max() <= 1.5


@pytest.mark.parametrize(
    ("factor", "quiet"),
    [(((0.0, 0.0), (20.0, 1.0)), (-np.inf, 20.0)), (((20.0, 0.0), (60.0, 1.0)), (20.0, 60.0))],
)
def test_times_count_from_the_episodes_start(factor: Profile, quiet: tuple[float, float]) -> None:
    model = steered(MODELS["poisson"](), Change(area=0, factor=factor))
    warm_up = ETH.frames(warm_up_s(ETH))
    times = np.concatenate(
        [
            of(arrivals(model, ETH, seed=k, world=0, warm_up=warm_up, frames=250), 0).time_s
            for k in range(40)
        ]
    )
    assert not ((times >= quiet[0]) & (times < quiet[1])).any()
    assert times[times >= quiet[1]].min() < quiet[1] + 0.5  # of 20 persons a second in all
    if quiet[0] > 0:
        assert times[times < quiet[0]].max() > quiet[0] - 0.5
        assert times.min() < 0.5 - warm_up * ETH.dt_s
