"""Names in tables and pictures: short, and never two of the same."""

import importlib
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from conftest import need
from hypothesis import given
from hypothesis import strategies as st

from crowdbench.errors import WeightsError
from crowdbench.report.display_names import names_of
from crowdbench.scene import load_scene

ETH = load_scene("eth-v0")
SHIPPED = ETH.folder / "policies" / "bc"


def test_a_model_under_a_scenario_is_called_by_its_stem() -> None:
    names = names_of([("ntpp-gmm+docs/rush_hour.toml", "straight"), ("replay", "straight")], ETH)
    assert names.pair("ntpp-gmm+docs/rush_hour.toml", "straight") == "ntpp-gmm+rush_hour × straight"
    assert names.pair("replay", "straight") == "replay × straight"


def test_scenarios_of_the_same_stem_keep_their_folders() -> None:
    asked = ["ntpp-gmm+a/busy.toml", "ntpp-gmm+b/busy.toml", "poisson-gmm+a/busy.toml"]
    names = names_of([(spawn, "straight") for spawn in asked], ETH)
    assert list(names.spawn.values()) == [*asked[:2], "poisson-gmm+busy"]


@pytest.mark.parametrize("asked", [SHIPPED, SHIPPED / "fold1.onnx"])
def test_a_policy_in_a_file_is_called_as_its_card_says(asked: Path) -> None:
    need(find_spec("onnx"), "onnx")
    assert names_of([("ntpp-gmm", str(asked))], ETH).policy == {str(asked): "bc"}


def test_a_folder_of_folds_alone_is_called_as_their_cards_say(tmp_path: Path) -> None:
    need(find_spec("onnx"), "onnx")
    for fold in range(3):
        shutil.copy(SHIPPED / f"fold{fold}.onnx", tmp_path)
    assert names_of([("ntpp-gmm", str(tmp_path))], ETH).policy == {str(tmp_path): "bc"}


def test_policies_of_the_same_name_keep_their_files() -> None:
    need(find_spec("onnx"), "onnx")
    asked = ["bc", str(SHIPPED / "fold0.onnx"), str(SHIPPED / "fold1.onnx")]
    names = names_of([("ntpp-gmm", policy) for policy in asked], ETH)
    assert names.policy == {policy: policy for policy in asked}


def test_a_class_is_called_by_its_name_once_it_is_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    classes = {"Predictive": "predictive", "Tall": "straight", "Odd": "[red]", "Nameless": None}
    lines = [f"class {kind}:\n    name = {name!r}\n" for kind, name in classes.items()]
    (tmp_path / "their_walkers.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    asked = [f"their_walkers:{kind}" for kind in (*classes, "Missing")]
    pairs = [*(("ntpp-gmm", policy) for policy in asked), (asked[0], "straight")]
    assert list(names_of(pairs, ETH).policy) == list(names_of(pairs, ETH).policy.values())
    importlib.import_module("their_walkers")
    monkeypatch.setitem(sys.modules, "their_walkers", sys.modules["their_walkers"])  # undone later
    names = names_of(pairs, ETH)
    assert names.policy == {p: p for p in [*asked, "straight"]} | {asked[0]: "predictive"}
    assert names.spawn[asked[0]] == "predictive"
    steered = f"{asked[0]}+docs/rush_hour.toml"
    assert names_of([(steered, "straight")], ETH).spawn == {steered: "predictive+rush_hour"}


def test_a_missing_file_is_said_to_be_missing(tmp_path: Path) -> None:
    need(find_spec("onnx"), "onnx")
    with pytest.raises(WeightsError, match=r"none\.onnx"):
        names_of([("ntpp-gmm", str(tmp_path / "none.onnx"))], ETH)


WORDS = st.sampled_from(["ntpp-gmm", "pkg.module:Class", "m+a/x.toml", "m+b/x.toml", "m+x.toml",
                         "m+x", "<b>/&"])  # fmt: skip


@given(st.lists(st.tuples(WORDS, WORDS), min_size=1))
def test_no_two_share_a_name(pairs: list[tuple[str, str]]) -> None:
    names = names_of(pairs, ETH)
    assert len({names.pair(*pair) for pair in pairs}) == len(set(pairs))
