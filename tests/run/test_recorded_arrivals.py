"""Rollouts of other simulators under the recorded arrivals."""

from dataclasses import replace

import numpy as np
import pytest

from crowdbench import read, recording_of, rollout, score_rollouts
from crowdbench.data.storage import write_csv
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.errors import RecordingError
from crowdbench.run.judge import matched, recognised
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import rows

PLAZA = load_scene("plaza-v0")
GOAL, EXIT, UNKNOWN = (OUTCOMES.index(name) for name in ("goal", "exit", "unknown"))


@pytest.fixture(scope="module")
def recording() -> Trajectories:
    return recording_of("plaza-v0")


@pytest.fixture(scope="module")
def walked() -> Trajectories:
    return rollout("plaza-v0", "replay", "social-force", seed=0)


def nameless(crowd: Trajectories) -> Trajectories:
    """The crowd as another simulator knows it: without goals, groups and outcomes."""
    size = len(crowd)
    return replace(
        crowd,
        goal_x=crowd.end[:, 0],
        goal_y=crowd.end[:, 1],
        spawn_area=np.full(size, -1, np.int32),
        goal_area=np.full(size, -1, np.int32),
        group=np.full(size, -1, np.int32),
        outcome=np.full(size, UNKNOWN, np.int8),
    )


def test_people_get_the_plans_of_those_whom_they_stand_for(walked, recording) -> None:
    assert matched(walked, recording).tolist() == list(range(len(recording)))
    found = recognised(nameless(walked), recording, PLAZA)
    for name in ("goal_x", "goal_y", "goal_area", "group"):
        np.testing.assert_array_equal(getattr(found, name), getattr(recording, name))
    ended = (walked.outcome == GOAL) & recording.left
    assert (found.outcome[ended] == GOAL).all()


def test_who_vanishes_on_the_way_has_not_arrived(walked, recording) -> None:
    length = np.diff(walked.offsets)
    half = np.where(np.arange(len(walked)) % 2, length, np.maximum(2, length // 2))
    kept = np.arange(len(walked.xy)) - np.repeat(walked.offsets[:-1], length) < np.repeat(
        half, length
    )
    offsets = np.concatenate([[0], np.cumsum(half)])
    cut = replace(nameless(walked), xy=walked.xy[kept], offsets=offsets)
    found = recognised(cut, recording, PLAZA)
    assert 0.4 < (found.outcome == EXIT).mean() < 0.6
    card = score_rollouts(PLAZA, [cut], recorded_arrivals=True)
    (mine,) = (row for row in rows(card) if row.kind == "entry")
    assert mine.entry.at_goal == pytest.approx(0.5, abs=0.1)
    assert mine.fails == ("arrivals",)
    assert mine.walk is not None
    assert mine.walk.value <= 0


def test_stated_outcomes_are_kept(walked, recording) -> None:
    stated = np.full(len(walked), OUTCOMES.index("timeout"), np.int8)
    found = recognised(replace(nameless(walked), outcome=stated), recording, PLAZA)
    assert found.outcome.tolist() == stated.tolist()


def test_people_who_enter_at_other_times_are_nobody_recorded(walked, recording) -> None:
    later = replace(walked, requested_s=walked.requested_s[::-1].copy())
    with pytest.raises(RecordingError, match="enter like one of the"):
        recognised(later, recording, PLAZA)


def test_other_arrivals_are_rejected(recording) -> None:
    other = rollout("plaza-v0", "poisson-gmm", "straight", seed=1)
    with pytest.raises(RecordingError, match=r"spawn sample plaza-v0 --model replay"):
        score_rollouts(PLAZA, [other, other], recorded_arrivals=True)


def test_a_plain_table_of_one_deterministic_simulator_is_scored(walked, tmp_path) -> None:
    write_csv(nameless(walked), tmp_path / "walked.csv")
    plain = read(tmp_path / "walked.csv", PLAZA)
    (mine,) = (
        r for r in rows(score_rollouts(PLAZA, [plain], recorded_arrivals=True)) if r.kind == "entry"
    )
    (own,) = (
        r
        for r in rows(score_rollouts(PLAZA, [walked], recorded_arrivals=True))
        if r.kind == "entry"
    )
    assert mine.walk is not None
    assert own.walk is not None
    assert mine.walk.value == pytest.approx(own.walk.value, abs=0.05)
