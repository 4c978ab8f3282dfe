"""Files with fits per split: read back as written, refused when broken, whatever the model."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from models import AREAS, GRID_S, groups, random_ntpp, renewal
from safetensors.numpy import load_file, save_file

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError, WeightsError
from crowdbench.scene import Scene, list_scenes, load_scene
from crowdbench.spawn import NtppGMM, PoissonGMM, PoissonGroups, RenewalGMM, arrivals_in
from crowdbench.spawn.ntpp.model import SHAPES

ETH = load_scene("eth-v0")
TRAINED = {"window_frames": 100, "learning_rate": 0.005}
FILES = ("poisson-gmm.json", "poisson-groups.json", "renewal-gmm.json", "ntpp-gmm.safetensors")


@pytest.fixture
def place(tmp_path: Path) -> Scene:
    """A scene with all files, each split and fit with numbers of its own."""
    (tmp_path / "scene.toml").write_bytes((ETH.folder / "scene.toml").read_bytes())
    write_all(tmp_path)
    return load_scene(tmp_path)


def write_all(folder: Path) -> None:
    rates = {split: PoissonGMM(AREAS, np.array([0.5, 0.01 * k])) for k, split in enumerate(SPLITS)}
    PoissonGMM.write(folder, {split: [model] for split, model in rates.items()})
    sizes = {split: groups(0.1 + 0.1 * k) for k, split in enumerate(SPLITS)}
    PoissonGroups.write(folder, {split: [model] for split, model in sizes.items()})
    members = {split: renewal(0.1 + 0.1 * k) for k, split in enumerate(SPLITS)}
    RenewalGMM.write(folder, {split: [model] for split, model in members.items()})
    fits = {
        split: [
            replace(random_ntpp(seed=10 * k + f), memory=77, settings=TRAINED) for f in range(2)
        ]
        for k, split in enumerate(SPLITS)
    }
    NtppGMM.write(folder, fits)


@pytest.mark.parametrize(("k", "split"), list(enumerate(SPLITS)))
def test_each_part_comes_back_as_it_was(place: Scene, k: int, split: str) -> None:
    assert PoissonGMM.read(place, AREAS, split).rate.tolist() == [0.5, 0.01 * k]
    back, written = RenewalGMM.read(place, AREAS, split), renewal(0.1 + 0.1 * k)
    for name in ("shape", "scale_s", "next_member"):
        assert np.array_equal(getattr(back, name), getattr(written, name))
    sizes, written_sizes = PoissonGroups.read(place, AREAS, split), groups(0.1 + 0.1 * k)
    for name in ("rate_per_s", "next_member"):
        assert np.array_equal(getattr(sizes, name), getattr(written_sizes, name))
    for fit in range(2):
        one, other = NtppGMM.read(place, AREAS, split, fit), random_ntpp(seed=10 * k + fit)
        assert all(np.array_equal(one.weights[name], other.weights[name]) for name in SHAPES)
        assert (one.memory, one.settings) == (77, TRAINED)


def test_fits_are_counted_round(place: Scene) -> None:
    one, again = (NtppGMM.read(place, AREAS, "fold1", fit) for fit in (1, 3))
    assert np.array_equal(one.weights["base"], again.weights["base"])
    assert RenewalGMM.read(place, AREAS, "fold1", 7).shape.tolist() == [0.6, 1.7]


@pytest.mark.parametrize("name", FILES)
def test_the_same_fits_make_the_same_bytes(place: Scene, name: str) -> None:
    before = (place.folder / name).read_bytes()
    write_all(place.folder)
    assert (place.folder / name).read_bytes() == before


@pytest.mark.parametrize("model", [PoissonGMM, PoissonGroups, RenewalGMM, NtppGMM])
@pytest.mark.parametrize(("split", "fit"), [("fold3", 0), ("full", -1)])
def test_parts_and_fits_that_no_model_has_are_refused(
    place: Scene, model: Any, split: str, fit: int
) -> None:
    with pytest.raises(SettingError):
        model.read(place, AREAS, split, fit)


@pytest.mark.parametrize("model", [PoissonGMM, PoissonGroups, RenewalGMM, NtppGMM])
def test_missing_files_say_how_to_get_them(place: Scene, model: Any) -> None:
    for name in FILES:
        (place.folder / name).unlink()
    with pytest.raises(WeightsError, match="no such file") as caught:
        model.read(place, AREAS)
    assert "crowdbench scene fit " in caught.value.hint


def change(place: Scene, name: str, field: str, value: object) -> None:
    path = place.folder / f"{name}.json"
    content = json.loads(path.read_text())
    inner = content
    *way, last = field.split(".")
    for key in way:
        inner = inner[key]
    if value is None:
        del inner[last]
    else:
        inner[last] = value
    path.write_text(json.dumps(content))


BROKEN = {
    "scene": ("scene", "zara01-v0", "of zara01-v0"),
    "model": ("model", "other", "other of eth-v0"),
    "schema 1": ("schema", 1, "schema 1"),
    "unknown field": ("colour", "red", "colour"),
    "a fold missing": ("splits.fold1", None, "fold0, fold2, full"),
    "another split": ("splits.fold9", {}, "fold9"),
    "a number too many": ("splits.full.next_moon", [1.0, 1.0], "next_moon"),
    "not one per area": ("splits.fold2.{name}", [0.1, 0.1, 0.1], "shape (3,)"),
    "text": ("splits.full.{name}", "fast", "splits"),
    "negative": ("splits.full.{name}", [0.1, -0.1], "invalid values"),
}


@pytest.mark.parametrize(("field", "value", "got"), BROKEN.values(), ids=BROKEN)
@pytest.mark.parametrize(
    ("kind", "number"),
    [
        (PoissonGMM, "rate_per_s"),
        (PoissonGroups, "rate_per_s"),
        (RenewalGMM, "shape"),
        (RenewalGMM, "scale_s"),
    ],
)
def test_broken_json_is_refused(
    place: Scene, kind: Any, number: str, field: str, value: object, got: str
) -> None:
    names = {PoissonGMM: "poisson-gmm", PoissonGroups: "poisson-groups", RenewalGMM: "renewal-gmm"}
    name = names[kind]
    change(place, name, field.format(name=number), value)
    with pytest.raises(WeightsError) as caught:
        kind.read(place, AREAS)
    assert str(place.folder) in caught.value.where
    assert got in f"{caught.value.where}: {caught.value.got}"
    assert "crowdbench scene fit " in caught.value.hint


def test_probabilities_beyond_one_are_refused(place: Scene) -> None:
    for name, model in (("renewal-gmm", RenewalGMM), ("poisson-groups", PoissonGroups)):
        change(place, name, "splits.full.next_member", [0.2, 1.0])
        with pytest.raises(WeightsError, match=r"probabilities in \(0, 1\)"):
            model.read(place, AREAS)


def test_rates_of_the_first_schema_are_told_from_broken_ones(place: Scene) -> None:
    old = {"schema": 1, "model": "poisson-gmm", "scene": "eth-v0", "rate_per_s": [0.1, 0.2]}
    (place.folder / "poisson-gmm.json").write_text(json.dumps(old))
    with pytest.raises(WeightsError, match="schema 1; expected poisson-gmm of eth-v0, schema 2"):
        PoissonGMM.read(place, AREAS)


def altered(place: Scene, name: str, array: np.ndarray | None, header: object = None) -> None:
    """Write the neural weights anew with one tensor replaced or left out."""
    from safetensors import safe_open

    path = place.folder / "ntpp-gmm.safetensors"
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    if array is None:
        tensors.pop(name, None)
    else:
        tensors[name] = array
    if header is not None:
        own = json.loads(metadata["crowdbench"]) | header  # type: ignore[operator]
        own = {field: value for field, value in own.items() if value is not None}
        metadata = {"crowdbench": json.dumps(own)}
    save_file(tensors, path, metadata=metadata)


def nan_in(shape: tuple[int, ...]) -> np.ndarray:
    array = np.ones(shape, np.float32)
    array.flat[-1] = np.nan
    return array


TENSORS = {
    "missing": ("fold2.1.base", None, "missing or unknown: base"),
    "unknown": ("fold2.7.base", np.ones((2, 3), np.float32), "fold2.7"),
    "shape": ("full.0.initial", np.ones((2, 31), np.float32), "float32 of shape (2, 31)"),
    "areas": ("full.0.initial", np.ones((3, 32), np.float32), "float32 of shape (3, 32)"),
    "kind": ("full.0.initial", np.ones((2, 32), np.float64), "float64 of shape (2, 32)"),
    "half": ("full.0.initial", np.ones((2, 32), np.float16), "expected float32 of shape (2, 32)"),
    "not half": (
        "full.0.out_weight",
        np.ones((2, 3, 32), np.float32),
        "float32 of shape (2, 3, 32); expected float16 of shape (2, 3, 32)",
    ),
    "nan": ("fold0.1.out_bias", nan_in((2, 3)), "NaN or infinity"),
    "spread": (
        "full.1.scaling",
        np.zeros((2, 4), np.float32),
        "invalid values; expected standard deviations > 0",
    ),
}


@pytest.mark.parametrize(("name", "array", "got"), TENSORS.values(), ids=TENSORS)
def test_broken_tensors_are_refused_in_whatever_part_they_are(
    place: Scene, name: str, array: np.ndarray | None, got: str
) -> None:
    altered(place, name, array)
    with pytest.raises(WeightsError) as caught:
        NtppGMM.read(place, AREAS)
    assert got in str(caught.value)
    assert "crowdbench scene fit " in caught.value.hint


def with_weight(name: str, value: float) -> NtppGMM:
    model = random_ntpp()
    array = model.weights[name].copy()
    array[1].flat[-1] = value
    return replace(model, weights={**model.weights, name: array})


BEYOND = [
    ("state_weight", 1e5, "a weight of 100000; expected float16, a number within ±65504"),
    ("input_weight", -70000.0, "a weight of -70000"),
    ("out_weight", np.nan, "a weight of nan"),
    ("base", np.inf, "a weight of inf; expected float32"),
]


@pytest.mark.parametrize(("name", "value", "got"), BEYOND)
def test_weights_that_a_file_cannot_hold_are_refused_when_a_fit_is_made(
    name: str, value: float, got: str
) -> None:
    with pytest.raises(WeightsError, match=f"^ntpp-gmm of eth-v0, {name} of area 1: ") as caught:
        with_weight(name, value)
    assert got in str(caught.value)


def test_weights_are_rounded_once_and_not_beyond_their_kind() -> None:
    one = with_weight("hidden_weight", 0.1).weights["hidden_weight"]
    assert (one.dtype, float(one[1, -1, -1])) == (np.float32, float(np.float16(0.1)))
    assert with_weight("hidden_weight", 60000.0).weights["hidden_weight"].max() == 60000
    log_scale = float(np.float32(9.3001))
    assert float(with_weight("base", log_scale).weights["base"][1, -1]) == log_scale


SHIPPED = [
    f for s in list_scenes() for f in sorted(load_scene(s).folder.glob("ntpp-*.safetensors"))
]


@pytest.mark.parametrize("path", SHIPPED, ids=[f"{f.parent.name}/{f.stem}" for f in SHIPPED])
def test_matrices_of_shipped_networks_are_half_and_all_else_is_not(path: Path) -> None:
    kinds: dict[str, set[np.dtype[Any]]] = {}
    for key, tensor in load_file(path).items():
        kinds.setdefault(key.rpartition(".")[2], set()).add(tensor.dtype)
    assert {name for name, kind in kinds.items() if kind == {np.dtype(np.float16)}} == {
        *("input_weight", "state_weight", "hidden_weight", "out_weight")
    }
    others = [kind for name, kind in kinds.items() if not name.endswith("_weight")]
    assert others == [{np.dtype(np.float32)}] * len(others) != []


def test_areas_without_a_network_are_left_out_of_the_file_and_sample_the_same(
    place: Scene,
) -> None:
    model = random_ntpp(seed=3)
    model.weights["out_weight"][0] = 0
    NtppGMM.write(place.folder, {split: [model] for split in SPLITS})
    tensors = load_file(place.folder / "ntpp-gmm.safetensors")
    assert {len(tensors[f"full.0.{name}"]) for name in ("out_weight", "base", "scaling")} == {2}
    assert {len(tensors[f"full.0.{name}"]) for name in ("state_weight", "initial")} == {1}
    back = NtppGMM.read(place, AREAS)
    assert back.trained().tolist() == [False, True]
    for name in SHAPES:
        assert np.array_equal(back.weights[name][1], model.weights[name][1])
    one, other = (m.sample(600.0, ETH, np.random.default_rng(0)) for m in (back, model))
    assert len(one) > 0
    assert np.array_equal(one.time_s, other.time_s)
    assert np.array_equal(one.spawn_area, other.spawn_area)
    arrivals = arrivals_in(one, 600.0, GRID_S, 2)
    assert back.log_likelihood(arrivals) == model.log_likelihood(arrivals)


def test_weights_of_another_number_of_networks_are_refused(place: Scene) -> None:
    weights = np.ones((2, 3, 32), np.float16)
    weights[1] = 0
    altered(place, "fold1.1.out_weight", weights)
    with pytest.raises(WeightsError, match=r"fold1\.1\.initial: got .* expected 1 networks"):
        NtppGMM.read(place, AREAS)


HEADERS = {
    "scene": ({"scene": "zara01-v0"}, "ntpp-gmm of zara01-v0"),
    "model": ({"model": "other"}, "other of eth-v0"),
    "schema": ({"schema": 9}, "schema 9"),
    "old schema": ({"schema": 3}, "schema 3; expected ntpp-gmm of eth-v0, schema 4"),
    "grid": ({"grid_s": 0.1}, "grid_s: got 0.1; expected 0.4 s"),
    "no fits": ({"fits": 0}, "one or more fits"),
    "no memory": ({"memory": 0}, "memory: got Expected `int` >= 1"),
    "half a step": ({"memory": 7.5}, "memory"),
    "unknown field": ({"colour": "red"}, "colour"),
}


@pytest.mark.parametrize(("header", "got"), HEADERS.values(), ids=HEADERS)
def test_tensors_of_something_else_are_refused(
    place: Scene, header: dict[str, object], got: str
) -> None:
    altered(place, "nothing", None, header)
    with pytest.raises(WeightsError) as caught:
        NtppGMM.read(place, AREAS)
    assert got in str(caught.value)


def test_tensors_that_do_not_say_when_the_network_forgets_are_refused(place: Scene) -> None:
    altered(place, "nothing", None, {"memory": None})
    with pytest.raises(WeightsError, match="memory"):
        NtppGMM.read(place, AREAS)


@pytest.mark.parametrize("keep", [0, 4, 100, 5000, -1])
def test_truncated_tensors_are_refused(place: Scene, keep: int) -> None:
    path = place.folder / "ntpp-gmm.safetensors"
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(WeightsError, match="unreadable weights"):
        NtppGMM.read(place, AREAS)


def test_tensors_without_our_header_are_refused(place: Scene) -> None:
    path = place.folder / "ntpp-gmm.safetensors"
    save_file(load_file(path), path)
    with pytest.raises(WeightsError, match="expected safetensors with crowdbench's header"):
        NtppGMM.read(place, AREAS)
