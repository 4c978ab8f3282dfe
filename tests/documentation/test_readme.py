"""What the README and the pages that continue it say runs."""

import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pages
import pytest
from servers import serving
from submissions import FOLDS, fill_in, write_network

import crowdbench
from crowdbench.cli import main
from crowdbench.data.recordings.catalogue import SOURCES
from crowdbench.data.storage import write_csv
from crowdbench.leaderboard.verification.entry import read_entry
from studies.__main__ import main as studies_main

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_the_first_example_runs_to_the_end_and_scores(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(pages.blocks(README, "python")[0], "README", "exec"), {})
    assert "inter_spawn" in capsys.readouterr().out


@pytest.mark.nightly
def test_the_torchrl_example_trains(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(pages.block_with(README, "CrowdEnv("), "README", "exec"), {})
    reward = float(capsys.readouterr().out.split()[0])
    assert reward > 0.1  # a random policy comes no nearer, and pays for its effort


@pytest.fixture
def published_eth(opentraj: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A server on loopback publishes the real recording instead of its own."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with serving() as server:
        server.files["/obsmat.txt"] = (opentraj / SOURCES["eth"].path).read_bytes()
        here = replace(SOURCES["eth"], address=f"{server.address}/obsmat.txt")
        monkeypatch.setitem(SOURCES, "eth", here)
        yield


def test_every_command_runs_in_the_order_of_the_pages(
    tmp_path: Path,
    opentraj: Path,
    published_eth: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    frames = np.arange(1934)
    rows = [f"1,{frame},{0.005 * frame:.3f},5.0" for frame in frames]
    Path("mine.csv").write_text("\n".join(["person_id,frame,x,y", *rows]))
    texts = [README, *((ROOT / "docs" / name).read_text() for name in ("evaluation.md", "data.md"))]
    for command in (command for text in texts for command in pages.commands(text)):
        arguments = shlex.split(command.replace("path/to/OpenTraj", str(opentraj)))[1:]
        if "walked.csv" in arguments:  # by another simulator, from the recorded arrivals
            write_csv(crowdbench.rollout("eth-v0", "replay", "straight", seed=0), "walked.csv")
        if arguments[0] == "evaluate":
            arguments += ["--seeds", "1"]
        if arguments[:2] == ["scene", "fit"]:  # tests of their own hold the network's fits
            arguments += ["--models", "poisson-gmm", "poisson-groups", "renewal-gmm"]
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"


def test_a_trained_policy_gets_to_a_page_of_the_leaderboard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CROWDBENCH_HOME", str(tmp_path / "home"))
    (block,) = pages.blocks((ROOT / "docs" / "submitting.md").read_text(), "sh")
    trained, *commands = block.splitlines()
    scene, folder = "plaza-v0", Path("results/ppo-plaza-v0")
    program = "python -m crowdbench.baselines.ppo"
    assert trained == f"{program} --scene {scene} --splits fold0 fold1 fold2"
    for split in FOLDS:  # as it writes them; tests of its own train it
        write_network(folder / f"{split}.onnx", split)
    for command in commands:
        program, *arguments = shlex.split(command.split("#")[0])
        if program == "python":
            assert arguments[:2] == ["-m", "studies"]
            assert studies_main(arguments[2:]) == 0
            continue
        if arguments[:2] == ["submit", "check"]:
            assert main(arguments) == 2
            assert ": 4 problems." in capsys.readouterr().err
            fill_in(Path("my-walker"))
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"
    entry = read_entry(Path("results/leaderboard/entries/my-walker.json.gz"))
    assert entry.status == "ranked"
    assert set(entry.scenes[scene].families) == {"motion", "interaction"}
    page = Path("results/leaderboard/index.html").read_text()
    assert '<a href="pages/my-walker.html">' in page
