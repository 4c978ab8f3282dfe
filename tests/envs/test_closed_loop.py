"""Demonstrations in which a policy moves the recorded people."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_crowds import DT, SQUARE, recorded, recording_is, straight, wandering

from crowdbench import Demonstrations, demonstrations
from crowdbench.data.table import Trajectories
from crowdbench.envs.closed_loop import FAR_M
from crowdbench.errors import ActionError, SettingError
from crowdbench.policies import Memory, PolicyCard, StateView
from crowdbench.policies.export import export_policy
from crowdbench.scene import Scene
from crowdbench.simulation.social import (
    AGE,
    AGE_S,
    PREFERRED_SPEED,
    ROUTE_DIRECTION,
    VELOCITY,
)

MAX_MPS = SQUARE.motion.max_speed_mps


class Noisy:
    """Walks to the goal at the preferred speed, with noise."""

    name, sees, observation = "noisy", "observation", "social-1"

    def __init__(self, noise: float = 0.1, interval: int = 1) -> None:
        self.scale, self.interval = noise, interval

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        self.rng = rng

    def act(self, seen: np.ndarray) -> np.ndarray:
        noise = self.rng.normal(0, self.scale, (len(seen), 2))
        return seen[:, PREFERRED_SPEED] * seen[:, ROUTE_DIRECTION] + noise


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    """People who cross each other's ways, two of them side by side."""
    lines = [straight((-15.0, y), (1.3, 0.05 * y), 60) for y in (-4.0, 0.0, 0.8, 4.0)]
    lines += [straight((x, -15.0), (0.0, 1.1), 60) for x in (-5.0, 5.0)]
    return recorded(*((2 * k, path) for k, path in enumerate(lines)))


@pytest.fixture
def scene(crowd: Trajectories) -> Iterator[Scene]:
    with recording_is(crowd) as place:
        yield place


def closed(scene: Scene, policy: object, **options: object) -> Demonstrations:
    return demonstrations(scene, observation="social-1", policy=policy, **options)


@pytest.mark.parametrize("observation", ["lidar-2", "social-1"])
def test_the_replayed_recording_is_shown_as_without_a_policy(
    scene: Scene, crowd: Trajectories, observation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("crowdbench.registry.policies.recording_of", lambda scene: crowd)
    shown = demonstrations(scene, observation=observation)
    again = demonstrations(scene, observation=observation, policy="replay")
    for name in ("observations", "actions", "person", "offsets", "first", "entered", "complete"):
        np.testing.assert_array_equal(getattr(again, name), getattr(shown, name))
    assert again.provenance["policy"] == "replay"


class Repeating:
    """Walks as was shown, which it knows by person and by the decisions that it remembers.

    Only one candidate of each person does so; the others walk the other way.
    """

    name, sees, memory = "repeating", "observation", 1

    def __init__(self, shown: Demonstrations, candidates: int) -> None:
        self.shown, self.candidates = shown, candidates
        self.observation, self.interval = (
            shown.provenance[name] for name in ("observation", "interval")
        )

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        self.rng = rng

    def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
        persons = len(seen) // self.candidates
        row = self.shown.offsets[memory.person] + memory.state[:, 0].astype(np.int64)
        memory.state += 1
        right = self.rng.integers(self.candidates, size=persons)
        good = (np.arange(self.candidates)[:, None] == right).ravel()
        memory.state[~good] += 1000  # would be noticed if it were kept
        action = self.shown.actions[row]
        return np.where(good[:, None], action, np.where(action > 0, -1.0, 1.0))


@pytest.mark.parametrize(("observation", "interval"), [("lidar-2", 1), ("social-1", 3)])
def test_the_state_is_that_of_the_candidate_that_is_walked(
    scene: Scene, observation: str, interval: int
) -> None:
    shown = demonstrations(scene, observation=observation, interval=interval)
    policy = Repeating(shown, candidates=4)
    again = demonstrations(scene, observation=observation, policy=policy, candidates=4)
    assert again.provenance["interval"] == interval
    assert again.offsets.tolist() == shown.offsets.tolist()
    assert again.deviation_m.max() < 1e-3
    for got, expected in zip(again.pairs(), shown.pairs(), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-3)


class Remembering(Noisy):
    """Counts decisions and remembers its last action; checks what it is told."""

    memory, style = 3, 2

    def __init__(self, noise: float, interval: int, candidates: int) -> None:
        super().__init__(noise, interval)
        self.candidates, self.styles = candidates, {}
        self.decisions = 0

    def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
        shape = (self.candidates, -1)
        for each in (memory.state, memory.style, memory.person, memory.entered, seen):
            rows = each.reshape(*shape, *each.shape[1:])
            assert (rows == rows[0]).all()  # the same for all candidates of a person
        count = memory.state[:, 0].copy()
        age = seen[:, AGE].ravel() * AGE_S / DT
        np.testing.assert_allclose(age, count * self.interval, atol=1e-3)
        assert (memory.entered == (count == 0)).all()
        for person, style in zip(memory.person.tolist(), memory.style, strict=True):
            np.testing.assert_array_equal(self.styles.setdefault(person, style.copy()), style)
        walked = np.hypot(*memory.state[:, 1:].T)
        speed = np.hypot(*seen[:, VELOCITY].T)
        np.testing.assert_allclose(speed[count > 0], walked[count > 0], atol=1e-4)
        actions = super().act(seen) + 0.003 * memory.style
        memory.state[:, 0] += 1
        memory.state[:, 1:] = actions
        self.decisions += len(seen) // self.candidates
        return actions


@pytest.mark.parametrize(("candidates", "interval"), [(1, 1), (3, 1), (3, 4)])
def test_states_advance_once_for_each_decision(
    scene: Scene, crowd: Trajectories, candidates: int, interval: int
) -> None:
    policy = Remembering(0.03, interval, candidates)
    shown = closed(scene, policy, candidates=candidates)
    assert shown.deviation_m.max() < FAR_M  # so that nobody walked anything but a candidate
    assert policy.decisions == len(shown.pairs()[0])
    assert len(policy.styles) == len(crowd)


class Drawing:
    """Sees the state: draws any action, and writes down where everyone is."""

    name, sees = "drawing", "state"

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        self.rng, self.at = rng, {}

    def act(self, seen: StateView) -> np.ndarray:
        for person, frame, xy in zip(
            seen.event.tolist(), seen.frame.tolist(), seen.position, strict=True
        ):
            self.at[person, frame] = xy.astype(np.float64)
        return self.rng.uniform(-0.5, 0.5, (len(seen.event), 2))


@given(seed=st.integers(0, 1000), candidates=st.integers(1, 6))
@settings(max_examples=20, deadline=None)
def test_each_label_leads_back_to_the_recorded_position(seed: int, candidates: int) -> None:
    rng = np.random.default_rng(seed)
    crowd = recorded(
        *((int(rng.integers(0, 40)), wandering(rng, int(rng.integers(2, 40)))) for _ in range(5))
    )
    policy = Drawing()
    with recording_is(crowd) as scene:
        shown = demonstrations(scene, rays=4, policy=policy, candidates=candidates, seed=seed)
    assert shown.person.tolist() == list(range(len(crowd)))  # all enter and leave as recorded
    assert shown.first.tolist() == crowd.first.tolist()
    assert (np.diff(shown.offsets) == np.diff(crowd.offsets)).all()
    reached = 0
    for k in range(len(crowd)):
        path = crowd.path(k).astype(np.float64)
        for age in range(len(path) - 1):
            row = shown.offsets[k] + age
            at = policy.at[k, int(crowd.first[k]) + age]
            assert shown.deviation_m[row] == pytest.approx(np.hypot(*(path[age] - at)), abs=1e-4)
            way = path[age + 1] - at
            walked = shown.actions[row] * MAX_MPS * DT
            if np.hypot(*way) <= MAX_MPS * DT:
                np.testing.assert_allclose(walked, way, atol=1e-4)
                reached += 1
            else:  # too far for one step
                assert (np.abs(shown.actions[row]) <= 1).all()
                assert walked @ way > 0
    assert reached > 0


def test_more_candidates_stay_nearer_to_the_recording(scene: Scene) -> None:
    far = [
        np.mean([closed(scene, Noisy(), candidates=n, seed=s).deviation_m.mean() for s in range(3)])
        for n in (1, 3, 12)
    ]
    assert far[0] > 1.5 * far[1] > 2 * far[2]
    one, again, other = (closed(scene, Noisy(), seed=seed) for seed in (0, 0, 1))
    assert one.observations.tobytes() == again.observations.tobytes()
    assert one.actions.tobytes() == again.actions.tobytes()
    assert one.observations.tobytes() != other.observations.tobytes()


def test_a_file_with_noise_and_a_memory_walks_near_the_recording(
    scene: Scene, tmp_path: Path
) -> None:
    torch = pytest.importorskip("torch")

    class Network(torch.nn.Module):
        """Keeps its velocity, turns to the goal, and adds a noise that its state smooths."""

        def forward(self, seen, noise, state):
            state = 0.5 * state + 0.02 * noise
            way = seen[:, PREFERRED_SPEED] * seen[:, ROUTE_DIRECTION]
            return 0.5 * seen[:, VELOCITY] + 0.5 * way + state, state

    card = PolicyCard(
        name="network", observation="social-1", scene="plaza-v0", split="full", memory=2, interval=2
    )
    file = str(export_policy(Network(), tmp_path / "network.onnx", card, noise=2))
    free, held = (closed(scene, file, candidates=n) for n in (1, 5))
    assert free.provenance["policy"] == "network"
    assert free.provenance["interval"] == 2
    assert 0.02 < held.deviation_m.mean() < 0.7 * free.deviation_m.mean()


def test_actions_of_people_who_are_far_away_can_be_left_out(scene: Scene) -> None:
    shown = closed(scene, Noisy())
    limit = float(np.median(shown.deviation_m))
    seen, acts = shown.pairs(within_m=limit)
    assert 0.3 * len(shown.observations) < len(seen) < 0.6 * len(shown.observations)
    observations, actions, near = shown.padded(within_m=limit)
    np.testing.assert_array_equal(observations[near], seen)
    np.testing.assert_array_equal(actions[near], acts)
    whole = shown.padded()  # states of networks need all observations
    np.testing.assert_array_equal(observations, whole[0])
    assert (near <= whole[2]).all()
    off = np.concatenate([shown.deviation_m[shown.offsets[k] :][: whole[2][k].sum()]
                          for k in range(len(shown))])  # fmt: skip
    assert near[whole[2]].tolist() == (off < limit).tolist()


def test_people_who_would_be_left_behind_walk_back(scene: Scene) -> None:
    class Standing(Noisy):
        def act(self, seen: np.ndarray) -> np.ndarray:
            return np.zeros((len(seen), 2))

    far = closed(scene, Standing()).deviation_m
    assert FAR_M - 0.6 < far.max() < FAR_M + 0.6  # by a step at the recorded speed, at most


def test_a_policy_without_draws_is_asked_once(scene: Scene) -> None:
    class Asked(Noisy):
        rows = 0
        deterministic = True

        def act(self, seen: np.ndarray) -> np.ndarray:
            self.rows += len(seen)
            return super().act(seen)

    policy = Asked(noise=0.0)
    shown = closed(scene, policy, candidates=3)
    assert policy.rows == len(shown.pairs()[0])


def test_what_does_not_fit_is_refused(scene: Scene) -> None:
    with pytest.raises(
        SettingError, match=r"observation = 'social-1'[\s\S]*observation='social-1'"
    ):
        demonstrations(scene, policy=Noisy())
    with pytest.raises(SettingError, match="decisions every 2 frames"):
        closed(scene, Noisy(interval=2), interval=3)
    with pytest.raises(SettingError, match="interval=1"):
        closed(scene, "straight", interval=2)
    with pytest.raises(SettingError, match="displaced_m and a policy"):
        closed(scene, Noisy(), displaced_m=0.5)
    with pytest.raises(SettingError, match="candidates"):
        closed(scene, Noisy(), candidates=0)
    with pytest.raises(SettingError, match="rays = 32"):
        demonstrations(scene, rays=8, policy=Lidar())


class Lidar(Noisy):
    observation = "lidar-2"


def test_actions_that_are_no_numbers_are_refused(scene: Scene) -> None:
    class Diverged(Noisy):
        def act(self, seen: np.ndarray) -> np.ndarray:
            return np.full((len(seen), 2), np.nan)

    class Forgetful(Remembering):
        def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
            memory.state = memory.state[:1]
            return np.zeros((len(seen), 2))

    with pytest.raises(ActionError, match="not finite"):
        closed(scene, Diverged())
    with pytest.raises(ActionError, match="next states of shape"):
        closed(scene, Forgetful(0.1, 1, 3))


@pytest.mark.parametrize("recovery_s", [1.0, 4.0])
def test_with_a_recovery_time_deviations_decay_until_the_end_is_near(
    scene: Scene, crowd: Trajectories, recovery_s: float
) -> None:
    at_once, slowly = (
        closed(scene, Noisy(), candidates=1, recovery_s=time) for time in (0.0, recovery_s)
    )
    np.testing.assert_array_equal(at_once.observations, slowly.observations)
    length = np.diff(at_once.offsets)
    step = np.arange(length.sum()) - np.repeat(at_once.offsets[:-1], length)
    to_end = np.repeat(crowd.last[at_once.person] - at_once.first, length) - step
    far = np.flatnonzero((to_end * DT > 2.0) & (at_once.deviation_m < 1.0))
    near = np.flatnonzero((to_end * DT <= 2.0) & (to_end > 0))
    less_m = np.linalg.norm(at_once.actions - slowly.actions, axis=1) * MAX_MPS * DT
    expected = at_once.deviation_m * (1 - DT / recovery_s)
    assert expected[far].max() > 0.1
    np.testing.assert_allclose(less_m[far], expected[far], atol=1e-4)
    assert not less_m[near].any()


def test_smoothed_paths_lose_noise_but_not_people(crowd: Trajectories) -> None:
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
def test_bad_times_are_errors(scene: Scene, wrong: dict[str, float]) -> None:
    with pytest.raises(SettingError, match=next(iter(wrong))):
        closed(scene, Noisy(), **wrong)
