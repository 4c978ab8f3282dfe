"""What the README says runs, and what it prints is what comes out."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pages
import pytest
from conftest import need_imitation
from servers import serving
from submissions import FOLDS, fill_in, write_network

from crowdbench.cli import main
from crowdbench.leaderboard.verification.entry import read_entry
from crowdbench.recordings.catalogue import SOURCES

README = (Path(__file__).parents[2] / "README.md").read_text()
SCENES = Path(__file__).parents[2] / "scenes"


def test_the_first_example_runs_to_the_end_and_scores(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(pages.blocks(README, "python")[0], "README", "exec"), {})
    assert "inter_spawn" in capsys.readouterr().out


def test_the_torchrl_example_trains(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(pages.block_with(README, "CrowdEnv("), "README", "exec"), {})
    reward = float(capsys.readouterr().out.split()[0])
    assert reward > 0.1  # a random policy comes no nearer, and pays for its effort


# imitation logs tensors that know their gradient.
@pytest.mark.filterwarnings("ignore:Converting a tensor with requires_grad")
def test_the_imitation_example_trains(capsys: pytest.CaptureFixture[str]) -> None:
    need_imitation()
    exec(compile(pages.block_with(README, "demonstrations("), "README", "exec"), {})
    reward = float(capsys.readouterr().out.split()[0])
    assert reward > 5  # metres nearer to the goal


@pytest.fixture
def published_eth(opentraj: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A server on loopback publishes the real recording instead of its own."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with serving() as server:
        server.files["/obsmat.txt"] = (opentraj / SOURCES["eth"].path).read_bytes()
        here = replace(SOURCES["eth"], address=f"{server.address}/obsmat.txt")
        monkeypatch.setitem(SOURCES, "eth", here)
        yield


def test_every_command_runs_in_the_order_of_the_page(
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
    for command in pages.commands(README):
        if command.split()[1] in ("submit", "leaderboard"):  # a test of their own
            continue
        # Where the page is read: in a clone, with recordings somewhere.
        there = command.replace("path/to/OpenTraj", str(opentraj)).replace("scenes/", f"{SCENES}/")
        arguments = shlex.split(there)[1:]
        if arguments[0] == "evaluate":  # the next test makes all its rollouts
            arguments += ["--seeds", "1"]
        if arguments[0] == "fit":  # tests of their own hold the network's fits
            arguments += ["--models", "poisson-gmm", "poisson-groups", "renewal-gmm"]
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"


def test_a_trained_policy_gets_to_a_page_of_the_leaderboard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CROWDBENCH_HOME", str(tmp_path / "home"))
    (block,) = (block for block in pages.blocks(README, "sh") if "submit init" in block)
    trained, *commands = block.splitlines()
    scene, folder = "plaza-v0", Path("results/ppo-plaza-v0")
    assert trained == f"python -m baselines.ppo --scene {scene} --parts fold0 fold1 fold2"
    for part in FOLDS:  # as it writes them; tests of its own train it
        write_network(folder / f"{part}.onnx", part)
    for command in commands:
        arguments = shlex.split(command.split("#")[0])[1:]
        if arguments[:2] == ["submit", "check"]:
            assert main(arguments) == 2
            assert ": 4 problems." in capsys.readouterr().err
            fill_in(Path("my-walker"))
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"
    entry = read_entry(Path("results/leaderboard/entries/my-walker.json"))
    assert entry.status == "ranked"
    assert set(entry.scenes[scene].families) == {"motion", "interaction"}
    page = Path("results/leaderboard/index.html").read_text()
    assert '<a href="pages/my-walker.html">' in page


def numbers(line: str) -> list[float]:
    return [float(n.replace("−", "-")) for n in re.findall(r"−?\d+\.\d+", line)]


def rows_of(text: str) -> list[str]:
    """The lines of tables of scores."""
    return [line for line in text.splitlines() if re.match(r" \S+ × \S+ ", line)]


def test_the_tables_are_those_that_its_command_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    command = next(c for c in pages.commands(README) if c.startswith("crowdbench evaluate eth-v0"))
    arguments = shlex.split(command)[1:]
    arguments[arguments.index("--out") + 1] = str(tmp_path / "out")
    assert main(arguments) == 0
    printed = rows_of(capsys.readouterr().out)
    shown = rows_of(pages.blocks(README, "text")[0])
    assert len(shown) == 24  # twice the heading, six crowds and five anchors
    for line, of_page in zip(printed, shown, strict=True):
        # Another processor rounds otherwise, and crowds are chaotic: not to the last digit.
        assert numbers(line) == pytest.approx(numbers(of_page), abs=0.03)
        assert re.sub(r"−?\d+\.\d+", "", line).split() == (
            re.sub(r"−?\d+\.\d+", "", of_page).split()
        )
