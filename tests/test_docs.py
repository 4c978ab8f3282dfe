"""What the pages of documentation say runs, and what they point to is there."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pages
import pytest

from crowdbench.cli import main

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])


def page(name: str) -> str:
    return (DOCS / name).read_text()


def linked(path: Path) -> set[str]:
    """What a page points to in the repository, pictures included."""
    found = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", path.read_text())
    return {link for link in found if "://" not in link}


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_a_page_points_to_is_there(path: Path) -> None:
    assert [link for link in linked(path) if not (path.parent / link).exists()] == []


def test_the_table_of_contents_lists_every_page() -> None:
    listed = {(DOCS / link).resolve() for link in linked(DOCS / "README.md")}
    assert {p.resolve() for p in PAGES} - {DOCS / "README.md"} <= listed


def test_the_environments_example_runs_to_the_end() -> None:
    (example,) = pages.blocks(page("environment.md"), "python")
    world: dict[str, object] = {}
    exec(compile(example, "environment.md", "exec"), world)
    assert world["observations"]


@pytest.mark.parametrize(
    ("name", "words", "file"),
    [
        ("training.md", "class Slow", "slow.py"),
        ("spawn-models.md", "class Clockwork", "clock.py"),
    ],
)
def test_a_class_of_ones_own_is_evaluated(tmp_path: Path, name: str, words: str, file: str) -> None:
    (tmp_path / file).write_text(pages.block_with(page(name), words))
    asked = re.search(rf"`(crowdbench evaluate [^`]*{file[:-3]}:[^`]*)`", page(name))
    assert asked is not None
    script = Path(sys.executable).with_name("crowdbench")
    command = [str(script), *shlex.split(asked[1])[1:], "--seeds", "2", "--workers", "2"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "written to" in done.stdout


@pytest.mark.parametrize("name", ["training.md", "spawn-models.md"])
def test_every_command_runs(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    if name == "training.md":
        Path("walkers.py").write_text(pages.block_with(page(name), "class Walker"))
    for command in pages.commands(page(name)):
        arguments = shlex.split(command.replace("scenes/", f"{ROOT}/scenes/"))[1:]
        arguments += ["--seeds", "1"] if arguments[0] == "evaluate" else []
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"
