"""Steered models of plans: groups stay together, and groups and stops can be changed."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from crowdbench.errors import SettingError
from crowdbench.registry import recording_of, spawn_model
from crowdbench.scene import load_scene
from crowdbench.spawn import Addition, Change, Scenario, SpawnEvents, SpawnModel, Steered
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.plans.fitting import fit_plans
from crowdbench.spawn.plans.planned import PlannedAreas
from crowdbench.spawn.steering.scenario import check_scenario

PLAZA = load_scene("plaza-v0")
HORIZON_S = 3_000.0


@pytest.fixture(scope="module")
def areas() -> PlannedAreas:
    crowd = recording_of(PLAZA)
    fitted = fit_plans(crowd, blocks_of(crowd, PLAZA), read_areas(PLAZA))
    k, g = fitted.ways.stopping.shape
    ways = replace(
        fitted.ways,
        stopping=np.full((k, g), 0.1),
        stop_mean=np.array([[10.0, 10.0, np.log(8.0)]]),
        stop_covariance=np.diag([0.1, 0.1, 0.01])[None],
        from_area=np.ones((1, k)),
        to_area=np.ones((1, g)),
    )
    return replace(fitted, ways=ways)


@pytest.fixture(scope="module")
def model(areas: PlannedAreas) -> SpawnModel:
    return replace(spawn_model("poisson-groups", PLAZA), areas=areas)


def sample(model: SpawnModel, *change: Change, **more: object) -> SpawnEvents:
    if change or more:
        scenario = Scenario(name="s", scene="plaza-v0", change=change, **more)  # type: ignore[arg-type]
        check_scenario(scenario, PLAZA, model.areas, "test")  # type: ignore[attr-defined]
        model = Steered(model, scenario, model.areas)  # type: ignore[attr-defined]
    return model.sample(HORIZON_S, PLAZA, np.random.default_rng(0))


def of(events: SpawnEvents, area: int) -> SpawnEvents:
    return events[events.spawn_area == area]


def groups(events: SpawnEvents) -> Iterator[SpawnEvents]:
    for k in np.unique(events.group[events.group >= 0]):
        yield events[events.group == k]


def mean_size(events: SpawnEvents) -> float:
    alone = int((events.group < 0).sum())
    return len(events) / (alone + sum(1 for _ in groups(events)))


def test_a_factor_keeps_groups_together(model: SpawnModel) -> None:
    found = of(sample(model, Change(area=0, factor=((500.0, 3.0),))), 0)
    assert sum(1 for _ in groups(found)) > 20
    for members in groups(found):
        assert len(members) > 1
        assert len(np.unique(members.goal_area)) == 1
        assert np.ptp(members.time_s) <= 12.0


@pytest.mark.parametrize("size", [1.0, 1.3, 1.7])
def test_groups_have_the_size_that_is_asked_for(model: SpawnModel, size: float) -> None:
    usual, found = sample(model), sample(model, Change(area=1, group_size=size))
    assert mean_size(of(found, 1)) == pytest.approx(size, rel=0.1)
    np.testing.assert_array_equal(of(found, 1).time_s, of(usual, 1).time_s)
    for k in (0, 2, 3):
        np.testing.assert_array_equal(of(found, k).start, of(usual, k).start)


def test_as_many_stop_for_as_long_as_asked_for(model: SpawnModel) -> None:
    found = of(sample(model, Change(area=2, stop=0.6, wait_s=30.0)), 2)
    led = found[(found.group < 0) | np.append(True, np.diff(found.group) != 0)]
    assert (led.wait_s > 0).mean() == pytest.approx(0.6, abs=0.08)
    assert found.wait_s[found.wait_s > 0].mean() == pytest.approx(30.0, rel=0.1)
    nobody = of(sample(model, Change(area=2, stop=0.0)), 2)
    assert (nobody.wait_s == 0).all()


def test_companions_change_their_goal_together(model: SpawnModel, areas: PlannedAreas) -> None:
    closed = int(np.argmax(areas.flow[0]))
    found = sample(model, closed_goals=(closed,))
    assert (found.goal_area != closed).all()
    for members in groups(found):
        assert len(np.unique(members.goal_area)) == 1
    assert PLAZA.walkable(found.goal.astype(np.float64)).all()


def test_people_of_an_added_area_come_in_groups(model: SpawnModel) -> None:
    addition = Addition(
        mean_m=(10.0, 10.0), sd_m=(1.0, 1.0), persons_per_min=20.0, group_size=2.0, goals={0: 1.0}
    )
    found = of(sample(model, add=(addition,)), len(model.areas.spawn))  # type: ignore[attr-defined]
    assert len(found) == pytest.approx(20 * HORIZON_S / 60, rel=0.15)
    assert mean_size(found) == pytest.approx(2.0, rel=0.1)
    for members in groups(found):
        assert np.ptp(members.time_s) == 0
        assert len(np.unique(members.start, axis=0)) == len(members)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (Change(area=0, group_size=0.5), "group_size"),
        (Change(area=0, stop=1.5), "stop"),
        (Change(area=0, wait_s=1.0), "wait_s"),
    ],
)
def test_impossible_groups_and_stops_are_refused(
    model: SpawnModel, change: Change, told: str
) -> None:
    with pytest.raises(SettingError, match=told):
        sample(model, change)


def test_models_of_single_people_have_neither_groups_nor_stops() -> None:
    with pytest.raises(SettingError, match="model of plans, such as ntpp-plans"):
        sample(spawn_model("poisson-groups", PLAZA), Change(area=0, stop=0.5))


def test_places_of_stops_must_be_known(areas: PlannedAreas) -> None:
    ways = replace(
        areas.ways,
        stop_mean=np.zeros((0, 3)),
        stop_covariance=np.zeros((0, 3, 3)),
        from_area=np.zeros((0, len(areas.spawn))),
        to_area=np.zeros((0, len(areas.goal))),
    )
    without = replace(spawn_model("poisson-groups", PLAZA), areas=replace(areas, ways=ways))
    with pytest.raises(SettingError, match="too few recorded people stop"):
        sample(without, Change(area=0, stop=0.5))
