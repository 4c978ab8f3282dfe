"""Calls of networks: an endless loop ends, and nothing is noted for the makers of onnxruntime."""

import os
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from submissions import write_network

from crowdbench.errors import WeightsError
from crowdbench.policies import OnnxPolicy, PolicyCard, onnx_runtime
from crowdbench.policies.onnx_runtime import CallLimit


def looping(path: Path, beyond: float) -> Path:
    """A network that loops 2⁶² times if a number of an observation is above `beyond`."""
    card = PolicyCard(name="looping", observation="lidar-2", rays=8, scene="plaza-v0", split="full")
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["goes"]),
            helper.make_node("Add", ["x", "one"], ["y"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("k", TensorProto.INT64, []),
            helper.make_tensor_value_info("go", TensorProto.BOOL, []),
            helper.make_tensor_value_info("x", TensorProto.FLOAT, ["A", 2]),
        ],
        [
            helper.make_tensor_value_info("goes", TensorProto.BOOL, []),
            helper.make_tensor_value_info("y", TensorProto.FLOAT, ["A", 2]),
        ],
    )
    number = numpy_helper.from_array
    graph = helper.make_graph(
        [
            helper.make_node("MatMul", ["observation", "weights"], ["walk"]),
            helper.make_node("ReduceMax", ["observation"], ["most"], keepdims=0),
            helper.make_node("Greater", ["most", "beyond"], ["much"]),
            helper.make_node("Cast", ["much"], ["times"], to=TensorProto.INT64),
            helper.make_node("Mul", ["times", "many"], ["count"]),
            helper.make_node("Loop", ["count", "", "walk"], ["action"], body=body),
        ],
        "looping",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["A", card.inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["A", 2])],
        [
            number(np.zeros((card.inputs, 2), np.float32), "weights"),
            number(np.array(beyond, np.float32), "beyond"),
            number(np.array(2**62, np.int64), "many"),
            number(np.ones(1, np.float32), "one"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    entry = model.metadata_props.add()
    entry.key, entry.value = "crowdbench", msgspec.json.encode(card).decode()
    onnx.save(model, path)
    return path


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnx_runtime, "LONGEST_S", 0.5)


@pytest.mark.usefixtures("brief")
def test_a_network_that_never_answers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="got no answer for 1 persons in"):
        OnnxPolicy(looping(tmp_path / "loop.onnx", beyond=-10.0))


@pytest.mark.usefixtures("brief")
def test_a_loop_that_begins_late_ends_too_and_the_next_call_is_answered(tmp_path: Path) -> None:
    policy = OnnxPolicy(looping(tmp_path / "loop.onnx", beyond=10.0))
    calm = np.zeros((3, policy.card.inputs), np.float32)
    assert policy._run({"observation": calm}).shape == (3, 2)
    with pytest.raises(WeightsError, match="got no answer for 3 persons in"):
        policy._run({"observation": calm + 11})
    assert policy._run({"observation": calm}).shape == (3, 2)


@pytest.mark.usefixtures("brief")
def test_calls_are_not_counted_together(tmp_path: Path) -> None:
    policy = OnnxPolicy(write_network(tmp_path / "walker.onnx", "full"))
    seen = np.zeros((3, policy.card.inputs), np.float32)
    until = time.monotonic() + 1.5
    while time.monotonic() < until:
        policy._run({"observation": seen})
    limit = CallLimit()
    with limit:
        pass
    assert not limit.exceeded


def test_nothing_is_noted_for_others(tmp_path: Path) -> None:
    path = write_network(tmp_path / "walker.onnx", "full")
    run = f"from crowdbench.policies import OnnxPolicy; OnnxPolicy({str(path)!r})"
    env = {k: v for k, v in os.environ.items() if not k.startswith(("ORT_", "XDG_"))}
    subprocess.run([sys.executable, "-c", run], env={**env, "HOME": str(tmp_path)}, check=True)
    kept = [p for p in tmp_path.rglob("*") if "onnxruntime" in p.name or "Microsoft" in str(p)]
    assert kept == []
