"""Policies and spawn models of a user's own that misbehave are told so, and score nothing."""

import pickle
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from crowdbench.crowds import score
from crowdbench.data.storage import read
from crowdbench.envs.parallel_env import parallel_env
from crowdbench.errors import ActionError, RecordingError, SettingError, WeightsError
from crowdbench.evaluation import evaluate
from crowdbench.registry import policy, spawn_model
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn.events import SpawnEvents, entering

PLAZA = load_scene("plaza-v0")


class Gives:
    """A policy whose `act` gives what it was made with."""

    name = "gives"
    sees = "observation"

    def __init__(self, what: Any) -> None:
        self.what = what

    def reset(self, scene: Any, rng: Any) -> None:
        pass

    def act(self, seen: np.ndarray) -> Any:
        return self.what(len(seen))


class Sends:
    """A spawn model whose `sample` gives what it was made with."""

    name = "sends"
    start = "empty"

    def __init__(self, what: Any) -> None:
        self.what = what

    def sample(self, horizon_s: float, scene: Any, rng: Any) -> Any:
        return self.what


def three() -> SpawnEvents:
    area = np.zeros(3, np.int32)
    place = np.full((3, 2), 10.0)
    return entering(
        time_s=np.arange(3.0),
        start=place,
        goal=place + 5,
        spawn_area=area,
        goal_area=area,
        speed=np.ones(3),
    )


BAD_ACTIONS = {
    "nan": (lambda n: np.full((n, 2), np.nan), "not finite"),
    "nothing": (lambda n: None, "one action for each"),
    "one for all": (lambda n: np.zeros((1, 2)), "one action for each"),
    "three numbers": (lambda n: np.zeros((n, 3)), "one action for each"),
    "text": (lambda n: np.full((n, 2), "left"), "one action for each"),
}


@pytest.mark.parametrize(("what", "message"), BAD_ACTIONS.values(), ids=BAD_ACTIONS)
def test_a_policy_that_acts_nonsense_is_refused(what: Any, message: str) -> None:
    spawn = spawn_model("poisson-gmm", PLAZA)
    with pytest.raises(ActionError, match=f"policy gives.*{message}"):
        rollout(PLAZA, spawn, Gives(what), seed=0, horizon_s=20.0)


def with_speeds(count: int) -> SpawnEvents:
    events = three()
    # Past the checks of the tests themselves, which a user's program does not have.
    object.__setattr__(events, "speed", np.ones(count, np.float32))
    return events


BAD_EVENTS = {
    "a list": (lambda: [1, 2], "got list; expected SpawnEvents"),
    "disorder": (
        lambda: replace(three(), time_s=np.array([2.0, 1.0, 3.0])),
        "time_s in ascending order",
    ),
    "nan time": (lambda: replace(three(), time_s=np.full(3, np.nan)), "time_s that are not"),
    "nan start": (
        lambda: replace(three(), start=np.full((3, 2), np.nan, np.float32)),
        "start that are not finite",
    ),
    "too few": (lambda: with_speeds(2), r"speed of shape \(2,\)"),
    "far away": (
        lambda: replace(three(), start=np.full((3, 2), 1e9, np.float32)),
        "outside the bounds of plaza-v0",
    ),
}


@pytest.mark.parametrize(("what", "message"), BAD_EVENTS.values(), ids=BAD_EVENTS)
def test_a_spawn_model_that_sends_nonsense_is_refused(what: Any, message: str) -> None:
    walker = Gives(lambda n: np.zeros((n, 2)))
    with pytest.raises(SettingError, match=f"spawn model sends.*{message}"):
        rollout(PLAZA, Sends(what()), walker, seed=0, horizon_s=20.0)


def test_a_person_due_after_the_end_of_time_never_enters() -> None:
    late = replace(three(), time_s=np.array([1.0, 2.0, 1e300]))
    walker = Gives(lambda n: np.zeros((n, 2)))
    assert len(rollout(PLAZA, Sends(late), walker, seed=0, horizon_s=20.0)) == 2


@pytest.mark.parametrize(
    ("named", "message"),
    [("Gives", "called with the scene"), ("Blind", "'observation' or 'state'")],
)
def test_a_class_that_is_no_policy_is_refused(
    named: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    blind = type("Blind", (Gives,), {"sees": "pixels", "__init__": lambda self: None})
    module = ModuleType("theirs")
    vars(module).update(Gives=Gives, Blind=blind)
    monkeypatch.setitem(sys.modules, "theirs", module)
    with pytest.raises(SettingError, match=message):
        policy(f"theirs:{named}", PLAZA)


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ("\ndt_s = 0.4", "\ndt_s = 0.2", "computed with dt_s = 0.4; expected dt_s = 0.2"),
        ("grid_s = 0.4", "grid_s = 0.3", "computed with grid_s = 0.4; expected grid_s = 0.3"),
        ("block_s = 60.0", "block_s = 30.0", "computed with block_s = 60.0"),
        ("frames = 4500", "frames = 4000", "up to frame 4500.* the 4000 frames of the recording"),
    ],
)
def test_statistics_of_another_time_grid_are_refused(
    tmp_path: Path, was: str, becomes: str, said: str
) -> None:
    text = (PLAZA.folder / "scene.toml").read_text()
    assert was in text
    (tmp_path / "scene.toml").write_text(text.replace(was, becomes))
    for name in ("areas.json", "reference.json.gz"):
        (tmp_path / name).write_bytes((PLAZA.folder / name).read_bytes())
    with pytest.raises(WeightsError, match=said):
        read_reference(load_scene(tmp_path))


def table(folder: Path, text: str) -> Path:
    path = folder / "theirs.CSV"
    path.write_text(text)
    return path


def test_frame_and_time_must_agree(tmp_path: Path) -> None:
    path = table(tmp_path, "person_id, frame, time_s, x, y\n1,0,0.0,1,1\n1,1,0.1,1,1\n")
    with pytest.raises(RecordingError, match=r"multiples of 0.4 s, equal to frame × 0.4 s"):
        read(path, scene="plaza-v0", dt_s=0.4)


def test_milliseconds_are_no_frames(tmp_path: Path) -> None:
    path = table(tmp_path, "person_id,frame,x,y\n1,0,1,1\n1,1763700000000,1,1\n")
    with pytest.raises(RecordingError, match="not milliseconds"):
        read(path, scene="plaza-v0", dt_s=0.4)


def test_positions_that_float32_cannot_hold_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="not finite"):
        read(table(tmp_path, "person_id,frame,x,y\n1,0,1e39,1\n"), scene="plaza-v0", dt_s=0.4)


def test_an_outcome_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    path = table(tmp_path, "person_id,frame,x,y,outcome\n1,0,1,1,99\n")
    with pytest.raises(RecordingError, match="outcomes"):
        read(path, scene="plaza-v0", dt_s=0.4)


@pytest.mark.parametrize("frames", [4000, 5000])
def test_a_crowd_of_another_length_is_not_scored(tmp_path: Path, frames: int) -> None:
    rows = [f"1,{frame},10,10" for frame in (0, frames)]
    path = table(tmp_path, "\n".join(["person_id,frame,x,y", *rows]))
    with pytest.raises(RecordingError, match="as long as the recording"):
        score("plaza-v0", read(path, scene="plaza-v0", dt_s=0.4))


def test_a_crowd_of_another_scene_is_not_scored(tmp_path: Path) -> None:
    path = table(tmp_path, "person_id,frame,x,y\n1,0,10,10\n1,1933,10,10\n")
    with pytest.raises(RecordingError, match="a crowd of plaza-v0"):
        score("eth-v0", read(path, scene="plaza-v0", dt_s=0.4))


def test_an_environment_travels_between_processes() -> None:
    env = parallel_env(PLAZA, horizon_s=20.0)
    there, _ = env.reset(seed=0)
    here, _ = pickle.loads(pickle.dumps(env)).reset(seed=0)
    assert there.keys() == here.keys()
    assert all((there[name] == here[name]).all() for name in there)


def test_an_earlier_runs_scorecard_does_not_stand_beside_new_rollouts(tmp_path: Path) -> None:
    (tmp_path / "scorecard.json").write_text("an earlier run's")
    with pytest.raises(KeyboardInterrupt):
        evaluate(
            "plaza-v0", policy=["straight"], seeds=1, workers=1, out=tmp_path, progress=interrupt
        )
    assert not (tmp_path / "scorecard.json").exists()


def interrupt(done: int, total: int) -> None:
    raise KeyboardInterrupt
