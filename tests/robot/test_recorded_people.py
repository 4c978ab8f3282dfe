"""Robots among recorded people: they walk as recorded, or arrive so and walk by a policy."""

import numpy as np
import pytest
from lonely_robots import DISC
from recorded_crowds import SQUARE, recorded, straight

from crowdbench.policies.walkers import RecordedPaths, ReplayPolicy
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.spawn.replay import Replay

RECORDING = recorded(
    (0, straight((-30.0, 0.0), (1.2, 0.0), 60)),
    (10, straight((0.0, 30.0), (0.0, -1.0), 40)),
    (30, straight((20.0, 20.0), (-0.8, -0.8), 45)),
)
ENDS = {"start": (-20.0, -30.0), "goal": (20.0, -30.0), "robot": DISC}
BRIEF = {"time_limit_s": 6.0, "horizon_s": 30.0}


def test_recorded_people_are_where_they_were_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"replay": (ReplayPolicy(RECORDING), Replay(RECORDING))}
    monkeypatch.setattr("crowdbench.robot.crowds.policy", lambda name, scene: names[name][0])
    monkeypatch.setattr("crowdbench.robot.crowds.spawn_model", lambda name, scene: names[name][1])
    worlds = RobotWorlds(SQUARE, 6, walkers="replay", **ENDS, **BRIEF)
    worlds.begin(np.arange(6))
    assert not worlds.crowds.react
    frames = worlds.crowds.simulation.clock.frame
    assert len(set(frames.tolist())) > 1  # each world begins at another time of the recording
    for _ in range(12):
        for w, frame in enumerate(frames.tolist()):
            there = (RECORDING.first <= frame) & (frame < RECORDING.last)
            row = RECORDING.offsets[:-1][there] + frame - RECORDING.first[there]
            present = worlds.present.position[w][worlds.present.there[w]]
            want = RECORDING.xy[row]
            np.testing.assert_allclose(
                present[np.lexsort(present.T)], want[np.lexsort(want.T)], atol=1e-4
            )
        worlds.step(np.zeros((6, 2)))


def test_recorded_arrivals_walk_by_a_policy_that_sees_the_robot() -> None:
    worlds = RobotWorlds(
        SQUARE, 6, walkers="straight", spawn=Replay(RECORDING), **ENDS, **BRIEF
    )  # fmt: skip
    worlds.begin(np.arange(6))
    assert worlds.crowds.react
    assert worlds.present.there.any()
    worlds.step(np.zeros((6, 2)))


def test_recorded_paths_do_not_react_either() -> None:
    worlds = RobotWorlds(
        SQUARE, 2, walkers=RecordedPaths(RECORDING), spawn=Replay(RECORDING), **ENDS, **BRIEF
    )  # fmt: skip
    worlds.begin(np.arange(2))
    assert not worlds.crowds.react
    worlds.step(np.zeros((2, 2)))
