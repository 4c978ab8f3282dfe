"""Walkers that anticipate: the guide, the mirrored samples, and a file that does the same."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from given import Given
from worlds import Person, square

from crowdbench.baselines import anticipate
from crowdbench.baselines.anticipate import (
    FEWEST,
    GAIN,
    GRID,
    MARGIN,
    WIDTHS,
    best,
    corrected,
    mirrored,
)
from crowdbench.baselines.anticipation import (
    ABREAST_M,
    KNOTS_M,
    LOOK_S,
    NOISE,
    SCALARS,
    TOO_NEAR_M,
    Guide,
    Sampler,
    Walker,
    sloping,
)
from crowdbench.policies import OnnxPolicy, Straight
from crowdbench.run.episode import begin
from crowdbench.run.validation import Validation, validate
from crowdbench.simulation import Settings, Simulation, social

WALKING = 1.3 / 5.0
"""Speed of the people in these tests, in units of the maximum speed of 5 m/s."""
CANDIDATES = torch.tensor([[[WALKING], [0.9 * WALKING], [0.0]], [[0.0], [0.4 * WALKING], [0.0]]])
"""Straight on, to the left, and standing: coordinates, candidates, people."""


@pytest.fixture
def seen() -> torch.Tensor:
    """The observation (1, 102) of somebody who walks alone in the open, far from the target."""
    found = torch.zeros(1, social.SIZE)
    found[:, social.VELOCITY.start] = WALKING
    found[:, social.ROUTE_DIRECTION.start] = 1.0
    found[:, social.ROUTE_LENGTH] = 0.5
    found[:, social.PROBES] = 1.0
    return found


@pytest.fixture
def sampler() -> Sampler:
    torch.manual_seed(0)
    return Sampler(Walker(5.0, 16), Guide())


def meet(seen: torch.Tensor, *, companion: bool = False) -> torch.Tensor:
    """Somebody comes towards the person from 3 m ahead."""
    found = seen.clone()
    other = found[:, social.NEIGHBOURS.start : social.NEIGHBOURS.start + social.FEATURES]
    other[:, social.OFFSET.start] = 3.0 / social.RANGE_M
    other[:, social.APPROACH.start] = -2 * WALKING
    other[:, social.COMPANION] = float(companion)
    other[:, social.PRESENT] = 1.0
    return found


def test_close_passes_of_strangers_cost(seen, sampler: Sampler) -> None:
    apart = torch.tensor(1.5)
    assert not sampler.passes(seen.T, CANDIDATES, apart).any()
    straight, left, stand = sampler.passes(meet(seen).T, CANDIDATES, apart)[:, 0].tolist()
    assert straight == pytest.approx(1.0, abs=1e-3)  # they would meet
    assert 0 < left < straight
    assert stand == pytest.approx(1.0, abs=1e-3)  # it would be run into
    assert not sampler.passes(meet(seen, companion=True).T, CANDIDATES, apart).any()
    nearer = sampler.passes(meet(seen).T, CANDIDATES, torch.tensor(0.7))[:, 0].tolist()
    assert nearer[0] == pytest.approx(1.0, abs=1e-3)
    assert 0 <= nearer[1] < left


def test_delay_costs_except_at_a_stop(seen, sampler: Sampler) -> None:
    seen[:, social.PREFERRED_SPEED] = WALKING
    straight, left, stand = sampler.delays(seen.T, CANDIDATES)[:, 0].tolist()
    assert (straight, stand) == (pytest.approx(0.0, abs=1e-6), 1.0)
    assert left == pytest.approx(0.1)
    seen[:, social.STOP] = 1.0
    assert sampler.delays(seen.T, CANDIDATES)[2, 0] == 1.0  # still on the way to it
    seen[:, social.ROUTE_LENGTH] = 0.9 / social.ROUTE_RANGE_M
    assert not sampler.delays(seen.T, CANDIDATES).any()


def test_walls_cost_where_the_candidate_leads(seen, sampler: Sampler) -> None:
    wall = torch.tensor(sloping(1.0))
    assert not sampler.walls(seen.T, CANDIDATES, wall).any()
    ahead = np.flatnonzero(social.PROBE_POINTS[:, 0] > 0.9)
    seen[:, social.PROBES.start + ahead] = 0.0
    straight, left, stand = sampler.walls(seen.T, CANDIDATES, wall)[:, 0].tolist()
    assert straight > left > stand
    seen[:, social.ROUTE_LENGTH] = 0.3 / social.ROUTE_RANGE_M  # a target at the wall
    near_target = sampler.walls(seen.T, CANDIDATES, wall)[0, 0]
    assert near_target == pytest.approx(0.1 * straight, rel=1e-4)


@pytest.mark.parametrize("distance_m", [0.0, 0.1, 0.5, 0.6, 1.1, 1.9, 2.0])
def test_the_cost_of_walls_is_linear_between_its_knots(
    seen, sampler: Sampler, distance_m: float
) -> None:
    wall = (9.0, 7.0, 2.0, -1.0, 3.0, 4.0, 2.0, 1.0, 0.5)
    seen[:, social.PROBES] = distance_m / KNOTS_M[-1]  # the same everywhere
    costs = sampler.walls(seen.T, CANDIDATES, torch.tensor(wall))
    np.testing.assert_allclose(costs, np.interp(distance_m, KNOTS_M, [*wall, 0.0]), atol=1e-5)


def found(recorded: Sequence[float], simulated: Sequence[float]) -> Validation:
    """A validation with these shares of positions at 0, 1 and 2 m from walls."""
    both = np.zeros((2, 41))
    both[:, [0, 20, 40]] = recorded, simulated
    return Validation({}, {}, 1.0, 1.0, 1.0, {}, (tuple(both[0]), tuple(both[1])), passes=True)


def test_walls_cost_more_where_people_walk_too_often() -> None:
    guide = Guide(wall=sloping(8.0))
    right = found([0.1, 0.3, 0.6], [0.1, 0.3, 0.6])
    assert corrected(guide, [right]) == guide
    off = found([0.1, 0.3, 0.6], [0.3, 0.24, 0.46])
    change = np.subtract(corrected(guide, [off]).wall, guide.wall)
    far = np.log((0.6 + FEWEST) / (0.46 + FEWEST))  # where the cost stays 0
    assert change[0] == pytest.approx(
        GAIN * (np.log((0.3 + FEWEST) / (0.1 + FEWEST)) + far), abs=0.01
    )
    assert change[5] == pytest.approx(
        GAIN * (np.log((0.24 + FEWEST) / (0.3 + FEWEST)) + far), abs=0.01
    )
    # Nobody is anywhere else, which is no reason to go there, nor to avoid it.
    np.testing.assert_allclose(change[[1, 2, 7]], GAIN * far, atol=0.01)
    halved = np.subtract(corrected(guide, [off, right]).wall, guide.wall)  # of two scenes
    np.testing.assert_allclose(halved, change / 2, atol=0.01)


def test_a_guide_becomes_numbers_in_the_order_in_which_the_sampler_reads_them() -> None:
    numbers = Guide(jitter=0.3, room=7.0, wall=sloping(4.0)).tensor()
    assert len(numbers) == SCALARS + len(KNOTS_M) - 1
    assert numbers[0] == pytest.approx(0.3)
    assert numbers[SCALARS - 1] == 7.0
    assert numbers[SCALARS] == 4.0


def test_leaving_a_companion_costs_the_distance_beyond_that_of_companions(
    seen, sampler: Sampler
) -> None:

    def partings(of: torch.Tensor) -> torch.Tensor:
        return sampler.together(of.T, CANDIDATES, torch.tensor(2.0), torch.tensor(0.0)) / 2

    assert not partings(meet(seen)).any()  # a stranger
    walks = meet(seen, companion=True)
    ahead = walks[:, social.NEIGHBOURS.start + social.APPROACH.start]
    ahead[:] = 0.0  # the companion walks as fast, 3 m ahead
    costs = partings(walks)[:, 0].numpy()
    gap = np.array([3.0, 0.0]) + LOOK_S * 5.0 * (CANDIDATES[:, :1] - CANDIDATES)[..., 0].T.numpy()
    np.testing.assert_allclose(costs, np.hypot(*gap.T) - ABREAST_M, atol=1e-4)
    beside = walks.clone()
    beside[:, social.NEIGHBOURS.start + social.OFFSET.start] = 0.8 / social.RANGE_M
    assert partings(beside)[0, 0] == 0.0
    both = walks.clone()  # another companion beside the person halves the mean
    second = both[:, social.NEIGHBOURS.start + social.FEATURES :]
    second[:, social.OFFSET.start] = 0.8 / social.RANGE_M
    second[:, social.COMPANION] = second[:, social.PRESENT] = 1.0
    assert partings(both)[0, 0] == pytest.approx((3.0 - ABREAST_M) / 2, abs=1e-4)


def test_companions_who_come_too_near_cost_what_they_lack_in_distance(
    seen, sampler: Sampler
) -> None:
    beside = meet(seen, companion=True)
    other = beside[:, social.NEIGHBOURS.start :]
    other[:, social.OFFSET.start] = 0.3 / social.RANGE_M  # 0.3 m ahead, and as fast
    other[:, social.APPROACH.start] = 0.0
    keep, room = torch.tensor(0.0), torch.tensor(3.0)
    assert sampler.together(beside.T, CANDIDATES, keep, room)[0, 0] == pytest.approx(
        3.0 * (TOO_NEAR_M - 0.3), abs=1e-3
    )
    other[:, social.OFFSET.start] = (TOO_NEAR_M + 0.1) / social.RANGE_M
    assert sampler.together(beside.T, CANDIDATES, keep, room)[0, 0] == 0.0


def test_missing_a_near_target_costs_its_distance(seen, sampler: Sampler) -> None:
    assert not sampler.misses(seen.T, CANDIDATES).any()  # too far away
    seen[:, social.ROUTE_LENGTH] = 2.0 / social.ROUTE_RANGE_M
    seen[:, social.ROUTE_DIRECTION] = torch.tensor([0.6, 0.8])
    straight, left, stand = sampler.misses(seen.T, CANDIDATES)[:, 0].tolist()
    assert straight == pytest.approx(1.6, abs=1e-4)
    assert left < straight
    assert stand == pytest.approx(2.0, abs=1e-4)


def test_with_a_guide_people_pass_strangers_at_a_greater_distance(seen, sampler: Sampler) -> None:
    many = meet(seen).repeat(2000, 1)
    noise = torch.randn(2000, NOISE, generator=torch.Generator().manual_seed(1))
    passed = []
    for avoid in (0.0, 30.0):
        guide = Guide(avoid=avoid, apart=1.5, delay=0.0, home=0.0, wall=sloping(0.0)).tensor()
        with torch.no_grad():
            actions = sampler(many, noise, guide)
        passed.append(float(sampler.passes(many.T, actions.T[:, None], torch.tensor(1.5)).mean()))
    assert passed[1] < 0.9 * passed[0]


def test_those_who_stand_walk_on_as_planned_and_stand_at_a_stop(seen, sampler: Sampler) -> None:
    with torch.no_grad():
        sampler.walker.layers[-1].weight.zero_()
        sampler.walker.layers[-1].bias.zero_()
        sampler.walker.layers[-1].bias[2::5] = sampler.walker.layers[-1].bias[3::5] = -9.0
    seen[:, social.VELOCITY] = 0.0  # all candidates of the network stand, too
    seen[:, social.PREFERRED_SPEED] = WALKING
    many = seen.repeat(2000, 1)
    noise = torch.randn(2000, NOISE, generator=torch.Generator().manual_seed(1))

    def share(resume: float) -> float:
        guide = Guide(delay=2.0, home=0.0, resume=resume).tensor()
        with torch.no_grad():
            acted = sampler(many, noise, guide)
        walks = acted[:, 0] > WALKING / 2
        np.testing.assert_allclose(acted[walks], many[walks, social.ROUTE_DIRECTION] * WALKING)
        return float(walks.float().mean())

    odds = np.exp([2.0, -2.0, -1000.0]) / 12  # delay less resume, of one candidate in 13
    np.testing.assert_allclose([share(0.0), share(4.0), share(1e3)], odds / (1 + odds), atol=0.02)
    many[:, social.STOP] = 1.0
    many[:, social.ROUTE_LENGTH] = 0.5 / social.ROUTE_RANGE_M
    assert share(-10.0) == 0.0
    assert not sampler.planned(many.T).any()


def test_mirrored_observations_are_those_of_a_mirrored_world() -> None:
    people = [
        Person(start=(0.0, 0.0), goal=(8.0, 3.0), speed=1.2),
        Person(start=(2.0, 1.5), goal=(-8.0, -2.0), speed=1.0),
        Person(start=(-1.0, -2.5), goal=(7.0, -7.0), speed=1.4),
        Person(start=(9.0, 9.2), goal=(9.0, -9.0), speed=1.1),
    ]
    across = [
        Person(
            start=(p.start[0], -p.start[1]), goal=(p.goal[0], -p.goal[1]), speed=p.speed
        )
        for p in people
    ]  # fmt: skip
    each = []
    for crowd in (people, across):
        simulation = Simulation(square(), settings=Settings(max_alive=8, observation="social-1"))
        begin(simulation, Given(*crowd), seed=0, frames=20, start="empty", walker=Straight())
        for _ in range(4):
            simulation.step(np.full(simulation.slots.position.shape, [0.2, 0.0], np.float32))
        each.append(simulation.observe()[0, :4].copy())
    here, there = each
    np.testing.assert_allclose(mirrored(here), there, atol=1e-5)
    np.testing.assert_array_equal(mirrored(mirrored(here)), here)
    assert not np.allclose(here, there, atol=0.1)


def test_a_guide_replaces_the_first_one_only_if_it_scores_clearly_more() -> None:
    first, second, third = (Guide(width=width) for width in (1.0, 0.9, 0.8))
    little, much = 0.5 * MARGIN, 1.5 * MARGIN
    assert best([(first, 0.7), (second, 0.7 + little), (third, 0.5)]) == (first, 0.7)
    assert best([(first, 0.7), (second, 0.7 + much), (third, 0.7 + little)])[0] == second
    assert best([(first, 0.7)]) == (first, 0.7)


def test_the_search_starts_with_values_of_the_grid() -> None:
    assert all(getattr(Guide(), name) in values for name, values in GRID.items())
    assert Guide.width == WIDTHS[0]


@pytest.mark.nightly
def test_it_trains_chooses_a_guide_and_writes_a_policy_that_arrives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(anticipate, "GRID", {"avoid": (0.0, Guide.avoid)})
    monkeypatch.setattr(anticipate, "WIDTHS", (Guide.width, 0.3))
    monkeypatch.setattr(anticipate, "CORRECTIONS", 2)
    monkeypatch.setattr(anticipate, "ROOM", (0.0, 16.0))
    arguments = ["--scene", "plaza-v0", "--splits", "fold1", "--steps", "800"]
    more = ["--people", "1", "--out", str(tmp_path)]
    assert anticipate.main(arguments + more) == 0
    said = capsys.readouterr().out
    assert "fold1: held out" in said
    tried = re.findall(r"width=([\d.]+), avoid=([\d.]+).*: walk ", said)
    assert tried == [("1.0", "16.0"), ("1.0", "0.0"), ("0.3", "16.0"), ("0.3", "0.0")]
    walls = set(re.findall(r"wall=\(([^)]*)\)", said))
    assert len(walls) == 4  # corrected for each value of another setting
    assert str(Guide.wall).strip("()") not in walls
    apart = {
        room: abs(math.log(float(ratio)))
        for room, ratio in re.findall(
            r"room=([\d.]+), wall=.*: companion distance plaza-v0 ([\d.]+)", said
        )
    }
    assert set(apart) == {"0.0", "16.0"}
    assert re.search(rf"fold1: chosen: Guide\(.*room={min(apart, key=apart.__getitem__)},", said)
    policy = OnnxPolicy(tmp_path / "fold1.onnx")
    assert (policy.card.split, policy.card.interval, policy.noise) == ("fold1", 1, NOISE)
    assert "--steps 800" in policy.card.command
    found = validate("plaza-v0", policy, "fold1")
    assert found.at_goal > 0.9
    assert 0.6 < found.speed_mps / found.recorded_speed_mps < 1.15


def test_bad_settings_are_an_error_that_says_which(capsys: pytest.CaptureFixture[str]) -> None:
    assert anticipate.main(["--scene", "plaza-v0", "--steps", "0"]) == 2
    assert "steps" in capsys.readouterr().err
