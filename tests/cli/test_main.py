"""The command line: results on stdout, a user's error as one message and exit code 2."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cyclopts import App

from crowdbench import __version__, recording_of, rollout
from crowdbench.cli import app, main, version
from crowdbench.cli.leaderboard import SandboxLimits
from crowdbench.cli.options import OwnFile
from crowdbench.crowds import score
from crowdbench.data.recordings.catalogue import SOURCES
from crowdbench.data.storage import read, write_csv
from crowdbench.files import revision
from crowdbench.registry.spawn_models import SPAWN_MODELS
from crowdbench.scene import list_scenes, load_scene
from crowdbench.spawn.plaza import STOPPING
from studies.__main__ import app as studies

Printed = pytest.CaptureFixture[str]
COMMANDS = (
    *("evaluate", "exam", "robots", "score", "view", "record", "spawn", "policy", "scene"),
    *("data", "submit", "leaderboard"),
)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A crowd as another simulator writes it: two people at a time cross ETH's scene."""
    frame = np.arange(1934)
    columns = [frame // 20, frame, -7.0 + (frame % 20) * 0.5, np.full(len(frame), 5.0)]
    path = tmp_path / "mine.csv"
    lines = [",".join(str(v) for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join(["person_id,frame,x,y", *lines]))
    return path


def test_scenes_are_listed(capsys: Printed) -> None:
    assert main(["scene", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list_scenes()
    assert all(line.endswith(load_scene(line.split()[0]).title) for line in lines)
    assert {"eth-v0", "forum-v0", "gc-v0", "hotel-v0", "plaza-v0", "zara1-v0"} <= {*list_scenes()}


def test_a_table_is_scored(table: Path, capsys: Printed) -> None:
    assert main(["score", "eth-v0", str(table)]) == 0
    out = capsys.readouterr().out
    assert "mine.csv on eth-v0: 97 persons" in out
    assert "nan" not in out
    assert "0: equal" in out
    for name, result in score("eth-v0", read(table, scene="eth-v0", dt_s=0.4)).items():
        cells = f"{name.replace('_', ' ')} .*{result.distance:.3f} .*{result.n}"
        assert re.search(cells, out), name


def test_a_scene_can_be_named_by_its_folder(table: Path, capsys: Printed) -> None:
    assert main(["score", str(load_scene("eth-v0").folder), str(table)]) == 0
    assert "on eth-v0" in capsys.readouterr().out


@pytest.mark.long
def test_a_replay_is_the_recording(opentraj: Path, tmp_path: Path, capsys: Printed) -> None:
    assert main(["data", "import", "eth", "--source", str(opentraj)]) == 0
    capsys.readouterr()
    pair = ["--spawn", "replay", "--policy", "replay"]
    assert main(["evaluate", "eth-v0", *pair, "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert re.search(r"identical +360 paths", out)
    assert re.search(r"replay × replay .* 1\.00 +1\.00", out)  # motion and interaction
    (entry,) = json.loads((tmp_path / "out" / "scorecard.json").read_text())["entries"]
    distances = [d for m in entry["metrics"].values() for d in m["distances"]]
    assert max(distances) < 1e-6  # sums of floats


@pytest.mark.parametrize(("name", "persons"), [("eth", 360), ("hotel", 390), ("zara01", 148)])
def test_recordings_are_imported_and_described(
    opentraj: Path, name: str, persons: int, capsys: Printed
) -> None:
    assert main(["data", "import", name, "--source", str(opentraj)]) == 0
    imported = capsys.readouterr().out
    assert re.search(rf"persons +{persons}\n", imported)
    assert "Cite: " in imported
    assert main(["data", "describe", name]) == 0
    assert re.search(rf"persons +{persons}\n", capsys.readouterr().out)


def test_the_folder_of_recordings_can_be_named_by_the_environment(
    opentraj: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CROWDBENCH_DATA", str(opentraj))
    assert main(["data", "import", "zara01"]) == 0


def test_the_list_tells_what_is_imported(opentraj: Path, capsys: Printed) -> None:
    main(["data", "import", "hotel", "--source", str(opentraj)])
    capsys.readouterr()
    assert main(["data", "list"]) == 0
    printed = capsys.readouterr().out
    lines = [re.split(r"  +", line.strip()) for line in printed.splitlines() if "-v0" in line]
    assert lines == [
        ["eth", "eth-v0", "not imported", SOURCES["eth"].path],
        ["hotel", "hotel-v0", "imported", SOURCES["hotel"].path],
        ["zara01", "zara1-v0", "not imported", SOURCES["zara01"].path],
        ["gc", "gc-v0", "not imported", SOURCES["gc"].path],
        ["forum", "forum-v0", "not imported", SOURCES["forum"].path],
        ["plaza", "plaza-v0", "always available", "generated"],
    ]
    root = printed.split("OpenTraj, ")[1].split()[0]
    assert SOURCES["gc"].address == f"{root}/{SOURCES['gc'].path}"


@pytest.mark.parametrize("scene", list_scenes())
def test_areas_are_listed_without_goals_that_nobody_has(scene: str, capsys: Printed) -> None:
    assert main(["spawn", "areas", scene]) == 0
    out = capsys.readouterr().out
    assert "(100)" in out or re.search(r"\d \(\d+\)", out)
    assert "(0)" not in out


def test_a_scene_is_fitted_into_another_folder(tmp_path: Path, capsys: Printed) -> None:
    models = ["--models", "poisson-gmm", "renewal-gmm"]
    assert main(["scene", "fit", "plaza-v0", "--out", str(tmp_path), *models]) == 0
    assert re.search(rf"written to +{re.escape(str(tmp_path))}", capsys.readouterr().out)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *("areas.json", "plans.json", "poisson-gmm.json"),
        *("reference.json.gz", "renewal-gmm.json", "scene.toml"),
    ]  # fmt: skip


BAD = {
    "unknown scene": (["score", "moon-v0", "{mine}"], "moon-v0"),
    "no table": (["score", "eth-v0", "{tmp}/none.csv"], "no such file"),
    "no kind of table": (["score", "eth-v0", "{tmp}/note.txt"], "expected .parquet or .csv"),
    "a table of another kind": (["score", "eth-v0", "{tmp}/other.csv"], "a column person_id"),
    "a table too short": (["score", "plaza-v0", "{mine}"], "as long as the recording"),
    "a recording not imported": (["data", "describe", "eth"], "crowdbench data fetch eth"),
    "an unknown recording": (["data", "describe", "moon"], "one of eth, hotel, zara01"),
    "an empty folder": (
        ["data", "import", "eth", "--source", "{tmp}"],
        "Run `crowdbench data fetch eth`, or copy https://",
    ),
    "no folder": (["data", "import", "eth"], "CROWDBENCH_DATA"),
    "unknown policy": (["evaluate", "eth-v0", "--policy", "crawl"], "one of straight"),
    "unknown spawn model": (
        ["evaluate", "eth-v0", "--spawn", "no_such_module:Model"],
        "No module named 'no_such_module'",
    ),
    "no seeds": (["evaluate", "eth-v0", "--seeds", "0"], "seeds: got 0"),
    "no workers": (["evaluate", "eth-v0", "--workers", "0"], "workers: got 0"),
    "replayed strangers": (["evaluate", "eth-v0", "--policy", "replay"], "spawn model replay"),
    "nothing to fit to": (["scene", "fit", "eth-v0"], "crowdbench data import eth"),
    "no place to evaluate to": (
        ["evaluate", "eth-v0", "--policy", "straight", "--seeds", "1", "--out", "{mine}/x"],
        "Choose another folder",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_a_users_error_is_a_message_and_exit_code_2(
    what: str, table: Path, tmp_path: Path, capsys: Printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CROWDBENCH_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "note.txt").touch()
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    arguments, message = BAD[what]
    assert main([a.format(mine=table, tmp=tmp_path) for a in arguments]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("crowdbench: ")
    assert message in printed
    assert "Traceback" not in printed


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["evalute"], 'Unknown command "evalute". Did you mean "evaluate"?'),
        (["scene", "lst"], 'Unknown command "lst". Did you mean "list"?'),
        (["evaluate", "eth-v0", "--polcy", "straight"], "--polcy. Did you mean --policy?"),
        (["evaluate", "eth-v0", "--protocol", "held"], 'Choose from: "full", "heldout".'),
        (["evaluate", "eth-v0", "--seeds", "some"], 'unable to convert "some" into int.'),
        (["evaluate", "eth-v0", "--policy"], "--policy requires at least 1 element. Got 0."),
        (["evaluate", "eth-v0", "straight"], "Unexpected argument: straight."),
        (["evaluate"], "SCENE requires an argument."),
        (["score", "eth-v0"], "TABLES requires an argument."),
        (["spawn", "sample", "plaza-v0"], "--out requires an argument."),
    ],
)
def test_a_command_that_cannot_be_read_is_one_message_and_exit_code_2(
    arguments: list[str], told: str, capsys: Printed
) -> None:
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("crowdbench: ")
    assert told in line
    command = " ".join(arguments[: 2 if arguments[0] == "spawn" else 1])
    known = {"evalute": "crowdbench --help", "scene": "crowdbench scene --help"}
    assert line.endswith(f"Run `{known.get(command, f'crowdbench {command} --help')}`.")


@pytest.mark.parametrize(
    ("typed", "name", "value"),
    [
        ("scene fit plaza-v0 --models --epochs 2", "models", []),
        ("evaluate plaza-v0 --policy straight random --seeds 2", "policy", ["straight", "random"]),
        ("evaluate plaza-v0 --seeds 2 --seeds 3", "seeds", 3),
        ("score plaza-v0 a.csv b.csv --json -", "tables", [Path("a.csv"), Path("b.csv")]),
        ("data import yard --format gc", "how", OwnFile(layout="gc")),
        ("leaderboard verify a b --out c --memory-gib 2", "at_most", SandboxLimits(memory_gib=2.0)),
    ],
)
def test_words_are_read_as_values(typed: str, name: str, value: object) -> None:
    _, bound, _ = app.parse_args(typed.split(), exit_on_error=False, print_error=False)
    assert bound.arguments[name] == value


@pytest.mark.parametrize("arguments", [[], ["data"], ["--help"], ["data", "--help"]])
def test_help_is_shown_to_who_asks_and_to_who_names_no_command(
    arguments: list[str], capsys: Printed
) -> None:
    asked = "--help" in arguments
    assert main(arguments) == (0 if asked else 2)
    printed = capsys.readouterr()
    assert (printed.err if asked else printed.out) == ""
    told = printed.out if asked else printed.err
    commands = ("fetch", "import", "list", "describe") if "data" in arguments else COMMANDS
    assert all(re.search(rf"^│ {command} ", told, re.M) for command in commands)


def test_the_help_has_twelve_commands_by_purpose(capsys: Printed) -> None:
    assert main(["--help"]) == 0
    told = capsys.readouterr().out
    use, make, publish = (told.index(f"─ {name} ") for name in ("Use", "Make", "Publish"))
    found = {name: told.index(f"│ {name} ") for name in COMMANDS}
    assert use < min(found[name] for name in ("evaluate", "exam", "score", "view", "record"))
    assert make < min(found[name] for name in ("spawn", "policy", "scene", "data"))
    assert publish < min(found[name] for name in ("submit", "leaderboard"))
    assert len(re.findall(r"^│ \w+ ", told, re.M)) == len(COMMANDS) == 12


def commands_of(group: App) -> list[App]:
    """All commands of a program, those of its groups included."""
    return [
        command
        for name in group
        if not name.startswith("-")
        for command in (group[name], *commands_of(group[name]))
    ]


def test_every_command_and_option_has_a_help_text() -> None:
    for command in (*commands_of(app), *commands_of(studies)):
        assert command.help, command.name
        if command.default_command is not None:
            for argument in command.assemble_argument_collection(parse_docstring=True):
                of_group = argument.name == "*"  # whose options have help texts of their own
                assert of_group or argument.parameter.help, (command.name, argument.name)


def test_completion_knows_commands_and_options() -> None:
    script = app.generate_completion(shell="bash")
    assert all(word in script for word in (*COMMANDS, "steer", "--policy", "heldout"))


def test_a_glance_at_the_command_line_imports_no_numpy() -> None:
    code = (
        "import sys; from crowdbench.cli import main\n"
        "main(['--help']), main(['evaluate', '--help']), main(['scene', 'lst'])\n"
        "print('numpy' in sys.modules, 'crowdbench.scene' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("False False\n")


def started(*arguments: str) -> "subprocess.Popen[str]":
    path = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-m", "crowdbench", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(path)},
    )


def test_it_runs_as_a_module() -> None:
    process = started("--version")
    assert process.communicate()[0].startswith(f"crowdbench {__version__}")
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("told", "commit"),
    [
        ('{"vcs_info": {"vcs": "git", "commit_id": "0123456789abcdef"}}', " (0123456789ab)"),
        ('{"url": "file:///x", "dir_info": {}}', ""),
        (None, ""),
        ("[]", ""),
    ],
)
def test_the_version_tells_the_commit(
    told: str | None, commit: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(version, "_ROOT", tmp_path)
    installed = SimpleNamespace(read_text=lambda name: told)
    monkeypatch.setattr(metadata, "distribution", lambda name: installed)
    assert version.described_version() == f"crowdbench {__version__}{commit}"


def test_the_version_of_a_clone_tells_its_commit() -> None:
    said = version.described_version()
    commit = revision(version._ROOT)
    assert said == f"crowdbench {__version__}" + (f" ({commit})" if commit else "")


def test_a_process_ends_with_exit_code_2_and_no_traceback() -> None:
    process = started("evaluate", "moon-v0")
    out, err = process.communicate()
    assert (process.returncode, out) == (2, "")
    assert err.startswith("crowdbench: scene: got 'moon-v0'")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("arguments", [["scene", "list"], ["spawn", "areas", "eth-v0"], ["--help"]])
def test_output_that_nobody_reads_ends_quietly(arguments: list[str]) -> None:
    with started(*arguments) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()  # before anything is printed
        assert process.stderr.read() == ""
    assert process.returncode == 1


@pytest.mark.parametrize(
    ("number", "code", "told"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "stopped")],
)
def test_who_is_told_to_stop_says_so_by_its_exit_code_and_leaves_no_half_file(
    number: int, code: int, told: str, tmp_path: Path
) -> None:
    process = started(
        "evaluate", "plaza-v0", "--spawn", "poisson-gmm", "--policy", "given:Announcing",
        "--seeds", "10000", "--workers", "1", "--out", str(tmp_path),
    )  # fmt: skip
    assert process.stdout is not None
    while process.stdout.readline() not in ("walking\n", ""):
        pass
    process.send_signal(number)
    _, err = process.communicate()
    assert (process.returncode, err) == (code, f"crowdbench: {told}\n")
    assert list(tmp_path.rglob(".*")) == []
    assert not (tmp_path / "scorecard.json").exists()


def test_a_sample_of_a_spawn_model_is_written_for_other_programs(
    tmp_path: Path, capsys: Printed
) -> None:
    from pyarrow import csv, parquet

    asked = ["spawn", "sample", "plaza-v0", "--out"]
    assert main([*asked, str(tmp_path / "a.csv"), "--model", "replay"]) == 0
    assert "do not publish" not in capsys.readouterr().out  # the plaza is nobody's recording
    recorded = csv.read_csv(tmp_path / "a.csv")
    recording = recording_of("plaza-v0")
    assert recorded.num_rows == len(recording)
    np.testing.assert_allclose(recorded["goal_x"], recording.goal_x, atol=1e-3)
    np.testing.assert_allclose(recorded["time_s"], recording.requested_s)
    stopped = 1 - recorded["via_x"].null_count / len(recording)
    assert stopped == pytest.approx(STOPPING, abs=0.03)
    assert main([*asked, str(tmp_path / "b.parquet"), "--seed", "1"]) == 0
    drawn = parquet.read_table(tmp_path / "b.parquet")
    assert drawn.num_rows > 100
    assert drawn["time_s"].to_numpy().max() < 1800
    short = [*asked, str(tmp_path / "d.csv"), "--model", "poisson-gmm", "--horizon-s", "600"]
    assert main(short) == 0
    assert 500 < csv.read_csv(tmp_path / "d.csv")["time_s"].to_numpy().max() < 600
    assert main(["data", "arrivals", "plaza-v0", "--out", str(tmp_path / "e.csv")]) == 0
    assert (tmp_path / "e.csv").read_bytes() == (tmp_path / "a.csv").read_bytes()
    for more, said in (
        ([*short, "--horizon-s", "0"], "got 0.0; expected a positive number of seconds"),
        ([*asked, str(tmp_path / "c.txt")], "expected .csv, .parquet or .json"),
        ([*asked, str(tmp_path / "c.csv"), "--seed", "-1"], "got -1; expected 0 or more"),
    ):
        assert main(more) == 2
        assert said in capsys.readouterr().err


def test_arrivals_of_a_recording_are_not_to_be_published(
    opentraj: Path, tmp_path: Path, capsys: Printed
) -> None:
    assert main(["data", "import", "eth", "--source", str(opentraj)]) == 0
    asked = ["spawn", "sample", "eth-v0", "--out", str(tmp_path / "a.csv"), "--model"]
    for model, copied in (("replay", True), ("block-replay", True), ("poisson-gmm", False)):
        capsys.readouterr()
        assert main([*asked, model]) == 0
        assert ("do not publish" in capsys.readouterr().out) == copied


def test_tables_that_cannot_be_scored_are_named(tmp_path: Path, capsys: Printed) -> None:
    crowd = rollout("plaza-v0", "poisson-gmm", "straight", seed=0)
    fine, far = tmp_path / "fine.csv", tmp_path / "far.csv"
    write_csv(crowd, fine)
    write_csv(replace(crowd, xy=crowd.xy + np.float32(1000)), far)
    assert main(["score", "plaza-v0", str(fine), str(far)]) == 2
    err = capsys.readouterr().err
    assert "far.csv: got 100% of the positions outside plaza-v0" in err
    assert main(["score", "plaza-v0", str(fine), str(fine)]) == 2
    assert "a file that is named twice" in capsys.readouterr().err


def test_the_help_of_evaluate_names_all_spawn_models(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--help"]) == 0
    text = re.sub(r"-\s*│\n│\s+", "-", capsys.readouterr().out)  # lines may end at a hyphen
    assert set(SPAWN_MODELS) <= set(re.split(r"[\s,;()]+", text))
