"""Small submissions on the plaza in which nothing is wrong, for tests to spoil."""

import shutil
from pathlib import Path

import msgspec
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from crowdbench.data.storage import write_csv, write_parquet
from crowdbench.data.table import Trajectories, from_rows
from crowdbench.leaderboard.submission.errors import SubmissionError
from crowdbench.leaderboard.submission.submission import read_submission
from crowdbench.policies import PolicyCard
from crowdbench.registry import WEIGHTS
from crowdbench.scene import load_scene

PLAZA = load_scene("plaza-v0")
SHIPPED_FITS = [file for file in WEIGHTS if (PLAZA.folder / file).is_file()]
FOLDS = ("fold0", "fold1", "fold2")
TOML = """\
schema = 1
name = "A walker"
authors = ["Ada Lovelace"]
contact = "ada@example.org"
link = "https://example.org/walker"
licence = "Apache-2.0"
track = "{track}"
kind = "learned"
scenes = ["plaza-v0"]

[training]
data = "the plaza"
protocol = "{protocol}"
parameters = 28
"""


def declare(folder: Path, track: str = "walk", protocol: str = "heldout", more: str = "") -> Path:
    """Write `submission.toml`; `more` are lines before the first table."""
    folder.mkdir(parents=True, exist_ok=True)
    text = TOML.format(track=track, protocol=protocol)
    (folder / "submission.toml").write_text(text.replace("\n[training]", f"{more}\n[training]"))
    return folder


def write_network(path: Path, split: str, scene: str = "plaza-v0", scale: float = 0.4) -> Path:
    """A network of one layer that walks towards the goal."""
    card = PolicyCard(name="tiny", observation="lidar-2", rays=8, scene=scene, split=split)
    weights = np.zeros((card.inputs, 2), dtype=np.float32)
    weights[3, 0] = weights[4, 1] = scale
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "weights"], ["action"])],
        "walker",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["A", card.inputs])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["A", 2])],
        [numpy_helper.from_array(weights, "weights")],
    )
    opset = [helper.make_opsetid("", 20)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=10)
    entry = model.metadata_props.add()
    entry.key, entry.value = "crowdbench", msgspec.json.encode(card).decode()
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path


def walk_submission(folder: Path) -> Path:
    """Track walk: a network for each fold."""
    declare(folder)
    for split in FOLDS:
        write_network(folder / "plaza-v0" / "policy" / f"{split}.onnx", split)
    return folder


def spawn_submission(folder: Path, file: str = "renewal-gmm.json") -> Path:
    """Track spawn: fits as the plaza ships them."""
    declare(folder, "spawn")
    place = folder / "plaza-v0" / "spawn"
    place.mkdir(parents=True)
    shutil.copyfile(PLAZA.folder / file, place / file)
    return folder


def listed_submission(folder: Path) -> Path:
    """Track crowd: three rollouts, one of them as CSV."""
    declare(folder, "crowd")
    place = folder / "plaza-v0" / "trajectories"
    place.mkdir(parents=True)
    for k in range(2):
        write_parquet(crowd(k), place / f"{k}.parquet")
    write_csv(crowd(2), place / "2.csv")
    return folder


def crowd(seed: int = 0, **changed: object) -> Trajectories:
    """Twenty persons who walk across the plaza one after the other, as another program made them.

    `changed` may hold any argument of `from_rows`.
    """
    rng = np.random.default_rng(seed)
    persons, length = 20, 55
    first = np.linspace(0, 4430, persons).astype(int)
    y = rng.uniform(9.0, 10.5, persons)
    x = np.linspace(1.5, 28.5, length)
    rows = {
        "scene": "plaza-v0",
        "dt_s": 0.4,
        "frames": 4500,
        "person_id": np.repeat(np.arange(persons), length),
        "frame": (first[:, None] + np.arange(length)).ravel(),
        "xy": np.stack([np.tile(x, persons), np.repeat(y, length)], axis=1),
        "where": "test",
    }
    return from_rows(**(rows | changed))  # type: ignore[arg-type]


def refusal(path: Path) -> str:
    """All that is told of a submission that is refused."""
    with pytest.raises(SubmissionError) as caught:
        read_submission(path)
    return str(caught.value)


def problem(path: Path) -> str:
    """The one thing that is wrong with it."""
    told = refusal(path)
    assert ": 1 problem.\n" in told
    return told


def edit(folder: Path, old: str, new: str) -> Path:
    path = folder / "submission.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return folder


FILLED = {
    '"FILL IN: your name"': '"Ada Lovelace"',
    '"FILL IN: an e-mail address or an issue tracker"': '"ada@example.org"',
    '"FILL IN: https://… of the paper or the code"': '"https://example.org"',
    '"FILL IN: the SPDX identifier of these files\' licence, such as Apache-2.0"': '"MIT"',
    '"FILL IN: what it was trained on"': '"the plaza"',
    '"FILL IN: a number"': "12",
}


def fill_in(folder: Path) -> None:
    """Replace the placeholders of a submission that was begun by `submit init`."""
    text = (folder / "submission.toml").read_text()
    for old, new in FILLED.items():
        if old in text:
            edit(folder, old, new)
