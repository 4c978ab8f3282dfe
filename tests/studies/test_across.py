"""The page on how `anticipate` walks in places that it was not trained on."""

from functools import partial
from pathlib import Path

import pytest
from torch import Tensor, nn

from crowdbench.baselines.anticipate import AnticipateSettings
from crowdbench.baselines.command import Command
from crowdbench.evaluation import evaluate
from crowdbench.policies import OnnxPolicy
from crowdbench.registry import import_recording
from crowdbench.simulation import social
from studies import across
from studies.__main__ import main


class Constant(nn.Module):
    """Walks straight at 1 m/s, in units of 5 m/s."""

    def forward(self, seen: Tensor) -> Tensor:
        return 0.2 * seen[:, social.ROUTE_DIRECTION]


def test_each_scene_is_named_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenes = ["eth-v0", "hotel-v0", "zara1-v0", "eth-v0"]
    assert main(["across", *scenes, "--out", str(tmp_path)]) == 2
    assert "expected each scene once" in capsys.readouterr().err


def test_the_page_trains_without_each_scene_and_with_all(tmp_path: Path) -> None:
    commands = across.commands_of(["eth-v0", "hotel-v0", "zara1-v0"], tmp_path)
    assert [len(command.scenes) for command in commands] == [2, 2, 2, 3]
    assert [c.out.name for c in commands][2:] == ["without-zara1-v0", "anticipate-any"]
    assert commands[0].line == (
        "python -m crowdbench.baselines.anticipate "
        "--scenes eth-v0 hotel-v0 zara1-v0 --leave-out eth-v0"
    )


@pytest.mark.long
def test_the_page_has_a_row_for_each_scene_and_files_are_kept(
    opentraj: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("eth", "hotel", "zara01"):
        import_recording(name, opentraj)

    def constant(command: Command, split: str, settings: AnticipateSettings) -> Path:
        return command.write(split, Constant(), observation="social-1", noise=0)

    monkeypatch.setattr(across, "learn", constant)
    monkeypatch.setattr("crowdbench.baselines.command.revision", lambda folder: "0123456789ab")
    monkeypatch.setattr(across, "OTHERS", ("straight", "guided-walker", "social-force"))
    monkeypatch.setattr(across, "evaluate", partial(evaluate, seeds=1))
    scenes = ["eth-v0", "hotel-v0", "zara1-v0"]
    arguments = ["across", *scenes, "--workers", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    page = capsys.readouterr().out
    assert "python -m studies across eth-v0 hotel-v0" in page
    lines = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")]
    for head in (across.HEAD, across.DIFFERENCES):
        found = [cells for cells in lines if len(cells) == len(head)]
        assert [cells[0] for cells in found][-3:] == [f"| {scene}" for scene in scenes]
    assert OnnxPolicy(tmp_path / "without-eth-v0/full.onnx").card.scene == "hotel-v0+zara1-v0"
    monkeypatch.setattr(across, "learn", None)  # nothing is trained again
    for command in across.commands_of(scenes, tmp_path):
        across.write(command)


def test_what_is_missing_is_said_before_the_trainings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CROWDBENCH_HOME", str(tmp_path))
    monkeypatch.setattr(across, "learn", None)
    arguments = ["across", "eth-v0", "hotel-v0", "zara1-v0", "--out", str(tmp_path / "out")]
    assert main(arguments) == 2
    assert "recording eth: got no imported table" in capsys.readouterr().err


def test_fewer_than_three_scenes_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["across", "eth-v0", "hotel-v0"]) == 2
    assert "scenes: got eth-v0 hotel-v0; expected three or more" in capsys.readouterr().err
