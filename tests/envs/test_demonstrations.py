"""Demonstrations: what the environment would have shown, and what the recording did next."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import need_imitation
from worlds import with_bodies

import crowdbench
from crowdbench import Demonstrations, demonstrations, load_scene, recording
from crowdbench.data.preprocessing import only
from crowdbench.data.recordings.catalogue import cached
from crowdbench.data.storage import write_parquet
from crowdbench.data.table import Trajectories, from_rows
from crowdbench.envs.perturbation import HOMING_S, PathPerturbation
from crowdbench.errors import SettingError
from crowdbench.registry import import_recording, recording_of
from crowdbench.simulation.observations import CONTACT, GOAL_DISTANCE
from crowdbench.simulation.social import HEADING, ROUTE_LENGTH, VELOCITY
from crowdbench.spawn.events import blocks_of

PLAZA = load_scene("plaza-v0")
FRAMES = 1500


@pytest.fixture(scope="module", autouse=True)
def imported(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A home with the first ten of the plaza's thirty minutes."""
    folder = tmp_path_factory.mktemp("imported")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROWDBENCH_HOME", str(folder))
        write_parquet(begun(recording("plaza")), cached("plaza"))
        yield folder


@pytest.fixture(autouse=True)
def home(imported: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CROWDBENCH_HOME", str(imported))
    return imported


def begun(crowd: Trajectories) -> Trajectories:
    """The first frames of a recording."""
    some = only(crowd, crowd.first < FRAMES - 1)
    rows = some.row_frame() < FRAMES
    size = np.bincount(some.row_person()[rows])
    return replace(
        some,
        frames=FRAMES,
        observed=np.array([[0, FRAMES]]),
        offsets=np.concatenate([[0], np.cumsum(size)]),
        xy=some.xy[rows],
        left=some.left & (some.last < FRAMES - 1),
    )


@pytest.fixture(scope="module")
def shown() -> Demonstrations:
    return demonstrations("plaza-v0", rays=8)


@pytest.fixture(scope="module")
def recorded() -> Trajectories:
    return recording("plaza")


def rows(shown: Demonstrations, piece: int) -> slice:
    return slice(int(shown.offsets[piece]), int(shown.offsets[piece + 1]))


@pytest.mark.long
def test_every_step_of_the_recording_is_there(shown, recorded) -> None:
    steps = np.diff(recorded.offsets) - 1
    assert shown.person.tolist() == np.flatnonzero(steps).tolist()
    assert (np.diff(shown.offsets) - 1).tolist() == steps[steps > 0].tolist()
    seen, acts = shown.pairs()
    assert len(seen) == len(acts) == steps.sum()
    assert np.isfinite(acts).all()
    assert np.isfinite(shown.observations).all()
    assert shown.complete.tolist() == recorded.left[steps > 0].tolist()


def test_actions_are_displacements_in_units_of_the_greatest_speed(shown, recorded) -> None:
    for k in range(len(shown)):
        path = recorded.path(int(shown.person[k])).astype(np.float64)
        expected = np.diff(path, axis=0) / PLAZA.dt_s / PLAZA.motion.max_speed_mps
        np.testing.assert_allclose(shown.actions[rows(shown, k)][:-1], expected, atol=1e-4)


@pytest.mark.parametrize(
    "displaced_m", [0.0, pytest.param(0.5, marks=pytest.mark.long)], ids=["recorded", "displaced"]
)
def test_actions_are_in_the_frame_of_the_observation(displaced_m: float) -> None:
    own, world = (
        demonstrations("plaza-v0", observation=name, rays=8, displaced_m=displaced_m)
        for name in ("social-1", "lidar-2")
    )
    assert own.offsets.tolist() == world.offsets.tolist()
    (seen, acts), (before, did) = own.pairs(), world.pairs()
    cos, sin = seen[:, HEADING].T.astype(np.float64)
    np.testing.assert_allclose(np.hypot(cos, sin), 1, atol=1e-6)
    turned = np.stack([acts[:, 0] * cos - acts[:, 1] * sin, acts[:, 0] * sin + acts[:, 1] * cos])
    did = did / np.maximum(1, np.hypot(*did.T))[:, None]  # as a step clips them
    np.testing.assert_allclose(turned.T, did, atol=2e-5)
    speed = np.hypot(*before[:, :2].T) * PLAZA.motion.max_speed_mps
    walks = speed > 0.301  # those who walk head there, wherever they have been displaced to
    assert walks.mean() > 0.5
    ahead = seen[walks][:, VELOCITY] * PLAZA.motion.max_speed_mps
    np.testing.assert_allclose(ahead, np.stack([speed[walks], 0 * speed[walks]], 1), atol=2e-4)
    assert (seen[:, ROUTE_LENGTH] == before[:, GOAL_DISTANCE]).mean() > 0.9


@pytest.mark.parametrize(
    "displaced_m", [0.0, pytest.param(0.5, marks=pytest.mark.long)], ids=["recorded", "displaced"]
)
def test_nothing_keeps_recorded_people_from_walking(displaced_m: float) -> None:
    scene = with_bodies(PLAZA)
    seen, plain = (
        demonstrations(place, observation=name, displaced_m=displaced_m)
        for place, name in ((scene, "social-1-contact"), (PLAZA, "social-1"))
    )
    np.testing.assert_allclose(seen.observations[:, :-2], plain.observations, atol=1e-5)
    np.testing.assert_allclose(seen.actions, plain.actions, atol=1e-5)
    lost_mps = np.abs(seen.observations[:, CONTACT]) * scene.motion.max_speed_mps
    assert lost_mps.max() < 1e-3


@pytest.mark.long
@pytest.mark.parametrize("version", ["lidar-1", "lidar-2", "lidar-3", "social-1"])
def test_observations_are_those_of_the_environment(version: str, recorded) -> None:
    shown = demonstrations("plaza-v0", observation=version, rays=8)
    of = {int(p): k for k, p in enumerate(shown.person)}
    env = crowdbench.parallel_env(
        "plaza-v0", spawn="replay", start="recorded", observation=version, rays=8
    )
    observations, infos = env.reset(seed=0)
    compared = 0
    while env.agents:
        frame = next(iter(infos.values()))["frame"]
        # Persons are numbered as they enter, which is the order of the recording.
        there = {name: int(name.removeprefix("person_")) for name in env.agents}
        now = (recorded.first <= frame) & (frame <= recorded.last)
        if set(there.values()) != set(np.flatnonzero(now).tolist()):
            break  # someone came by the goal before the record ends, and is gone here
        actions = {}
        for name, person in there.items():
            at = shown.offsets[of[person]] + frame - shown.first[of[person]]
            assert observations[name].tolist() == shown.observations[at].tolist()
            actions[name] = np.nan_to_num(shown.actions[at])
            compared += 1
        observations, *_, infos = env.step(actions)
    assert compared > 100


@pytest.mark.long
def test_the_displaced_come_back_as_smoothly_as_people_walk(shown, recorded) -> None:
    other = demonstrations("plaza-v0", rays=8, displaced_m=0.5, recovery_s=2.0, seed=3)
    assert other.person.tolist() == shown.person.tolist()
    assert other.offsets.tolist() == shown.offsets.tolist()
    seen, acts = other.pairs()
    before, did = shown.pairs()
    assert (seen[:, 5] == before[:, 5]).all()  # preferred speeds stay
    there = np.repeat(shown.person, np.diff(shown.offsets) - 1)
    displaced = np.unique(there[(seen[:, 2:5] != before[:, 2:5]).any(axis=1)])
    assert 0.4 < len(displaced) / len(shown) < 0.6
    moved = np.isin(there, displaced)
    assert (acts[~moved] == did[~moved]).all()
    # Goals look elsewhere by about what people were displaced by.
    of_goal = (seen[moved, 2:3] * seen[moved, 3:5] - before[moved, 2:3] * before[moved, 3:5]) * 30
    assert 0.1 < of_goal.std() < 1.0
    # An action leads on along the curve: what comes next has its velocity, but for a new curve
    # every 8 s, for walls, and for the last 2 s, in which everyone goes straight to the goal.
    steps = np.diff(shown.offsets) - 1
    left_s = (np.repeat(np.cumsum(steps), steps) - np.arange(steps.sum())) * PLAZA.dt_s
    follows = (there[1:] == there[:-1]) & moved[1:] & (left_s[:-1] > HOMING_S + PLAZA.dt_s / 2)
    off = np.abs(seen[1:, :2] - acts[:-1]).max(axis=1)[follows]
    assert (off > 1e-3).mean() < 1.5 * PLAZA.dt_s / 8.0
    # What was added to the changes of velocity is little.
    change = np.abs(acts - seen[:, :2])[moved] - np.abs(did - before[:, :2])[moved]
    assert abs(change.mean()) * PLAZA.motion.max_speed_mps / PLAZA.dt_s < 0.15  # m/s²
    # The last action leads to where the trip ended, within the goal's disc, from wherever one is.
    last = moved & (left_s < 1.5 * PLAZA.dt_s)
    step_m = acts[last] * PLAZA.dt_s * PLAZA.motion.max_speed_mps
    ends = recorded.xy[recorded.offsets[1:] - 1][there[last]]
    assert (
        np.hypot(*(ends - recorded.goal[there[last]]).T) < PLAZA.motion.goal_radius_m
    ).mean() > 0.9
    way = seen[last, 2:3] * 30 * seen[last, 3:5] + ends - recorded.goal[there[last]]
    assert np.median(np.abs(step_m - way)) < 0.01
    again = demonstrations("plaza-v0", rays=8, displaced_m=0.5, recovery_s=2.0, seed=3)
    assert again.observations.tobytes() == other.observations.tobytes()


@pytest.mark.long
def test_whoever_was_displaced_ends_where_the_record_does(shown, recorded) -> None:
    other = demonstrations("plaza-v0", rays=8, displaced_m=0.5, recovery_s=1.0, seed=1)
    ends = other.offsets[1:][other.complete] - 1
    to_goal = [lot.observations[ends, 2] * 30 for lot in (other, shown)]  # metres
    np.testing.assert_allclose(*to_goal, atol=0.02)


@pytest.mark.parametrize("displaced_m", [-1.0, float("nan"), float("inf")])
def test_impossible_displacements_are_refused(displaced_m: float) -> None:
    with pytest.raises(SettingError, match="displaced_m"):
        demonstrations("plaza-v0", displaced_m=displaced_m)


def test_nobody_comes_back_at_once() -> None:
    with pytest.raises(SettingError, match="recovery_s"):
        demonstrations("plaza-v0", displaced_m=0.5, recovery_s=0.0)


@pytest.mark.long
def test_a_fold_shows_nothing_of_its_scored_blocks(recorded) -> None:
    blocks = blocks_of(recorded, PLAZA)
    splits = [demonstrations("plaza-v0", split=f"fold{k}", rays=1) for k in range(3)]
    whole = demonstrations("plaza-v0", rays=1)
    for k, split in enumerate(splits):
        inside = np.zeros(recorded.frames, dtype=bool)
        for start, stop in blocks.training(f"fold{k}").frames.tolist():
            inside[start:stop] = True
        length = np.diff(split.offsets)
        frames = np.arange(length.sum()) + np.repeat(split.first - split.offsets[:-1], length)
        assert inside[frames].all()
        persons = np.repeat(split.person, length)
        # What it shows is what the whole shows.
        at = {int(p): i for i, p in enumerate(whole.person)}
        piece = np.array([at[int(p)] for p in persons])
        row = whole.offsets[piece] + frames - whole.first[piece]
        assert (split.observations == whole.observations[row]).all()
    # Each frame trains two of three folds; pairs are lost only where a life is cut.
    pairs = sum(len(split.pairs()[0]) for split in splits)
    assert 1.9 < pairs / len(whole.pairs()[0]) <= 2.0
    assert not all(split.complete.all() for split in splits)


def test_nobody_is_in_both_lots(shown) -> None:
    train, test = shown.split(0.2, seed=1)
    assert len(train) + len(test) == len(shown)
    assert not set(train.person.tolist()) & set(test.person.tolist())
    assert 0.1 < len(test) / len(shown) < 0.3
    again, _ = shown.split(0.2, seed=1)
    assert again.person.tolist() == train.person.tolist()
    for k in range(len(test)):
        whole = rows(shown, int(np.flatnonzero(shown.person == test.person[k])[0]))
        assert (test.observations[rows(test, k)] == shown.observations[whole]).all()


def test_imitation_takes_them(shown) -> None:
    need_imitation()
    from imitation.data import rollout

    trips = shown.to_imitation()
    assert len(trips) == len(shown)
    flat = rollout.flatten_trajectories(trips)
    seen, acts = shown.pairs()
    assert (flat.obs == seen).all()
    assert (flat.acts == acts).all()
    assert flat.dones.sum() == shown.complete.sum()


def test_every_step_of_eth_is_there(opentraj) -> None:
    import_recording("eth", opentraj)
    shown, recorded = demonstrations("eth-v0"), recording_of("eth-v0")
    assert len(shown) == 360
    assert len(shown.pairs()[0]) == len(recorded.xy) - 360
    assert shown.complete.sum() == recorded.left.sum()


@pytest.mark.parametrize("split", ["fold3", "", "half"])
def test_an_unknown_part_is_refused(split: str) -> None:
    with pytest.raises(SettingError, match="fold0"):
        demonstrations("plaza-v0", split=split)


def test_who_stands_is_not_displaced() -> None:
    walks = np.stack([np.arange(40) * 0.4, np.zeros(40)], axis=1)
    stands = np.zeros((40, 2))
    crowd = from_rows(
        scene="drawn", dt_s=0.4, where="test", person_id=np.repeat(np.arange(12), 40),
        frame=np.tile(np.arange(40), 12), xy=np.concatenate([walks] * 6 + [stands] * 6),
    )  # fmt: skip
    aside = PathPerturbation.of(crowd, 0.5, 1.0, seed=0)
    assert np.abs(aside.now[: 6 * 40]).max() > 0.3
    for shown in (aside.now, aside.after, aside.drift):
        assert not shown[6 * 40 :].any()
