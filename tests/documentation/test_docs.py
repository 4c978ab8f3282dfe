"""What the pages of documentation say runs, and what they point to is there."""

import re
import shlex
import subprocess
import sys
from contextlib import suppress
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pages
import pytest
from conftest import need, need_imitation, need_sb3
from cyclopts import MissingArgumentError

import crowdbench
from crowdbench import rollout
from crowdbench.cli import app, main
from crowdbench.data.table import OUTCOMES, PERSON_COLUMNS
from crowdbench.leaderboard.scores import View, scores
from crowdbench.leaderboard.verification.entry import read_entry
from crowdbench.policies import StateView
from studies.__main__ import app as studies

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])
LINKING = [
    *PAGES,
    ROOT / "CONTRIBUTING.md",
    ROOT / "leaderboard/RULES.md",
    ROOT / "baselines/README.md",
]
BASELINES = (DOCS / "baselines.md").read_text()
CROWDS = ROOT / "leaderboard" / "entries" / "cox-plans-anticipate.json.gz"


def page(name: str) -> str:
    return (DOCS / name).read_text()


def run_example(name: str, words: str) -> dict[str, Any]:
    """The names that a page's example with these words defines."""
    world: dict[str, Any] = {"np": np}
    exec(compile(pages.block_with(page(name), words), name, "exec"), world)
    return world


def linked(path: Path) -> set[tuple[str, str]]:
    """What a page points to in the repository, pictures included: files and sections."""
    found = re.findall(r"\]\(([^)#]*)(?:#([^)]*))?\)", path.read_text())
    return {(link, section) for link, section in found if "://" not in link}


def sections(path: Path) -> set[str]:
    """The names by which links call the sections of a page."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(), re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", LINKING, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_a_page_points_to_is_there(path: Path) -> None:
    for link, section in linked(path):
        target = path.parent / link if link else path
        assert target.exists(), link
        assert not section or section in sections(target), f"{link}#{section}"


def test_the_table_of_contents_lists_every_page() -> None:
    listed = {(DOCS / link).resolve() for link, _ in linked(DOCS / "README.md")}
    assert {p.resolve() for p in PAGES} - {DOCS / "README.md"} <= listed


def test_the_rewards_to_compare_with_are_those_of_the_page(
    capsys: pytest.CaptureFixture[str],
) -> None:
    run_example("reinforcement-learning.md", "reference_rewards")
    assert capsys.readouterr().out in page("reinforcement-learning.md")


def test_the_examples_of_the_page_on_environments_run_in_their_order() -> None:
    world: dict[str, Any] = {}
    first, *others = pages.blocks(page("environment.md"), "python")
    exec(compile(first, "environment.md", "exec"), world)
    assert world["observations"]
    for example in others:
        exec(compile(example, "environment.md", "exec"), world)
    assert world["near"] <= 0
    assert world["env"].spawn.name == "ntpp-gmm"


@pytest.mark.long
def test_the_page_on_python_runs_from_top_to_bottom_and_prints_what_it_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    world: dict[str, object] = {}
    for block in pages.blocks(page("python.md"), "python"):
        exec(compile(block, "python.md", "exec"), world)
    printed = capsys.readouterr().out
    for shown in pages.blocks(page("python.md"), "text"):
        assert pages.differences(shown, printed) == []
    assert "expected one of poisson-gmm" in printed


@pytest.mark.long
@pytest.mark.usefixtures("no_report")
def test_the_main_job_prints_the_tables_of_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "88")  # of a terminal for which the table is divided
    command = pages.commands(page("evaluation.md"))[0]
    assert f"\t$(BIN)/{command}\n" in (ROOT / "Makefile").read_text()
    assert main(shlex.split(command)[1:]) == 0
    (shown,) = pages.blocks(page("evaluation.md"), "text")
    assert pages.differences(shown, capsys.readouterr().out) == []


def test_the_example_of_flow_and_density_runs(capsys: pytest.CaptureFixture[str]) -> None:
    need(find_spec("pedpy"), "the extra pedpy")
    run_example("evaluation.md", "flow_through(")
    flow, speed = (float(line.split()[0]) for line in capsys.readouterr().out.splitlines())
    assert 0.005 < flow < 0.05
    assert 0.7 < speed < 1.3


def test_the_page_on_metrics_counts_those_of_each_scene() -> None:
    text = " ".join(page("metrics.md").split())
    assert "So Zara and the plaza have twenty-nine metrics, ETH and Hotel twenty-eight." in text
    assert "twenty-eight on ETH" in page("evaluation.md")
    expected = {"eth-v0": 28, "hotel-v0": 28, "zara1-v0": 29, "plaza-v0": 29}
    for scene, number in expected.items():
        crowd = rollout(scene, "poisson-gmm", "straight", seed=0)
        assert len(crowdbench.score(scene, crowd)) == number, scene
    assert len(crowdbench.METRICS) == 30


SCENES = {"ETH": "eth-v0", "Grand Central": "gc-v0", "Forum": "forum-v0", "Hotel": "hotel-v0"}
SCENES |= {"Zara": "zara1-v0"}


def family(name: str, scene: str, asked: str) -> float:
    entry = read_entry(ROOT / "leaderboard" / "entries" / f"{name}.json.gz")
    return entry.scenes[scene].families[asked].value


def test_the_scores_of_anticipate_are_those_of_its_entries() -> None:
    rows = re.findall(r"^\| ([A-Z][\w ]+) \| ([\d.]+) \[.*?\] \|(.*)\| \d+ s \|$", BASELINES, re.M)
    assert {row[0] for row in rows} == set(SCENES)
    for place, walk, others in rows:
        families = [family("anticipate", SCENES[place], f) for f in ("motion", "interaction")]
        crowd = [
            family("cox-plans-anticipate", SCENES[place], f)
            for f in read_entry(CROWDS).scenes[SCENES[place]].families
            if f not in ("motion", "interaction")
        ]
        overall = (min(families) + float(np.mean(crowd))) / 2
        shown = [float(walk), *map(float, others.split("|"))]
        expected = [min(families), *families, overall]
        assert shown == pytest.approx(expected, abs=0.006), place


def test_the_scores_of_bc_and_gail_are_those_of_their_entries() -> None:
    rows = re.findall(
        r"^\| ([A-Z][\w ]+)? ?\| `(bc|gail)` \| (\S+) \| (\S+) \| (\S+) \[.*\] \|$", BASELINES, re.M
    )
    assert [row[1] for row in rows] == ["bc", "gail"] * 3
    place = ""
    for named, name, *shown in rows:
        place = named.strip() or place
        families = [family(name, SCENES[place], f) for f in ("motion", "interaction")]
        entry = read_entry(ROOT / "leaderboard" / "entries" / f"{name}.json.gz")
        walk = scores(entry)[View(scene=SCENES[place])].value  # at most 0 beyond the gate
        values = [float(value.replace("−", "-")) for value in shown]
        assert values == pytest.approx([*families, walk], abs=0.006), (place, name)


@pytest.mark.parametrize(
    ("shown", "printed", "expected"),
    [
        ("a  0.50 [0.30, −0.66]", "x\n a 0.51 [0.28, −0.68] \n", 0),
        ("a  0.50 [0.30, −0.66]", "a 0.53 [0.30, −0.66]", 1),
        ("a  0.50 [0.30, −0.66]", "a 0.50 [0.30, 0.66]", 1),
        ("417 persons, 0.4 s", "416 persons, 0.4 s", 1),
        ("416 persons, 0.4 s", "416 persons, 0.4 s", 0),
        ("1332.5 people", "1330.0 people", 0),
        ("1332.5 people", "1300.0 people", 1),
        ("eth-v0 0.1", "eth-v1 0.1", 1),
        ("a 0.1\nb 0.2", "b 0.2\na 0.1", 1),
        ("a 1.0 %", "a –", 1),
    ],
)
def test_numbers_of_pages_are_compared(shown: str, printed: str, expected: int) -> None:
    assert len(pages.differences(shown, printed)) == expected


def test_the_page_on_python_names_every_outcome_and_column() -> None:
    listed = re.findall(r"^\| (\d) \| `(\w+)` \|", page("python.md"), re.M)
    assert [(int(k), name) for k, name in listed] == list(enumerate(OUTCOMES))
    (table,) = re.findall(r"\| column .*?\n\n", page("python.md"), re.S)
    columns = re.findall(r"`(\w+)`", table)
    assert set(columns) >= {"person_id", "first", "last", *PERSON_COLUMNS}


def test_a_class_that_sees_the_state_walks_as_fast_as_people_prefer() -> None:
    world = run_example("policies.md", "class Direct")
    crowd = rollout("plaza-v0", "poisson-gmm", world["Direct"](), seed=0, horizon_s=60.0)
    arrived = crowd.outcome == OUTCOMES.index("goal")
    assert arrived.sum() > 10
    assert 1.0 < np.nanmedian(crowd.mean_speeds()) < 1.6


def test_a_class_with_a_memory_walks_people_who_tire() -> None:
    world = run_example("policies.md", "class Tired")
    crowd = rollout("plaza-v0", "poisson-gmm", world["Tired"](), seed=0, horizon_s=40.0)
    assert (crowd.outcome == OUTCOMES.index("goal")).sum() > 5


@pytest.mark.parametrize(
    ("words", "package", "settings"),
    [
        ("parallel_env(", "torch", ('"full", 20', '"full", 2')),
        ("SlotEnv(", "torchrl", ('"full", 40', '"full", 2')),
    ],
)
def test_a_recurrent_network_is_trained_and_exported(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: str,
    package: str,
    settings: tuple[str, str],
) -> None:
    pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    world: dict[str, Any] = {}
    text = page("reinforcement-learning.md")
    example = pages.block_with(text, words)
    assert settings[0] in example
    blocks = [
        pages.block_with(text, "class Recurrent"),
        example.replace(*settings),
        pages.block_with(text, "export_policy("),
    ]
    for block in blocks:
        exec(compile(block, "reinforcement-learning.md", "exec"), world)
    assert len(capsys.readouterr().out.splitlines()) == 2
    crowd = rollout("plaza-v0", "poisson-gmm", "results/gru/full.onnx", seed=0, horizon_s=20.0)
    assert len(crowd) > 5


def test_the_fields_of_the_state_are_those_that_the_page_lists() -> None:
    (table,) = re.findall(r"\| field .*?\n\n", page("policies.md"), re.S)
    first_cells = " ".join(line.split("|")[1] for line in table.strip().splitlines())
    assert set(re.findall(r"`(\w+)`", first_cells)) == {f.name for f in fields(StateView)}


@pytest.mark.nightly
# imitation logs tensors that know their gradient.
@pytest.mark.filterwarnings("ignore:Converting a tensor with requires_grad")
def test_the_imitation_example_trains(capsys: pytest.CaptureFixture[str]) -> None:
    need_imitation()
    run_example("imitation.md", "imitation.algorithms")
    reward = float(capsys.readouterr().out.split()[0])
    assert reward > 5  # metres nearer to the goal


def test_the_example_of_a_score_on_training_blocks_runs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    run_example("imitation.md", "validate(")
    walk, arrive, _ = capsys.readouterr().out.split(",")
    assert -1 <= float(walk) <= 1
    assert float(arrive.split("%")[0]) > 50


@pytest.mark.nightly
def test_the_recurrent_example_trains_and_walks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    need_sb3()
    monkeypatch.chdir(tmp_path)
    run_example("reinforcement-learning.md", "RecurrentPPO")
    reward, waiting = capsys.readouterr().out.splitlines()
    assert float(reward.split()[0]) > 5  # metres nearer to the goal
    assert float(waiting.split("%")[0]) < 1
    export, evaluate = pages.commands(page("reinforcement-learning.md"))
    assert main(shlex.split(export)[1:]) == 0
    quick = ["--seeds", "1", "--spawn", "poisson-gmm"]
    assert main([*shlex.split(evaluate)[1:], *quick]) == 0
    assert "× recurrent" in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "words", "file"),
    [
        ("policies.md", "class Slow", "slow.py"),
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


@pytest.mark.long
@pytest.mark.usefixtures("no_report")  # the README's commands write it
@pytest.mark.parametrize("name", ["policies.md", "baselines.md", "spawn-models.md"])
def test_every_command_runs(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    if name == "policies.md":
        Path("walkers.py").write_text(pages.block_with(page(name), "class Walker"))
    for command in pages.commands(page(name)):
        arguments = shlex.split(command.replace("scenes/", f"{ROOT}/scenes/"))[1:]
        arguments += ["--seeds", "1"] if arguments[0] == "evaluate" else []
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_command_that_a_sentence_mentions_exists(path: Path) -> None:
    for mentioned in re.findall(r"`crowdbench\s([^`…]*)`", path.read_text()):
        # A command may be named without what it needs.
        with suppress(MissingArgumentError):
            app.parse_args(shlex.split(mentioned), print_error=False, exit_on_error=False)


@pytest.mark.parametrize("path", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_command_of_a_page_can_be_read(path: Path) -> None:
    for command in pages.commands(path.read_text().replace("\\\n", "")):
        asked = shlex.split(command)
        program, words = (app, asked[1:]) if asked[0] == "crowdbench" else (studies, asked[3:])
        program.parse_args(words, print_error=False, exit_on_error=False)


def test_every_page_of_results_says_how_it_was_made() -> None:
    for path in DOCS.glob("results/*.md"):  # tests of the command itself run it on the plaza
        assert pages.commands(path.read_text()) == [f"python -m studies results {path.stem}"]
    for path in DOCS.glob("paper/*.md"):
        assert pages.commands(path.read_text()) == [f"python -m studies paper {path.stem}"]


def test_no_page_has_commands_that_no_test_runs() -> None:
    here = {"policies.md", "baselines.md", "spawn-models.md", "reinforcement-learning.md"}
    only_trainings = {"hardware.md"}
    in_files_of_their_own = {
        *("README.md", "scenes.md", "forum.md", "steering.md", "viewer.md"),
        *("figures.md", "walks.md", "evaluation.md", "data.md", "submitting.md", "encounters.md"),
        *("cluster.md", "rollouts.md", "robots.md", "your-simulator.md"),
    }
    of_results = [*DOCS.glob("results/*.md"), DOCS / "paper.md", *DOCS.glob("paper/*.md")]
    with_commands = {
        path for path in PAGES if re.search("crowdbench|studies", "".join(blocks_of(path)))
    }
    assert {path.name for path in with_commands - set(of_results)} == (
        here | only_trainings | in_files_of_their_own
    )


def blocks_of(path: Path) -> list[str]:
    return pages.blocks(path.read_text(), "sh")
