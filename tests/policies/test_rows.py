"""People do not see what others observe: networks that mix rows are refused wherever they come."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import onnx
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper
from submissions import declare, problem
from torch import Tensor, nn

from crowdbench import rollout, spawn_model
from crowdbench.cli import main
from crowdbench.errors import WeightsError
from crowdbench.files import sha256
from crowdbench.leaderboard.submission.submission import read_submission
from crowdbench.policies import OnnxPolicy, PolicyCard
from crowdbench.policies.export import export_policy
from crowdbench.policies.memory import Memory
from crowdbench.policies.rows import TOLERANCE, Watch, kept, too_many
from crowdbench.scene import list_scenes, load_scene

PLAZA = load_scene("plaza-v0")
CARD = PolicyCard(name="mixer", observation="lidar-2", rays=8, scene="plaza-v0", split="full")


def goal(seen: Tensor) -> Tensor:
    return 0.4 * seen[:, 3:5]


def mean(seen: Tensor) -> Tensor:
    return goal(seen) + 0.05 * seen[:, 3:5].mean(dim=0, keepdim=True)


def softmax(seen: Tensor) -> Tensor:
    return goal(seen) * torch.softmax(seen[:, 3:4], dim=0)


def running(seen: Tensor) -> Tensor:
    return goal(seen) + 0.01 * torch.cumsum(seen[:, 3:5], dim=0)


def in_company(least: int) -> Callable[[Tensor], Tensor]:
    """Mixes where so many or more are there."""

    def act(seen: Tensor) -> Tensor:
        persons = torch.ones_like(seen[:, :1]).sum(dim=0, keepdim=True)
        mixed = 0.05 * seen[:, 3:5].mean(dim=0, keepdim=True)
        return goal(seen) + torch.where(persons >= least, mixed, torch.zeros_like(mixed))

    return act


def near_someone(seen: Tensor) -> Tensor:
    """Mixes only if someone in the batch sees a person or a wall very close: hardly ever."""
    close = (seen[:, -8:].amin(dim=1, keepdim=True).amin(dim=0, keepdim=True) < 0.03).float()
    return goal(seen) + close * 0.05 * seen[:, 3:5].mean(dim=0, keepdim=True)


class Net(nn.Module):
    def __init__(self, act: Callable[[Tensor], Tensor]) -> None:
        super().__init__()
        self.act = act

    def forward(self, seen: Tensor) -> Tensor:
        return self.act(seen)


def written(
    act: Callable[[Tensor], Tensor],
    path: Path,
    monkeypatch: pytest.MonkeyPatch,
    split: str = "full",
) -> Path:
    """Its file, as someone writes it whose export does not look."""
    card = PolicyCard(name="mixer", observation="lidar-2", rays=8, scene="plaza-v0", split=split)
    with monkeypatch.context() as patch:
        patch.setattr(OnnxPolicy, "check_rows", lambda *of: None)
        return export_policy(Net(act), path, card)


MIXERS = {
    "mean": mean, "softmax": softmax, "cumsum": running,
    "above three": in_company(4), "above a thousand": in_company(1001),
}  # fmt: skip


@pytest.mark.parametrize("act", MIXERS.values(), ids=MIXERS.keys())
def test_export_refuses_what_mixes_rows_and_writes_nothing(
    act: Callable[[Tensor], Tensor], tmp_path: Path
) -> None:
    with pytest.raises(WeightsError, match="mixes rows") as error:
        export_policy(Net(act), tmp_path / "net.onnx", CARD)
    assert error.value.where == str(tmp_path / "net.onnx")
    assert "a difference of" in error.value.got
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "act",
    [
        pytest.param(act, id=name, marks=pytest.mark.long if act is mean else pytest.mark.nightly)
        for name, act in MIXERS.items()
    ],
)
def test_submit_check_refuses_what_mixes_rows(
    act: Callable[[Tensor], Tensor], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = declare(tmp_path / "mine")
    for split in ("fold0", "fold1", "fold2"):
        written(goal, folder / "plaza-v0" / "policy" / f"{split}.onnx", monkeypatch, split)
    read_submission(folder)
    written(act, folder / "plaza-v0" / "policy" / "fold1.onnx", monkeypatch, "fold1")
    told = problem(folder)
    assert "plaza-v0/policy/fold1.onnx: got a network that mixes rows: the same person" in told
    assert f"{TOLERANCE:g}" in told


def test_evaluate_refuses_it_before_the_first_rollout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(mean, tmp_path / "net.onnx", monkeypatch)
    out = tmp_path / "out"
    asked = ["evaluate", "plaza-v0", "--spawn", "poisson-gmm", "--policy", str(file)]
    assert main([*asked, "--seeds", "1", "--workers", "1", "--out", str(out)]) == 2
    assert f"{file}: got a network that mixes rows" in capsys.readouterr().err
    assert not out.exists()


def test_in_a_rollout_it_is_found_out_where_it_has_company(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = OnnxPolicy(written(in_company(4), tmp_path / "net.onnx", monkeypatch))
    with pytest.raises(WeightsError, match="mixes rows"):
        rollout(PLAZA, spawn_model("poisson-gmm", PLAZA), policy, seed=0)


def test_what_mixes_rarely_is_found_out_in_a_rollout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = OnnxPolicy(written(near_someone, tmp_path / "net.onnx", monkeypatch))
    rng = np.random.default_rng(0)
    usual = rng.uniform(0.5, 1, (200, 40, CARD.inputs)).astype(np.float32)
    for seen in usual:
        policy.act(seen)
    close = usual.copy()
    close[:, 7, -1] = 0.01

    def act() -> None:
        for seen in close:
            policy.act(seen)

    with pytest.raises(WeightsError, match="mixes rows"):
        act()


class Remembers(nn.Module):
    """Walks by what it finds in its state."""

    def __init__(self, step: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]) -> None:
        super().__init__()
        self.step = step

    def forward(self, seen: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        return self.step(seen, state)


def whispers(seen: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """A mean over all persons, far below the tolerance; a step later it is an action again."""
    told = (state - 1) * 2.5e5
    return told.expand(-1, 2).clamp(-1, 1), 1 + 4e-6 * seen.mean() + 0 * state


def on_the_edge(seen: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
    """The same where rounding turns it into a whole step."""
    told = (state - 1) * 4096
    return told.expand(-1, 2).clamp(-1, 1), 1 + 0.5 / 4096 + 4e-6 * seen.mean() + 0 * state


def remembering(step: Callable[..., tuple[Tensor, Tensor]], path: Path) -> OnnxPolicy:
    card = PolicyCard(
        name="r", observation="lidar-2", rays=8, scene="plaza-v0", split="full", memory=1
    )
    return OnnxPolicy(export_policy(Remembers(step), path, card))


def walked(policy: OnnxPolicy, steps: list[np.ndarray]) -> np.ndarray:
    """The last actions of persons, of whom the policy keeps a state."""
    size = len(steps[0])
    memory = Memory(
        np.zeros((size, 1), np.float32), np.empty((size, 0), np.float32),
        np.zeros(size, np.int64), np.arange(size), np.ones(size, bool),
    )  # fmt: skip
    policy.reset(PLAZA, np.random.default_rng(0))
    for seen in steps:
        action = policy.act(seen, memory)
    return action


@pytest.mark.parametrize("loud", [-1.0, 1.0])
def test_a_state_does_not_tell_what_others_see(loud: float, tmp_path: Path) -> None:
    """One person shouts, the others are as always: they act as if nobody did."""
    policy = remembering(whispers, tmp_path / "net.onnx")
    rng = np.random.default_rng(0)
    calm = [rng.uniform(-0.1, 0.1, (40, policy.card.inputs)).astype(np.float32) for _ in range(3)]
    shouted = [seen.copy() for seen in calm]
    for seen in shouted:
        seen[0] = 5 * loud
    assert walked(policy, calm)[1:] == pytest.approx(walked(policy, shouted)[1:])


def test_a_state_on_the_edge_of_rounding_is_found_out(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="one number of the next state of"):
        remembering(on_the_edge, tmp_path / "net.onnx")


def test_a_memory_of_ones_own_is_kept(tmp_path: Path) -> None:
    def counts(seen: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        return state.expand(-1, 2) / 10, state + 0.25 + seen[:, :1] / 4

    policy = remembering(counts, tmp_path / "net.onnx")
    rng = np.random.default_rng(1)
    steps = [rng.uniform(-1, 1, (30, policy.card.inputs)).astype(np.float32) for _ in range(5)]
    told = sum(0.25 + seen[:, 0] / 4 for seen in steps[:-1]) / 10
    assert walked(policy, steps)[:, 0] == pytest.approx(told.clip(-1, 1), abs=1e-3)


@given(st.floats(-1e6, 1e6, width=32))
def test_states_keep_their_size(state: float) -> None:
    found = float(kept(np.array([[state]], np.float32))[0, 0])
    assert abs(found - state) <= 2.0**-13 * max(1, abs(state))
    assert float(kept(np.array([[found]], np.float32))[0, 0]) == found


def test_what_a_rollout_looks_at_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Noisy(nn.Module):
        def forward(self, seen: Tensor, noise: Tensor) -> Tensor:
            return goal(seen) + 0.1 * noise

    file = export_policy(Noisy(), tmp_path / "net.onnx", CARD, noise=2)
    spawn = spawn_model("poisson-gmm", PLAZA)
    looked = rollout(PLAZA, spawn, OnnxPolicy(file), seed=0, horizon_s=120.0)
    monkeypatch.setattr(Watch, "look", lambda *of: None)
    plain = rollout(PLAZA, spawn, OnnxPolicy(file), seed=0, horizon_s=120.0)
    assert looked.xy.tobytes() == plain.xy.tobytes()


def test_an_action_that_is_chosen_may_turn_over_now_and_then_and_no_more() -> None:
    assert not too_many(1, 5)
    assert too_many(2, 5)
    assert not too_many(3, 256)
    assert too_many(6, 256)


def shipped() -> list[Path]:
    found = [load_scene(name).folder / "policies" for name in list_scenes()]
    return sorted(path for folder in found for path in folder.glob("*/*.onnx"))


def test_shipped_networks_answer_each_row_alone() -> None:
    files = {sha256(path.read_bytes()): path for path in shipped() if "forum" in str(path)}
    assert files
    for path in files.values():
        OnnxPolicy(path).check_rows()


def test_a_network_that_cannot_be_run_for_so_many_is_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It looks up a table of five rows by the number of persons."""
    tables = {"table": np.zeros((5, 1), np.float32), "from": [3], "to": [5], "axis": [1]}
    nodes = (
        ("Slice", ["observation", "from", "to", "axis"], ["aim"], {}),
        ("Shape", ["observation"], ["persons"], {"end": 1}),
        ("Gather", ["table", "persons"], ["nothing"], {}),
        ("Add", ["aim", "nothing"], ["action"], {}),
    )
    graph = helper.make_graph(
        [helper.make_node(kind, inputs, outputs, **more) for kind, inputs, outputs, more in nodes],
        "walker",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["A", CARD.inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["A", 2])],
        [numpy_helper.from_array(np.array(values), name) for name, values in tables.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    entry = model.metadata_props.add()
    entry.key, entry.value = "crowdbench", msgspec.json.encode(CARD).decode()
    onnx.save(model, tmp_path / "net.onnx")
    policy = OnnxPolicy(tmp_path / "net.onnx")
    for use in (lambda: policy.act(np.zeros((5, CARD.inputs), np.float32)),
                lambda: policy.check_rows()):  # fmt: skip
        with pytest.raises(WeightsError, match="onnxruntime cannot run"):
            use()
