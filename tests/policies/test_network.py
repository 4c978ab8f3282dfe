"""Policies as files: the same actions as the network's, and no file that is anything else."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn
from worlds import with_bodies

import crowdbench
from crowdbench import rollout, spawn_model
from crowdbench.cli import main
from crowdbench.errors import CrowdbenchError, SettingError, WeightsError
from crowdbench.policies import OnnxPolicy, PolicyCard, export, network
from crowdbench.policies.export import export_policy
from crowdbench.scene import load_scene

PLAZA = load_scene("plaza-v0")
CARD = PolicyCard(name="test", observation="lidar-2", rays=8, scene="plaza-v0", split="full")


class Net(nn.Module):
    """Towards the goal, a little aside."""

    def __init__(self, noisy: bool = False, inputs: int = CARD.inputs) -> None:
        super().__init__()
        self.noisy = noisy
        torch.manual_seed(0)
        self.layers = nn.Sequential(nn.Linear(inputs, 16), nn.Tanh(), nn.Linear(16, 2))

    def forward(self, seen: Tensor, noise: Tensor | None = None) -> Tensor:
        aside = 0.05 * torch.tanh(self.layers(seen))
        action = 0.25 * seen[:, 3:5] + aside
        return action if noise is None else action + 0.1 * noise[:, :2]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_policy(Net(), tmp_path_factory.mktemp("net") / "plain.onnx", CARD)


def test_a_file_that_sees_contact_walks_among_bodies(tmp_path: Path) -> None:
    card = msgspec.structs.replace(CARD, observation="lidar-2-contact")
    policy = OnnxPolicy(export_policy(Net(inputs=16), tmp_path / "contact.onnx", card))
    assert policy.card.inputs == 16
    crowd = rollout(with_bodies(PLAZA), "poisson-gmm", policy, horizon_s=40.0, seed=0)
    assert len(crowd.xy) > 100


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_policy(Net(), tmp_path_factory.mktemp("net") / "noisy.onnx", CARD, noise=3)


@pytest.mark.parametrize("persons", [1, 2, 500])
def test_the_file_acts_as_the_network_does(plain: Path, persons: int) -> None:
    policy = OnnxPolicy(plain)
    assert policy.card == CARD
    assert policy.deterministic
    seen = np.random.default_rng(1).uniform(-1, 1, (persons, CARD.inputs)).astype(np.float32)
    expected = Net()(torch.tensor(seen)).detach().numpy()
    np.testing.assert_allclose(policy.act(seen), expected, rtol=0, atol=1e-5)


def test_a_policy_that_leaves_something_to_chance_is_given_its_noise(noisy: Path) -> None:
    policy = OnnxPolicy(noisy)
    assert not policy.deterministic
    seen = np.zeros((50, CARD.inputs), dtype=np.float32)
    policy.reset(PLAZA, np.random.default_rng(5))
    expected = np.random.default_rng(5).standard_normal((50, 3), dtype=np.float32)
    acted = Net()(torch.tensor(seen), torch.tensor(expected)).detach().numpy()
    np.testing.assert_allclose(policy.act(seen), acted, rtol=0, atol=1e-5)


def test_the_same_seed_walks_the_same_crowd(noisy: Path) -> None:
    spawn = spawn_model("poisson-gmm", PLAZA)
    one, same, other = (
        rollout(PLAZA, spawn, OnnxPolicy(noisy), seed=seed, horizon_s=40.0) for seed in (0, 0, 1)
    )
    assert one.xy.tobytes() == same.xy.tobytes()
    assert one.xy.tobytes() != other.xy.tobytes()
    assert one.provenance["policy"] == "test"


def test_who_is_called_replay_is_none(plain: Path, tmp_path: Path) -> None:
    """The name in a file's card gives no recorded last frames."""
    model = onnx.load(plain)
    carded(name="replay")(model)
    path = tmp_path / "called.onnx"
    path.write_bytes(model.SerializeToString())
    called = OnnxPolicy(path)
    assert called.name == "replay"
    for spawn in (spawn_model("replay", PLAZA), spawn_model("poisson-gmm", PLAZA)):
        crowd, known = (
            rollout(PLAZA, spawn, policy, seed=0, horizon_s=60.0)
            for policy in (called, OnnxPolicy(plain))
        )
        assert crowd.xy.tobytes() == known.xy.tobytes()
        assert crowd.outcome.tolist() == known.outcome.tolist()


def test_it_is_shown_the_observation_that_its_card_names(tmp_path: Path) -> None:
    card = msgspec.structs.replace(CARD, observation="lidar-1", rays=4, ray_range_m=2.5)
    seen = []

    class Spy(OnnxPolicy):
        def act(self, observation):
            seen.append(observation)
            return super().act(observation)

    policy = Spy(export_policy(Net(inputs=9), tmp_path / "small.onnx", card))
    rollout(PLAZA, spawn_model("poisson-gmm", PLAZA), policy, seed=0, horizon_s=20.0)
    assert {s.shape[1] for s in seen} == {9}
    rays = np.concatenate(seen)[:, 5:]
    assert (rays < 1).any()
    assert (rays == 1).mean() > 0.5  # 2.5 m are not far


@pytest.mark.long
@pytest.mark.usefixtures("no_report")
def test_evaluate_takes_a_file_and_a_folder_of_them(plain: Path, tmp_path: Path) -> None:
    card = crowdbench.evaluate(
        "plaza-v0", spawn=["poisson-gmm"], policy=[str(plain)], seeds=2, out=tmp_path / "full"
    )
    assert (str(plain), "poisson-gmm") in {(e.policy, e.spawn) for e in card.entries}

    with pytest.raises(SettingError, match="trained on full of plaza-v0"):
        crowdbench.evaluate(
            "plaza-v0", policy=[str(plain)], seeds=2, protocol="heldout", out=tmp_path / "no"
        )
    folder = tmp_path / "mine"
    folder.mkdir()
    for split in ("full", "fold0", "fold1", "fold2"):
        of_split = msgspec.structs.replace(CARD, split=split)
        export_policy(Net(), folder / f"{split}.onnx", of_split)
    held_out = crowdbench.evaluate(
        "plaza-v0",
        spawn=["poisson-gmm"],
        policy=[str(folder)],
        seeds=2,
        protocol="heldout",
        out=tmp_path / "heldout",
    )
    for entry in held_out.entries:
        if entry.policy == str(folder):
            # One for each fold, also under the recorded arrivals.
            assert len(entry.metrics["speed"].distances) == 3 * (
                2 if entry.spawn != "replay" else 1
            )
    (folder / "fold1.onnx").unlink()
    with pytest.raises(WeightsError, match=r"fold1\.onnx"):
        crowdbench.evaluate(
            "plaza-v0", policy=[str(folder)], seeds=2, protocol="heldout", out=tmp_path / "no"
        )


def test_export_leaves_the_network_as_it_was_and_no_trace_of_the_machine(plain: Path) -> None:
    net = Net().train()
    export_policy(net, plain.parent / "again.onnx", CARD)
    assert net.training
    data = plain.read_bytes()
    assert (plain.parent / "again.onnx").read_bytes() == data
    assert str(Path(__file__).parents[1]).encode() not in data
    assert b"site-packages" not in data


def test_what_depends_on_more_than_its_inputs_is_not_written(tmp_path: Path) -> None:
    class Fickle(Net):
        def forward(self, seen: Tensor, noise: Tensor | None = None) -> Tensor:
            return super().forward(seen) + torch.rand(len(seen), 2)

    with pytest.raises(WeightsError):
        export_policy(Fickle(), tmp_path / "fickle.onnx", CARD)
    assert not list(tmp_path.iterdir())


class Wrong(Net):
    def forward(self, seen: Tensor, noise: Tensor | None = None) -> Tensor:
        return super().forward(seen).repeat(1, 2)


def test_a_network_of_another_shape_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"returns of shape \(7, 4\) for 7 persons"):
        export_policy(Wrong(), tmp_path / "wrong.onnx", CARD)
    assert not list(tmp_path.iterdir())


def test_what_a_network_takes_is_told_before_it_is_traced(tmp_path: Path) -> None:
    card = msgspec.structs.replace(CARD, observation="lidar-2", rays=32)
    with pytest.raises(WeightsError) as raised:
        export_policy(Net(inputs=37), tmp_path / "no.onnx", card)
    told = str(raised.value)
    assert "a network that takes 37 numbers" in told
    assert "lidar-2 has 38 numbers with 32 rays" in told
    assert "This is the size of lidar-1" in told
    with pytest.raises(WeightsError, match="a network that takes 36 numbers"):
        export_policy(Net(inputs=36), tmp_path / "no.onnx", card)
    people = msgspec.structs.replace(CARD, observation="social-1")
    with pytest.raises(WeightsError, match=r"\(A, 102\): social-1 has 102 numbers\. "):
        export_policy(Net(inputs=36), tmp_path / "no.onnx", people)
    assert not list(tmp_path.iterdir())


class Recurrent(torch.nn.Module):
    """An LSTM that forgets everything between two frames."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = torch.nn.LSTM(CARD.inputs, 8, batch_first=True)
        self.out = torch.nn.Linear(8, 2)

    def forward(self, seen: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        hidden, _ = self.layer(seen[:, None, :])
        return self.out(hidden[:, 0])


class WithState(Recurrent):
    def forward(self, seen: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        return super().forward(seen), torch.zeros(len(seen), 8)


def test_a_recurrent_layer_can_be_exported_and_a_state_beside_actions_cannot(
    tmp_path: Path,
) -> None:
    policy = OnnxPolicy(export_policy(Recurrent(), tmp_path / "lstm.onnx", CARD))
    policy.reset(PLAZA, np.random.default_rng(0))
    assert policy.act(np.zeros((3, CARD.inputs), np.float32)).shape == (3, 2)
    with pytest.raises(WeightsError, match="returns a tuple for 7 persons"):
        export_policy(WithState(), tmp_path / "state.onnx", CARD)


def test_a_good_network_passes_the_trial(plain: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", export.TRIAL.format(OnnxPolicy), str(plain)], check=False
    )
    assert done.returncode == 0


def test_a_network_that_ends_the_process_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export, "TRIAL", "import os, signal; os.kill(os.getpid(), signal.SIGABRT)")
    with pytest.raises(WeightsError, match="crashes onnxruntime with signal 6"):
        export_policy(Net(), tmp_path / "no.onnx", CARD)
    assert not (tmp_path / "no.onnx").exists()


# Hostile and broken files: each is a good one with one thing changed.

Change = Callable[[onnx.ModelProto], None]


def card_of(model: onnx.ModelProto) -> dict:
    return msgspec.json.decode(model.metadata_props[0].value)


def carded(**changes: object) -> Change:
    def change(model: onnx.ModelProto) -> None:
        card = {**card_of(model), **changes}
        card = {name: value for name, value in card.items() if value is not None}
        model.metadata_props[0].value = msgspec.json.encode(card).decode()

    return change


def without_card(model: onnx.ModelProto) -> None:
    del model.metadata_props[:]


def two_cards(model: onnx.ModelProto) -> None:
    model.metadata_props.append(model.metadata_props[0])


def no_json(model: onnx.ModelProto) -> None:
    model.metadata_props[0].value = "{"


def external(model: onnx.ModelProto) -> None:
    tensor = model.graph.initializer[0]
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="../../etc/passwd")


def external_within(model: onnx.ModelProto) -> None:
    tensor = numpy_helper.from_array(np.zeros(2, np.float32), "inner")
    tensor.external_data.add(key="location", value="x")
    inner = helper.make_graph(
        [helper.make_node("Constant", [], ["inner_out"], value=tensor)], "g", [], []
    )
    model.graph.node.append(
        helper.make_node("If", ["cond"], ["y"], then_branch=inner, else_branch=inner)
    )


def custom(model: onnx.ModelProto) -> None:
    model.graph.node[0].domain = "com.evil"


def function(model: onnx.ModelProto) -> None:
    model.functions.append(
        helper.make_function("own", "f", ["a"], ["b"], [helper.make_node("Identity", ["a"], ["b"])],
                             [helper.make_opsetid("", 20)])
    )  # fmt: skip


def renamed(model: onnx.ModelProto) -> None:
    model.graph.input[0].name = "obs"


def narrow(model: onnx.ModelProto) -> None:
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_value = 3


def one_person(model: onnx.ModelProto) -> None:
    model.graph.input[0].type.tensor_type.shape.dim[0].dim_value = 1


def doubles(model: onnx.ModelProto) -> None:
    model.graph.input[0].type.tensor_type.elem_type = TensorProto.DOUBLE


def more_output(model: onnx.ModelProto) -> None:
    model.graph.output.append(helper.make_tensor_value_info("more", 1, [None, 2]))


def much_noise(model: onnx.ModelProto) -> None:
    model.graph.input.append(helper.make_tensor_value_info("noise", 1, [None, 10_000]))


def free_noise(model: onnx.ModelProto) -> None:
    model.graph.input.append(helper.make_tensor_value_info("noise", 1, [None, None]))


def third_input(model: onnx.ModelProto) -> None:
    model.graph.input.append(helper.make_tensor_value_info("state", 1, [None, 2]))


def nan(model: onnx.ModelProto) -> None:
    for tensor in model.graph.initializer:
        if tensor.data_type == TensorProto.FLOAT:
            values = numpy_helper.to_array(tensor)
            tensor.CopyFrom(numpy_helper.from_array(values * np.float32(np.nan), tensor.name))


def unknown_operator(model: onnx.ModelProto) -> None:
    model.graph.node[0].op_type = "Nonsense"


def drawing(model: onnx.ModelProto) -> None:
    """What the last node gives, replaced by numbers that nobody's seed decides."""
    model.graph.node[-1].output[0] = "before"
    model.graph.node.append(helper.make_node("RandomUniformLike", ["before"], ["action"], seed=1.0))


def drawing_within(model: onnx.ModelProto) -> None:
    inner = helper.make_graph(
        [helper.make_node("RandomNormal", [], ["inner_out"], shape=[2])], "g", [], []
    )
    model.graph.node.append(
        helper.make_node("If", ["cond"], ["y"], then_branch=inner, else_branch=inner)
    )


def dropping(model: onnx.ModelProto) -> None:
    model.graph.initializer.append(numpy_helper.from_array(np.array(0.5, np.float32), "ratio"))
    model.graph.initializer.append(numpy_helper.from_array(np.array(True), "training"))
    model.graph.node[-1].output[0] = "before"
    inputs = ["before", "ratio", "training"]
    model.graph.node.append(helper.make_node("Dropout", inputs, ["action"]))


def of_the_future(model: onnx.ModelProto) -> None:
    model.opset_import[0].version = 999


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (without_card, "0 metadata entries"),
        (two_cards, "2 metadata entries"),
        (no_json, "card"),
        (carded(mood="good"), "mood"),
        (carded(name=None), "name"),
        (carded(name="<script>"), "the name"),
        (carded(name="x" * 41), "the name"),
        (carded(schema=2), "schema"),
        (carded(observation="lidar-9"), "one of lidar-1, lidar-2, lidar-3"),
        (carded(observation="lidar-1"), "13 numbers"),
        (carded(action="force-1"), "velocity-1"),
        (carded(rays=9), "15 numbers"),
        (carded(rays=100_000), "rays"),
        (carded(ray_range_m=-1.0), "ray_range_m"),
        (carded(ray_range_m=1e-320), "ray_range_m"),
        (carded(split="half"), "split"),
        (carded(scene="../eth"), "scene"),
        (carded(command="\x1b[31m"), r"the command '\x1b[31m'"),  # escaped
        (external, "another file"),
        (external_within, "another file"),
        (custom, "com.evil"),
        (function, "functions"),
        (renamed, "inputs obs"),
        (narrow, "(A, 3)"),
        (one_person, "(1, 14)"),
        (doubles, "another type"),
        (more_output, "outputs"),
        (much_noise, "Z from 1 to 256"),
        (free_noise, "Z from 1 to 256"),
        (third_input, "state"),
        (nan, "not finite"),
        (drawing, "the operator RandomUniformLike, which draws"),
        (drawing_within, "the operator RandomNormal, which draws"),
        (dropping, "the operator Dropout, which draws"),
        (unknown_operator, "onnxruntime cannot run"),
        (of_the_future, "onnxruntime cannot run"),
    ],
)
def test_a_broken_or_hostile_file_is_refused(
    plain: Path, tmp_path: Path, change: Change, said: str
) -> None:
    model = onnx.load(plain)
    change(model)
    path = tmp_path / "changed.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(WeightsError) as caught:
        OnnxPolicy(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_dropout_that_is_not_in_training_is_none(plain: Path, tmp_path: Path) -> None:
    model = onnx.load(plain)
    model.graph.node[-1].output[0] = "before"
    model.graph.node.append(helper.make_node("Dropout", ["before"], ["action"]))
    path = tmp_path / "dropout.onnx"
    path.write_bytes(model.SerializeToString())
    assert OnnxPolicy(path).deterministic


def test_a_large_file_is_not_even_read(
    plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(network, "LARGEST", plain.stat().st_size - 1)
    with pytest.raises(WeightsError, match="MB"):
        OnnxPolicy(plain)


@pytest.mark.parametrize("data", [b"", b"\x80\x04pickle", b"\x00" * 100, b"PK\x03\x04"])
def test_what_is_no_onnx_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "no.onnx"
    path.write_bytes(data)
    with pytest.raises(WeightsError):
        OnnxPolicy(path)


@pytest.mark.parametrize("text", [b"lidar-2", b"Tanh", b"action"])
def test_text_that_is_no_text_is_refused_in_one_message(
    text: bytes, plain: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    data = plain.read_bytes()
    assert text in data
    path = tmp_path / "bytes.onnx"
    path.write_bytes(data.replace(text, b"\xff" * len(text)))
    with pytest.raises(WeightsError):
        OnnxPolicy(path)
    assert capfd.readouterr() == ("", "")


def test_a_missing_file_is_said_to_be_missing(tmp_path: Path, capsys) -> None:
    missing = tmp_path / "none.onnx"
    assert main(["evaluate", "plaza-v0", "--policy", str(missing), "--seeds", "1"]) == 2
    assert str(missing) in capsys.readouterr().err


@pytest.mark.long
def test_the_command_line_writes_and_shows_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "slow_walkers.py").write_text(
        "import torch\n"
        "class Slow(torch.nn.Module):\n"
        "    def forward(self, seen):\n"
        "        return 0.2 * seen[:, 3:5]\n"
        "net = Slow()\n"
        "number = 3\n"
        "def made():\n"
        "    return 3\n"
    )
    monkeypatch.chdir(tmp_path)
    asked = ["--name", "slow", "--scene", "plaza-v0", "--command", "python slow_walkers.py"]
    for named in ("slow_walkers:net", "slow_walkers:Slow"):
        assert main(["policy", "export", named, "slow.onnx", *asked]) == 0
        assert main(["policy", "show", "slow.onnx"]) == 0
    shown = capsys.readouterr().out
    assert main(["policy", "show", "."]) == 2
    assert "got a folder; expected a file. Name a file in it." in capsys.readouterr().err
    assert "full of plaza-v0" in shown
    assert "lidar-2, 32 rays of 10 m (38 numbers)" in shown
    assert "python slow_walkers.py" in shown
    pair = ["--spawn", "poisson-gmm", "--policy", "slow.onnx", "--seeds", "1"]
    assert main(["evaluate", "plaza-v0", *pair, "--out", "out"]) == 0
    assert "poisson-gmm × slow\n" in capsys.readouterr().out
    report = Path("out/report.html").read_text()
    assert "× slow</" in report
    assert "--policy slow.onnx" in report  # what makes it anew
    for named in (
        "slow_walkers",
        "slow_walkers:none",
        "nobody:net",
        "slow_walkers:number",
        "slow_walkers:made",
    ):
        assert main(["policy", "export", named, "no.onnx", *asked]) == 2
        assert capsys.readouterr().err.startswith("crowdbench: network: got")
    assert main(["policy", "export", "slow_walkers:net", "no.onnx", *asked, "--rays", "0"]) == 2
    assert main(["policy", "export", "slow_walkers:net", "no.onnx", *asked, "--split", "all"]) == 2
    assert not Path("no.onnx").exists()


@pytest.mark.parametrize("name", ["bc-of-nobody", "a/b", "x.y:Z"])
def test_unknown_policies_are_refused(name: str) -> None:
    with pytest.raises(CrowdbenchError):
        crowdbench.policy(name, "plaza-v0")
