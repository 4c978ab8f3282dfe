"""Demonstrations with a decision interval and for policies with a memory: companions, stops."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_crowds import DT, SQUARE, recorded, recording_is, straight, wandering

from crowdbench import Demonstrations, demonstrations, load_scene, recording_of, rollout
from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError
from crowdbench.policies import Memory
from crowdbench.simulation.observations import GOAL_DISTANCE
from crowdbench.simulation.social import (
    AGE,
    AGE_S,
    COMPANION,
    HEADING,
    PREFERRED_SPEED,
    PRESENT,
    RANGE_M,
    STOP,
    VELOCITY,
    WAIT_LEFT,
    WAIT_S,
    neighbours_of,
)
from crowdbench.spawn import Replay
from crowdbench.spawn.recorded_plans import plans_of

STEP_M = DT * SQUARE.motion.max_speed_mps


def in_world(shown: Demonstrations) -> np.ndarray:
    """The actions in the world frame."""
    if shown.provenance["observation"] != "social-1":
        return shown.actions
    cos, sin = shown.observations[:, HEADING].T
    x, y = shown.actions.T
    return np.stack([x * cos - y * sin, x * sin + y * cos], axis=1)


@given(seed=st.integers(0, 1000), interval=st.integers(1, 6), own=st.booleans())
@settings(max_examples=30, deadline=None)
def test_each_action_leads_to_the_recorded_position_at_the_next_decision(
    seed: int, interval: int, own: bool
) -> None:
    rng = np.random.default_rng(seed)
    crowd = recorded(
        *((int(rng.integers(0, 40)), wandering(rng, int(rng.integers(2, 40)))) for _ in range(6))
    )
    observation = "social-1" if own else "lidar-2"
    with recording_is(crowd) as scene:
        shown = demonstrations(scene, observation=observation, rays=4, interval=interval)
    assert shown.person.tolist() == list(range(len(crowd)))
    assert shown.first.tolist() == crowd.first.tolist()
    assert shown.entered.all()
    assert shown.complete.tolist() == crowd.left.tolist()
    actions = in_world(shown)
    for k in range(len(crowd)):
        path = crowd.path(k).astype(np.float64)
        decisions = np.unique([*range(0, len(path) - 1, interval), len(path) - 1])
        rows = slice(shown.offsets[k], shown.offsets[k + 1])
        assert rows.stop - rows.start == len(decisions)
        held = np.diff(decisions)[:, None] * STEP_M * actions[rows][:-1]
        np.testing.assert_allclose(path[decisions[:-1]] + held, path[decisions[1:]], atol=1e-3)
        velocity = np.hypot(*shown.observations[rows, VELOCITY if own else slice(0, 2)].T)
        speed = np.hypot(*actions[rows].T)  # people keep it until the next decision
        np.testing.assert_allclose(velocity[1:], speed[:-1], atol=1e-4)


class Shown:
    """Walks as was shown, and counts decisions in its memory."""

    name, sees, memory = "shown", "observation", 1

    def __init__(self, shown: Demonstrations) -> None:
        self.shown = shown
        self.observation, self.interval = (
            shown.provenance[name] for name in ("observation", "interval")
        )
        self.rays = shown.provenance["rays"]
        self.different = 0.0

    def reset(self, scene, rng: np.random.Generator) -> None:
        pass

    def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
        row = self.shown.offsets[memory.person] + memory.state[:, 0].astype(np.int64)
        memory.state += 1
        there = row < self.shown.offsets[memory.person + 1]  # the recorded person may have left
        off = np.abs(seen[there] - self.shown.observations[row[there]])
        self.different = max(self.different, float(off.max(initial=0)))
        action = self.shown.actions[np.where(there, row, 0)]
        return np.where(there[:, None], np.nan_to_num(action), 0)


@pytest.mark.parametrize("observation", ["lidar-2", "social-1"])
def test_a_rollout_of_what_was_shown_sees_what_was_shown(observation: str) -> None:
    rng = np.random.default_rng(4)
    crowd = recorded(*((int(rng.integers(0, 9)), wandering(rng, 30)) for _ in range(7)))
    with recording_is(crowd) as scene:
        shown = demonstrations(scene, observation=observation, rays=4, interval=3)
        # Goals that nobody reaches: everyone stays until the recorded person leaves.
        policy = Shown(shown)
        walked = rollout(scene, Replay(crowd), policy, seed=0, horizon_s=38 * DT)
    assert policy.different < 1e-3
    for k in range(len(crowd)):
        length = min(len(walked.path(k)), len(crowd.path(k)))
        at = slice(0, length, 3)
        np.testing.assert_allclose(walked.path(k)[at], crowd.path(k)[at], atol=1e-3)


def test_an_interval_is_a_whole_number() -> None:
    with pytest.raises(SettingError, match="interval"):
        demonstrations("plaza-v0", interval=0)


def test_displaced_people_keep_their_velocities_between_decisions() -> None:
    crowd = recorded(*((k, straight((-30.0, 3.0 * k), (1.2, 0.0), 70)) for k in range(9)))
    with recording_is(crowd) as scene:
        shown = demonstrations(scene, rays=4, interval=4, displaced_m=0.5, seed=1)
    follows = np.diff(np.repeat(shown.person, np.diff(shown.offsets))) == 0
    # The velocity that is seen next is the action, but for a new curve and the way to the goal.
    off = np.abs(shown.observations[1:, :2] - shown.actions[:-1]).max(axis=1)[follows]
    assert np.median(off) < 1e-3
    moved = np.abs(shown.actions[:, 1]) > 1e-3  # beside their straight paths
    assert 0.2 < moved.mean() < 0.6


@pytest.fixture(scope="module")
def plaza() -> Trajectories:
    return recording_of("plaza-v0")


@pytest.fixture(scope="module")
def seen(plaza: Trajectories) -> Demonstrations:
    with recording_is(plaza):
        return demonstrations("plaza-v0", observation="social-1")


def test_companions_are_those_that_are_found_in_the_recording(plaza, seen) -> None:
    frame, person = plaza.row_frame(), plaza.row_person()
    order = np.argsort(frame, kind="stable")
    begins = np.searchsorted(frame[order], np.arange(plaza.frames + 1))
    flagged = compared = 0
    for k in range(0, len(seen), 9):
        who = int(seen.person[k])
        for row in range(seen.offsets[k] + 1, seen.offsets[k + 1] - 1, 7):
            t = int(seen.first[k] + row - seen.offsets[k])
            others = order[begins[t] : begins[t + 1]]
            others = others[person[others] != who]
            at_an_end = [np.isin(ends[person[others]], t) for ends in (plaza.first, plaza.last)]
            if np.any(at_an_end):
                continue  # who has just come or gone is not seen by everyone
            gap = np.linalg.norm(plaza.xy[others] - plaza.path(who)[t - plaza.first[who]], axis=1)
            nearest = np.argsort(gap)[:8]
            nearest = nearest[gap[nearest] < RANGE_M]
            if (np.diff(gap[nearest]) < 1e-3).any() or (np.abs(gap - RANGE_M) < 1e-3).any():
                continue  # as good as equally far
            mine = plaza.group[who]
            together = (mine >= 0) & (plaza.group[person[others[nearest]]] == mine)
            near = neighbours_of(seen.observations[row])
            assert near[:, PRESENT].sum() == len(nearest)
            assert near[: len(nearest), COMPANION].ravel().tolist() == together.tolist()
            flagged, compared = flagged + together.sum(), compared + len(nearest)
    assert compared > 1500
    assert 200 < flagged < compared / 2


def test_people_who_stop_see_their_stop_and_how_long_it_lasts(plaza, seen) -> None:
    plans = plans_of(plaza)
    stops = ~np.isnan(plans.via[:, 0])
    as_recorded = []
    for k, who in enumerate(seen.person.tolist()):
        rows = seen.observations[seen.offsets[k] : seen.offsets[k + 1]]
        stop, left = rows[:, STOP].ravel() == 1, rows[:, WAIT_LEFT].ravel() * WAIT_S
        if not stops[who]:
            assert not stop.any()
            assert not left.any()
            continue
        assert stop[: stop.sum()].all()  # first the stop, then the goal
        assert not left[stop.sum() :].any()
        if plans.wait_s[who] == 0:
            continue
        whole = min(plans.wait_s[who], WAIT_S)
        assert left[0] == pytest.approx(whole, abs=1e-3) or plans.wait_s[who] > WAIT_S
        assert (np.diff(left[: stop.sum()]) < 1e-4).all()  # it does not become longer
        as_recorded.append(int(stop.sum()) == plans.resumed[who] - plaza.offsets[who])
    assert len(as_recorded) > 30
    # Of the others, a few are in walls' way, or could not be seen to come nearer for 30 s.
    assert np.mean(as_recorded) > 0.95


def test_preferred_speeds_are_those_of_replayed_people(plaza, seen) -> None:
    events = Replay(plaza).sample(1e9, load_scene("plaza-v0"), np.random.default_rng(0))
    scale = seen.provenance["max_speed_mps"]
    got = seen.observations[seen.offsets[:-1], PREFERRED_SPEED].ravel() * scale
    np.testing.assert_allclose(got, events.speed[seen.person], rtol=1e-6)


def test_pieces_that_begin_with_an_entry_are_marked(plaza, seen) -> None:
    with recording_is(plaza):
        cut = demonstrations("plaza-v0", observation="social-1", split="fold1", interval=2)
    age_s = cut.observations[cut.offsets[:-1], AGE].ravel() * AGE_S
    assert cut.entered.tolist() == (age_s == 0).tolist()
    assert 20 < (~cut.entered).sum() < len(cut) / 2
    begun = (cut.first - plaza.first[cut.person]) * DT  # those cut off have their recorded age
    np.testing.assert_allclose(age_s, np.minimum(begun, AGE_S), atol=1e-3)
    _, some = cut.split(0.3, seed=0)
    assert some.entered.tolist() == cut.entered[np.isin(cut.person, some.person)].tolist()
    assert seen.entered.all()


def test_padded_batches_hold_the_pairs_in_order_of_time(seen) -> None:
    batch = seen.take([3, 0, 7])
    observations, actions, there = batch.padded()
    assert there.sum(axis=1).tolist() == (np.diff(batch.offsets) - 1).tolist()
    assert observations.shape[:2] == actions.shape[:2] == there.shape
    assert there.shape[1] == there.sum(axis=1).max()
    pairs = batch.pairs()
    np.testing.assert_array_equal(observations[there], pairs[0])
    np.testing.assert_array_equal(actions[there], pairs[1])
    assert not observations[~there].any()
    assert not actions[~there].any()
    age = observations[1, : there[1].sum(), AGE].ravel()
    assert (np.diff(age) > 0).all() or age.max() == 1
    nobody = seen.take([]).padded()
    assert nobody[0].shape == (0, 0, seen.observations.shape[1])


def test_the_way_to_the_goal_leads_by_the_stop(plaza, seen) -> None:
    with recording_is(plaza):
        shown = demonstrations("plaza-v0", observation="lidar-1", rays=1)
    plans = plans_of(plaza)
    pieces = np.flatnonzero(plans.wait_s[shown.person] > 0)
    who = shown.person[pieces]
    to_via = np.linalg.norm(plans.via[who] - plaza.start[who], axis=1)
    got = shown.observations[shown.offsets[:-1][pieces], GOAL_DISTANCE].ravel() * 30
    far = to_via > 1.5  # the others have arrived at their stops
    assert (np.abs(got - np.minimum(to_via, 30))[far] < 0.3).mean() > 0.95


def test_smoothed_paths_lose_noise_but_not_people() -> None:
    lines = [straight((-15.0, y), (1.3, 0.05 * y), 60) for y in (-4.0, 0.0, 0.8, 4.0)]
    crowd = recorded(*((2 * k, path) for k, path in enumerate(lines)))
    rng = np.random.default_rng(0)
    noisy = replace(crowd, xy=crowd.xy + rng.normal(0, 0.05, crowd.xy.shape).astype(np.float32))
    with recording_is(noisy) as place:
        rough, smooth = (
            demonstrations(place, observation="social-1", smoothing_s=window)
            for window in (0.0, 3.2)
        )
    assert rough.offsets.tolist() == smooth.offsets.tolist()
    assert smooth.provenance["smoothing_s"] == 3.2
    spread = [float(np.std(shown.pairs()[1][:, 1])) for shown in (rough, smooth)]
    assert spread[1] < 0.5 * spread[0]


@pytest.mark.parametrize(
    "wrong", [{"smoothing_s": -1.0}, {"smoothing_s": np.nan}, {"recovery_s": -1.0}]
)
def test_bad_times_are_errors(wrong: dict[str, float]) -> None:
    with pytest.raises(SettingError, match=next(iter(wrong))):
        demonstrations("plaza-v0", **wrong)
