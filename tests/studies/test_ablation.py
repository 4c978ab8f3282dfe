"""The ablation of anticipate: variants really lack their parts, and the page has a row for each."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from crowdbench.baselines import anticipate
from crowdbench.evaluation import evaluate
from crowdbench.policies.network import read_card
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import Row
from crowdbench.scoring.score import Score
from crowdbench.scoring.scorecard import PairResult
from crowdbench.simulation import social
from studies import ablation
from studies.__main__ import main
from studies.ablation import INTRODUCTION, VARIANTS, lines, walker_of

PLAZA = load_scene("plaza-v0")
NOTHING = PairResult(
    spawn="replay", policy="", seeds=[], persons=0, outcomes={}, speed_mps=None, at_goal=None,
    metrics={},
)  # fmt: skip
BY_NAME = {variant.name: variant for variant in VARIANTS}


def observations(number: int = 5) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(0, 1, (number, social.SIZE))).float()


@pytest.mark.parametrize(
    ("variant", "parts", "sees"),
    [
        ("no-others", [social.NEIGHBOURS], False),
        ("no-memory", [social.AGE, social.WALKED, social.STOOD], False),
        ("no-velocities", [social.NEIGHBOURS], True),  # it still sees where others are
        ("all", [social.AGE], True),
    ],
)
def test_a_blind_network_does_not_depend_on_what_it_does_not_see(
    variant: str, parts: list[slice], sees: bool
) -> None:
    torch.manual_seed(0)
    walker, seen = walker_of(BY_NAME[variant], PLAZA), observations()
    other = seen.clone()
    for part in parts:
        other[:, part] = 0.5 * other[:, part]
    jitter = torch.zeros(len(seen), 1)
    with torch.no_grad():
        same = torch.equal(walker(seen, jitter)[0], walker(other, jitter)[0])
    assert same != sees


def test_a_network_without_velocities_does_not_see_how_others_move() -> None:
    walker, seen = walker_of(BY_NAME["no-velocities"], PLAZA), observations()
    other = seen.clone()
    moving = social.neighbours_of(other)[..., social.APPROACH]
    moving *= -1
    jitter = torch.zeros(len(seen), 1)
    with torch.no_grad():
        assert not torch.equal(seen, other)
        assert torch.equal(walker(seen, jitter)[0], walker(other, jitter)[0])


@pytest.mark.nightly
def test_variants_are_trained_scored_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    few = anticipate.AnticipateSettings(steps=10, people=1)
    slower = replace(BY_NAME["slower"], settings=few, guide=False)
    monkeypatch.setattr(ablation, "VARIANTS", (slower,))
    monkeypatch.setattr("crowdbench.baselines.command.revision", lambda folder: "0123456789ab")
    monkeypatch.setattr(ablation, "decision_frames", lambda scene: 3)
    monkeypatch.setattr(ablation, "evaluate", partial(evaluate, seeds=1))
    arguments = ["ablation", "plaza-v0", "--workers", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    page = capsys.readouterr().out
    assert "    python -m studies ablation plaza-v0\n" in page
    assert [line.split(" | ")[0] for line in page.splitlines()[-2:]] == [
        "| ---", f"| {slower.what}",
    ]  # fmt: skip
    card = read_card(tmp_path / "slower" / "fold1.onnx")
    assert card.interval == 2 * 3
    assert card.command == "python -m studies ablation plaza-v0"
    monkeypatch.setattr(ablation, "train", None)  # nothing is trained again
    assert main(arguments) == 0
    assert capsys.readouterr().out == page


def test_each_variant_has_a_row_with_its_difference_to_the_first() -> None:
    rng = np.random.default_rng(0)
    shared = 0.1 * rng.standard_normal(1000)  # the same blocks are resampled for all

    def row(value: float) -> Row:
        own = 0.01 * rng.standard_normal(1000)
        score = Score(value, value + shared + own)
        families = {"motion": score, "interaction": score}
        return Row("replay", "", "entry", NOTHING, families, None, score, None, (), None)

    values = [0.7 - 0.1 * k for k in range(len(VARIANTS))]
    table = lines([row(value) for value in values])
    assert [line[0] for line in table] == [variant.what for variant in VARIANTS]
    assert table[0][-1] == ""
    for value, line in zip(values[1:], table[1:], strict=True):
        centre, low, high = (
            float(x)
            for x in line[-1].replace("−", "-").replace("[", "").strip("]").replace(",", "").split()
        )
        assert centre == pytest.approx(value - 0.7, abs=0.006)
        assert low < centre < high
        assert high - low < 0.1  # the score's own interval is 0.4 wide


def test_the_page_in_docs_is_of_these_variants() -> None:
    page = (Path(__file__).parents[2] / "docs" / "ablation.md").read_text()
    assert page.startswith(INTRODUCTION.format(scene="eth-v0"))
    shown = [line.split(" | ")[0] for line in page.splitlines() if line.startswith("|")]
    assert shown[2:] == [f"| {variant.what}" for variant in VARIANTS]


def test_a_scene_that_does_not_exist_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ablation", "nowhere-v0"]) == 2
    assert "nowhere-v0" in capsys.readouterr().err
