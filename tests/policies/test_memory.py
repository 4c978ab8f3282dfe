"""What policies remember: by person, from its entry on, in classes and in files."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from crowdbench import rollout, spawn_model
from crowdbench.errors import ActionError, SettingError, WeightsError
from crowdbench.policies import Memory, OnnxPolicy, PolicyCard
from crowdbench.policies.export import export_policy
from crowdbench.policies.rows import GRID, kept
from crowdbench.registry import policy_source
from crowdbench.run.acting import Actor
from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation

PLAZA = load_scene("plaza-v0")
UNITS = 5
CARD = PolicyCard(
    name="gru", observation="lidar-2", rays=8, scene="plaza-v0", split="full", memory=UNITS
)


class Counting:
    """Walks to the goal and counts, for each person, how often it has been asked."""

    name = "counting"
    sees = "observation"
    memory = 1
    style = 2

    def __init__(self, interval: int = 1) -> None:
        self.interval = interval
        self.seen: list[Memory] = []

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        self.resets = getattr(self, "resets", 0) + 1

    def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
        memory.state[:] += 1
        self.seen.append(
            Memory(memory.state.copy(), memory.style, memory.world, memory.person, memory.entered)
        )
        return seen[:, 5:6] * seen[:, 3:5]


def walked(policy: Counting, seed: int = 0, **of: object):
    spawn = spawn_model("poisson-gmm", PLAZA)
    return rollout(PLAZA, spawn, policy, seed=seed, horizon_s=60.0, **of)


def test_a_state_begins_with_zeros_and_is_kept_by_person() -> None:
    policy = Counting()
    crowd = walked(policy, start="empty")
    times: dict[int, int] = {}
    for memory in policy.seen:
        for person, state, entered in zip(
            memory.person.tolist(), memory.state[:, 0].tolist(), memory.entered, strict=True
        ):
            assert entered == (person not in times)
            times[person] = times.get(person, 0) + 1
            assert state == times[person]
    assert len(times) == len(crowd) > 20  # more persons than were there at the same time
    rows = np.diff(crowd.offsets)
    for person, count in times.items():
        # The last position of a trip that has ended needs no decision.
        assert count == rows[person] - bool(crowd.left[person])


def test_people_of_the_warm_up_are_remembered() -> None:
    policy = Counting()
    walked(policy)
    assert policy.resets == 2  # for the warm-up and for the episode
    before = max(float(m.state.max()) for m in policy.seen[:-150])
    first = policy.seen[-150]  # of the 150 frames of the episode
    assert first.state.max() > 5
    assert not first.entered.all()
    assert before > 5


def test_a_style_is_drawn_once_for_each_person() -> None:
    policy = Counting()
    walked(policy, start="empty")
    styles: dict[int, np.ndarray] = {}
    for memory in policy.seen:
        for person, style in zip(memory.person.tolist(), memory.style, strict=True):
            np.testing.assert_array_equal(styles.setdefault(person, style), style)
    drawn = np.array(list(styles.values()))
    assert len(np.unique(drawn[:, 0])) == len(drawn)
    assert np.abs(drawn.mean()) < 0.5
    again = Counting()
    walked(again, start="empty")
    np.testing.assert_array_equal(again.seen[-1].style, policy.seen[-1].style)


def test_between_decisions_people_keep_their_velocities() -> None:
    every, rarely = Counting(), Counting(interval=3)
    walked(every, start="empty")
    crowd = walked(rarely, start="empty")
    asked = sum(len(m.person) for m in rarely.seen)
    assert asked < 0.4 * sum(len(m.person) for m in every.seen)
    for person in range(20):
        steps = np.diff(crowd.path(person).astype(np.float64), axis=0)
        for k in range(0, len(steps) - 4, 3):
            np.testing.assert_allclose(steps[k + 1 : k + 3], steps[[k, k]], atol=2e-5)


def test_velocities_are_kept_in_the_world_while_headings_turn() -> None:
    class Turning(Counting):
        """Walks ahead and to the left, so that the own frame turns with each step."""

        observation = "social-1"

        def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
            super().act(seen, memory)
            return np.full((len(seen), 2), 0.2, np.float32)

    crowd = walked(Turning(interval=4), start="empty")
    turned = 0.0
    for person in range(20):
        steps = np.diff(crowd.path(person).astype(np.float64), axis=0)
        length = np.linalg.norm(steps, axis=1)
        for k in range(0, len(steps) - 5, 4):
            if np.ptp(length[k : k + 4]) > 1e-4:  # it met a wall
                continue
            np.testing.assert_allclose(steps[k + 1 : k + 4], steps[[k, k, k]], atol=5e-5)
            turned += abs(steps[k, 0] * steps[k + 4, 1] - steps[k, 1] * steps[k + 4, 0])
    assert turned > 1.0


def test_other_people_are_walked_without_those_of_a_learner() -> None:
    policy, scene = Counting(), PLAZA
    simulation = Simulation(scene, settings=Settings(max_alive=64))
    events = spawn_model("poisson-gmm", scene).sample(60.0, scene, np.random.default_rng(0))
    simulation.reset([events], horizon=200)
    actor = Actor(policy, simulation)
    actor.reset(np.random.default_rng(0))
    for _ in range(100):
        who = np.zeros_like(simulation.slots.alive)
        who[0, ::2] = True
        actions = actor.actions(who)
        assert not actions[0, 1::2].any()
        simulation.step(actions)
    assert max(len(m.person) for m in policy.seen) <= 32


@pytest.mark.parametrize(
    ("name", "value"), [("memory", -1), ("style", 2.5), ("interval", 0), ("memory", 5000)]
)
def test_needs_out_of_range_are_refused(name: str, value: object) -> None:
    policy = Counting()
    setattr(policy, name, value)
    with pytest.raises(SettingError, match=rf"counting[\s\S]*{name} = {value}"):
        walked(policy)


def test_states_that_are_not_finite_are_refused() -> None:
    class Broken(Counting):
        def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
            memory.state[:] = np.nan
            return super().act(seen, memory)

    with pytest.raises(ActionError, match="next states that are not finite"):
        walked(Broken())

    class Lost(Counting):
        def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
            action = super().act(seen, memory)
            memory.state = np.zeros((len(seen), 3), np.float32)
            return action

    with pytest.raises(ActionError, match=r"next states of shape[\s\S]*memory\.state\[:\]"):
        walked(Lost())


class Gru(nn.Module):
    """A recurrent network, with noise or a style if it is given some."""

    def __init__(self, leaking: bool = False) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.cell = nn.GRUCell(CARD.inputs, UNITS)
        self.out = nn.Linear(UNITS, 2)
        self.leaking = leaking

    def forward(self, seen: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        return self.walk(seen, state)

    def walk(self, seen: Tensor, state: Tensor, *others: Tensor) -> tuple[Tensor, Tensor]:
        following = self.cell(seen, state)
        action = 0.3 * seen[:, 3:5] + 0.2 * torch.tanh(self.out(following))
        for other in others:
            action = action + 0.05 * other[:, :2]
        if self.leaking:
            following = following + 0.1 * following.mean(dim=0)
        return action, following


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_policy(Gru(), tmp_path_factory.mktemp("memory") / "gru.onnx", CARD)


def test_a_file_remembers_as_the_network_does(file: Path) -> None:
    policy, network = OnnxPolicy(file), Gru()
    assert (policy.memory, policy.style, policy.interval) == (UNITS, 0, 1)
    assert policy.deterministic
    rng = np.random.default_rng(0)
    memory = Memory(
        state=np.zeros((4, UNITS), np.float32),
        style=np.zeros((4, 0), np.float32),
        world=np.zeros(4, np.int64),
        person=np.arange(4),
        entered=np.ones(4, dtype=bool),
    )
    state = torch.zeros(4, UNITS)
    for _ in range(10):
        seen = rng.uniform(-1, 1, (4, CARD.inputs)).astype(np.float32)
        with torch.no_grad():
            expected, state = network(torch.tensor(seen), state)
        np.testing.assert_allclose(policy.act(seen, memory), expected.numpy(), atol=1e-5)
        state = torch.tensor(kept(state.numpy()))  # as the states of files are
        np.testing.assert_allclose(memory.state, state.numpy(), atol=1.1 * GRID)
        state = torch.tensor(memory.state)


def test_a_crowd_of_a_file_is_that_of_its_network(file: Path) -> None:
    class Network:
        """The network itself, in Python."""

        name, sees, memory = "gru", "observation", UNITS
        observation, rays = CARD.observation, CARD.rays

        def reset(self, scene: Scene, rng: np.random.Generator) -> None:
            self.network = Gru()

        def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
            with torch.no_grad():
                action, state = self.network(torch.tensor(seen), torch.tensor(memory.state))
            memory.state[:] = state.numpy()
            return action.numpy()

    spawn = spawn_model("poisson-gmm", PLAZA)
    one, same, known = (
        rollout(PLAZA, spawn, policy, seed=3, horizon_s=60.0)
        for policy in (OnnxPolicy(file), OnnxPolicy(file), Network())
    )
    assert one.xy.tobytes() == same.xy.tobytes()
    np.testing.assert_allclose(one.xy, known.xy, atol=1e-2)


def test_all_inputs_together(tmp_path: Path) -> None:
    class All(Gru):
        def forward(  # type: ignore[override]
            self, seen: Tensor, noise: Tensor, state: Tensor, style: Tensor
        ) -> tuple[Tensor, Tensor]:
            return self.walk(seen, state, noise, style)

    card = msgspec.structs.replace(CARD, style=3, interval=2)
    policy = OnnxPolicy(export_policy(All(), tmp_path / "all.onnx", card, noise=4))
    assert (policy.noise, policy.memory, policy.style, policy.interval) == (4, UNITS, 3, 2)
    assert not policy.deterministic
    spawn = spawn_model("poisson-gmm", PLAZA)
    one, same, other = (
        rollout(PLAZA, spawn, policy, seed=seed, horizon_s=30.0) for seed in (0, 0, 1)
    )
    assert one.xy.tobytes() == same.xy.tobytes() != other.xy.tobytes()


def test_a_network_that_mixes_states_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"mixes rows[\s\S]*in the next state"):
        export_policy(Gru(leaking=True), tmp_path / "leaking.onnx", CARD)


class Plain(nn.Module):
    def forward(self, seen: Tensor, state: Tensor) -> Tensor:
        return 0.3 * seen[:, 3:5] + 0 * state[:, :2]


def test_a_card_that_does_not_fit_the_network_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "no.onnx"
    with pytest.raises(WeightsError, match=r"actions \(7, 2\) and next states \(7, 5\)"):
        export_policy(Plain(), path, CARD)
    with pytest.raises(WeightsError, match="state of shape \\(7, 4\\)"):
        export_policy(Gru(), path, msgspec.structs.replace(CARD, memory=4))
    with pytest.raises(WeightsError, match="memory"):
        export_policy(Gru(), path, msgspec.structs.replace(CARD, memory=-1))
    assert not path.exists()


def test_a_file_whose_card_hides_its_memory_is_refused(file: Path, tmp_path: Path) -> None:
    import onnx

    model = onnx.load(file)
    card = msgspec.json.decode(model.metadata_props[0].value)
    model.metadata_props[0].value = msgspec.json.encode({**card, "memory": 0}).decode()
    path = tmp_path / "hidden.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(WeightsError, match=r"inputs observation \(A, 14\), state \(A, 5\)"):
        OnnxPolicy(path)


class OfSplit(Counting):
    """Knows which scene and split it is made for."""

    def __init__(self, scene: Scene, split: str) -> None:
        super().__init__()
        self.of = scene.id, split


def test_a_class_learns_which_scene_and_split_it_is_made_for() -> None:
    source = policy_source(f"{__name__}:OfSplit", PLAZA)
    assert source.per_split
    assert source.policy("fold1").of == ("plaza-v0", "fold1")  # type: ignore[union-attr]
    assert not policy_source(f"{__name__}:Counting", PLAZA).per_split
