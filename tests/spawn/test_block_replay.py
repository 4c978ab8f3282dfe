"""Block replay: recorded blocks in random order, nobody lost, stationary from the start."""

from dataclasses import replace

import numpy as np
import pytest
from models import AREAS
from strategies import crowd_of

from crowdbench.data.blocks import TimeBlocks, cut
from crowdbench.data.table import Trajectories
from crowdbench.scene import load_scene
from crowdbench.spawn import BlockReplay
from crowdbench.spawn.recorded_plans import plans_of

ETH = load_scene("eth-v0")
LIVES = [(2, 6), (2, 7), (4, 9), (13, 18), (14, 14), (27, 29), (35, 39)]


@pytest.fixture
def crowd() -> Trajectories:
    """Seven people in 40 frames; the fifth is seen once, the last was not seen to leave."""
    rng = np.random.default_rng(0)
    rows = sum(b - a + 1 for a, b in LIVES)
    return crowd_of(
        LIVES,
        frames=40,
        dt_s=0.4,
        xy=rng.uniform(4, 10, (rows, 2)),
        persons={"spawn_area": [0, 0, 1, 0, 1, -1, 0], "goal_area": [1, 1, 0, 1, 0, 1, -1]},
    )


def model_of(crowd: Trajectories, block_s: float = 4.0) -> BlockReplay:
    blocks = cut(crowd.observed, block_s=block_s, dt_s=0.4, grid_s=0.4)
    return BlockReplay(crowd, blocks, AREAS)


def ticks(model: BlockReplay, horizon_s: float, seed: int) -> list[int]:
    time_s = model.sample(horizon_s, ETH, np.random.default_rng(seed)).time_s
    return np.round(time_s / 0.4).astype(int).tolist()


def test_one_block_is_the_recording_over_and_over(crowd: Trajectories) -> None:
    # A single block of 39 points (its first frame is no arrival's): any sample is periodic.
    found = ticks(model_of(crowd, block_s=16.0), 0.4 * 39 * 5, 1)
    recorded = [a for a, _ in LIVES]
    shifts = {(found[0] - r) % 39 for r in recorded}
    assert any(
        sorted(found) == sorted(t for r in recorded for t in range((r + s) % 39, 195, 39))
        for s in shifts
    )


@pytest.mark.long
def test_every_grid_point_expects_the_recorded_rate(crowd: Trajectories) -> None:
    model, samples, points = model_of(crowd), 2500, 25
    count = np.zeros(points)
    for seed in range(samples):
        np.add.at(count, ticks(model, points * 0.4, seed), 1)
    expected = samples * len(LIVES) / 39
    # Two people at once make counts of a point vary by at most twice their mean.
    assert (np.abs(count - expected) < 4.5 * np.sqrt(2 * expected)).all()


def test_only_people_of_the_blocks_enter(crowd: Trajectories) -> None:
    model = model_of(crowd)
    second = BlockReplay(crowd, model.blocks.take(np.array([1])), AREAS)
    events = second.sample(400.0, ETH, np.random.default_rng(2))
    starts = {tuple(xy) for xy in events.start.tolist()}
    assert starts == {tuple(xy) for xy in crowd.start[3:5].tolist()}


def test_people_walk_to_where_their_records_end_at_their_own_speed(crowd: Trajectories) -> None:
    events = model_of(crowd).sample(800.0, ETH, np.random.default_rng(3))
    ends = {
        tuple(s): tuple(e) for s, e in zip(crowd.start.tolist(), crowd.end.tolist(), strict=True)
    }
    own = np.minimum(plans_of(crowd).speed, ETH.motion.max_speed_mps)
    speeds = {tuple(s): v for s, v in zip(crowd.start.tolist(), own.tolist(), strict=True)}
    assert np.isfinite(own).sum() >= 3
    cut_off = tuple(crowd.start[6].tolist())
    seen = set()
    for start, goal, speed in zip(
        events.start.tolist(), events.goal.tolist(), events.speed, strict=True
    ):
        who = tuple(start)
        seen.add(who)
        if who != cut_off:
            assert tuple(goal) == ends[who]
        if np.isfinite(speeds[who]):  # whoever hardly walked gets a drawn speed
            assert speed == pytest.approx(speeds[who], rel=1e-5)
    assert seen == set(ends)


def test_who_was_not_seen_to_leave_gets_a_goal_of_its_area(crowd: Trajectories) -> None:
    assert not crowd.left[6]
    events = model_of(crowd).sample(800.0, ETH, np.random.default_rng(4))
    cut_off = (events.start == crowd.start[6]).all(axis=1)
    assert (events.goal_area[cut_off] == 1).all()  # area 0 sends all to goal 1
    assert len(np.unique(events.goal[cut_off], axis=0)) > 3
    assert np.linalg.norm(events.goal[cut_off] - AREAS.goal.mean[1], axis=1).max() < 6


def test_who_was_seen_once_gets_a_drawn_speed(crowd: Trajectories) -> None:
    events = model_of(crowd).sample(800.0, ETH, np.random.default_rng(5))
    once = (events.start == crowd.start[4]).all(axis=1)
    assert once.any()
    assert ((events.speed[once] >= 1.0) & (events.speed[once] <= 1.5)).all()


def test_the_same_seed_plays_the_same_blocks(crowd: Trajectories) -> None:
    model = model_of(crowd)
    assert ticks(model, 100.0, 6) == ticks(model, 100.0, 6)
    assert ticks(model, 100.0, 6) != ticks(model, 100.0, 7)


def test_blocks_of_the_grid_between_frames_are_played_on_it() -> None:
    # Frames of 0.4 s, arrivals on a grid of 0.1 s.
    crowd = crowd_of(
        [(3, 5), (6, 9)], frames=20, dt_s=0.4, grid_s=0.1,
        persons={"spawn_area": [0, 0], "goal_area": [1, 1], "spawn_s": [1.1, 2.3]},
    )  # fmt: skip
    blocks = TimeBlocks(np.array([[0, 20]]), np.array([0]), 0.4, 0.1)
    events = BlockReplay(crowd, blocks, AREAS).sample(40.0, ETH, np.random.default_rng(8))
    gaps = np.unique(np.diff(events.time_s).round(6))
    assert gaps.tolist() == [1.2, 6.4]  # 7.6 s a round


def test_people_recorded_in_a_wall_start_and_end_beside_it(crowd: Trajectories) -> None:
    inside = replace(crowd, xy=np.full_like(crowd.xy, 14.9))  # in ETH's north parapet
    assert not ETH.walkable(inside.xy.astype(np.float64)).any()
    events = model_of(inside).sample(40.0, ETH, np.random.default_rng(0))
    assert len(events) > 5
    for points in (events.start, events.goal):
        assert ETH.walkable(points.astype(np.float64)).all()
