"""How many networks ntpp-gmm has is what pages and entries say, counted in what is shipped."""

import re
from pathlib import Path

import pytest
from models import learned

from crowdbench.baselines.anticipate import AnticipateSettings
from crowdbench.baselines.anticipation import Walker
from crowdbench.cli import main
from crowdbench.data.blocks import SPLITS
from crowdbench.leaderboard.submission.schema import Declared
from crowdbench.leaderboard.submission.submission import read_submission
from crowdbench.leaderboard.submission.template import _parameters
from crowdbench.scene import list_scenes, load_scene
from crowdbench.scene_building.spawn_diagnostics import Networks, trained_networks
from crowdbench.spawn import NtppGMM
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.ntpp.model import SHAPES
from crowdbench.spawn.paper.model import NtppPaper

ROOT = Path(__file__).parents[2]
SCENES = list_scenes()
WITH_NTPP = ("ntpp-gmm", "ntpp-gmm-bc", "ntpp-gmm-social-force")
LEARNED = (*WITH_NTPP, "ntpp-paper", "bc", "bc-paper", "gail", "anticipate")
MODELS = {"ntpp-gmm": NtppGMM, "ntpp-paper": NtppPaper}


@pytest.fixture(scope="module")
def found() -> dict[str, Networks]:
    return {scene: trained_networks(load_scene(scene)) for scene in SCENES}


def declaration(name: str) -> Declared:
    """What a submission says; `test_entries_shipped` compares the entry with it."""
    submission = read_submission(ROOT / "leaderboard" / "submissions" / name)
    return submission.declared


def heldout(networks: Networks) -> str:
    fits_and_folds = len(networks.heldout) * (len(SPLITS) - 1)
    return f"{sum(networks.heldout)} of {fits_and_folds * networks.areas}"


@pytest.mark.parametrize("scene", SCENES)
def test_the_page_on_spawn_models_has_the_numbers(scene: str, found: dict[str, Networks]) -> None:
    page = (ROOT / "docs" / "spawn-models.md").read_text()
    (row,) = re.findall(rf"^\| {scene} \| (.*) \|$", page, re.M)
    networks = found[scene]
    low, high = min(networks.full), max(networks.full)
    assert row.split(" | ")[:4] == [
        str(networks.areas),
        str(low) if low == high else f"{low} to {high}",
        heldout(networks),
        f"{networks.constant:.0%}".replace("%", " %"),
    ]


@pytest.mark.long
@pytest.mark.parametrize("scene", ["eth-v0", "plaza-v0"])
def test_the_page_on_spawn_models_has_the_likelihoods(
    scene: str, opentraj: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if scene == "eth-v0":
        assert main(["data", "import", "eth", "--source", str(opentraj)]) == 0
    page = (ROOT / "docs" / "spawn-models.md").read_text().replace("−", "-")
    assert main(["spawn", "test", scene]) == 0
    printed = capsys.readouterr().out
    found = dict(re.findall(r"^ ([a-z]+-[a-z]+) +-\d.\d+ +(-\d.\d+) ", printed, re.M))
    (names,) = re.findall(r"^\| scene \| areas \|.*\| without \| (.*) \|$", page, re.M)
    (row,) = re.findall(rf"^\| {scene} \| (.*) \|$", page, re.M)
    shown = dict(zip(names.split(" | "), row.split(" | ")[4:], strict=True))
    assert set(shown) <= set(found)
    for name, value in shown.items():
        assert float(value) == pytest.approx(float(found[name]), abs=0.005), name


def test_the_page_of_results_has_those_of_eth(found: dict[str, Networks]) -> None:
    eth, page = found["eth-v0"], " ".join((ROOT / "docs" / "results.md").read_text().split())
    (trained,) = set(eth.full)
    assert f"a trained network in only {trained} of {eth.areas} areas" in page
    assert f"where {eth.constant:.0%}".replace("%", " % of the people enter") in page


@pytest.mark.parametrize("name", WITH_NTPP)
def test_submissions_say_how_many_networks_were_trained(
    name: str, found: dict[str, Networks]
) -> None:
    declared = declaration(name)
    told = dict.fromkeys(SCENES, "")
    for count, of, scene in re.findall(
        r"(\d+) of (\d+)(?: areas)? of (\w+-v0)", declared.training.data
    ):
        told[scene] = f"{count} of {of}"
    assert told == {s: heldout(found[s]) if s in declared.scenes else "" for s in SCENES}


@pytest.mark.parametrize("name", LEARNED)
def test_submissions_count_what_was_learned(name: str) -> None:
    declared = declaration(name)
    counts = []
    for scene in declared.scenes:
        place = load_scene(scene)
        areas, network = read_areas(place), place.folder / "policies" / declared.shipped_policy
        for split in SPLITS[1:]:
            walker = network / f"{split}.onnx"
            own = _parameters(walker) if walker.is_file() else 0
            if declared.shipped_policy == "anticipate":  # its file also has constants of the guide
                own = sum(p.numel() for p in Walker(1.0, AnticipateSettings.hidden).parameters())
            if declared.shipped_spawn:
                model = MODELS[declared.shipped_spawn]
                # The paper's model has one fit, as the declaration says.
                fits = place.protocol.fits if model is NtppGMM else 1
                own += sum(learned(model.read(place, areas, split, k)) for k in range(fits))
            counts.append(own)
    assert declared.training.parameters == max(counts)


def test_numbers_of_areas_without_a_network_are_a_rate_and_a_size() -> None:
    place = load_scene("eth-v0")
    model = NtppGMM.read(place, read_areas(place))
    assert model.trained().tolist() == [True] + 6 * [False]
    each = sum(array[0].size for array in model.weights.values())
    assert each == sum(model.weights[name][0].size for name in SHAPES)
    assert learned(model) == each + 6 * 2
