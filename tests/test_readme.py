"""What the README says runs, and what it prints is what comes out."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pages
import pytest
from conftest import need_imitation
from servers import serving

from crowdbench.cli import main
from crowdbench.recordings.catalogue import SOURCES

README = (Path(__file__).parents[1] / "README.md").read_text()
SCENES = Path(__file__).parents[1] / "scenes"


def blocks(language: str) -> list[str]:
    return pages.blocks(README, language)


def commands() -> list[str]:
    return pages.commands(README)


def test_the_first_example_runs_to_the_end_and_scores(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(blocks("python")[0], "README", "exec"), {})
    assert "inter_spawn" in capsys.readouterr().out


def block_with(words: str) -> str:
    """The only Python block of the page that has these words in it."""
    (found,) = (block for block in blocks("python") if words in block)
    return found


@pytest.mark.parametrize(
    ("words", "file"), [("class Slow", "slow.py"), ("class Clockwork", "clock.py")]
)
def test_a_class_of_ones_own_is_evaluated(tmp_path: Path, words: str, file: str) -> None:
    (tmp_path / file).write_text(block_with(words))
    asked = re.search(rf"`(crowdbench evaluate [^`]*{file[:-3]}:[^`]*)`", README)
    assert asked is not None
    script = Path(sys.executable).with_name("crowdbench")
    command = [str(script), *shlex.split(asked[1])[1:], "--seeds", "2", "--workers", "2"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "written to" in done.stdout


def test_the_torchrl_example_trains(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(block_with("CrowdEnv("), "README", "exec"), {})
    reward = float(capsys.readouterr().out.split()[0])
    assert reward > 0.1  # a random policy comes no nearer, and pays for its effort


# imitation logs tensors that know their gradient.
@pytest.mark.filterwarnings("ignore:Converting a tensor with requires_grad")
def test_the_imitation_example_trains(capsys: pytest.CaptureFixture[str]) -> None:
    need_imitation()
    exec(compile(block_with("demonstrations("), "README", "exec"), {})
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
    Path("walkers.py").write_text(block_with("class Walker"))
    for command in commands():
        # Where the page is read: in a clone, with recordings somewhere.
        there = command.replace("path/to/OpenTraj", str(opentraj)).replace("scenes/", f"{SCENES}/")
        arguments = shlex.split(there)[1:]
        if arguments[0] == "evaluate":  # the next test makes all its rollouts
            arguments += ["--seeds", "1"]
        if arguments[0] == "fit":  # tests of their own hold the network's fits
            arguments += ["--models", "poisson-gmm", "renewal-gmm"]
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"


def numbers(line: str) -> list[float]:
    return [float(n.replace("−", "-")) for n in re.findall(r"−?\d+\.\d+", line)]


def test_the_table_is_the_one_that_its_command_prints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = next(c for c in commands() if c.startswith("crowdbench evaluate eth-v0"))
    arguments = shlex.split(command)[1:]
    arguments[arguments.index("--out") + 1] = str(tmp_path / "out")
    assert main(arguments) == 0
    printed = {line[:30]: line for line in capsys.readouterr().out.splitlines() if "×" in line}
    shown = [line for line in blocks("text")[0].splitlines() if "×" in line]
    assert len(shown) == 12  # the heading, six crowds and five anchors
    for line in shown:
        # Another processor rounds otherwise, and crowds are chaotic: not to the last digit.
        assert numbers(printed[line[:30]]) == pytest.approx(numbers(line), abs=0.03)
        assert re.sub(r"−?\d+\.\d+", "", printed[line[:30]]).split() == (
            re.sub(r"−?\d+\.\d+", "", line).split()
        )
