"""`crowdbench submit`: from a trained network to a packed submission."""

from dataclasses import replace
from pathlib import Path

import onnx
import pytest
from onnx import TensorProto, helper
from submissions import (
    FOLDS,
    PLAZA,
    SHIPPED_FITS,
    fill_in,
    listed_submission,
    walk_submission,
    write_network,
)

from crowdbench.cli import main
from crowdbench.leaderboard.sandbox.parent import SandboxError
from crowdbench.leaderboard.submission.submission import LIMITS, check, read_submission

Printed = pytest.CaptureFixture[str]


def submit(*arguments: object) -> int:
    return main(["submit", *map(str, arguments)])


def networks(folder: Path, scene: str = "plaza-v0") -> Path:
    for split in ("full", *FOLDS):
        write_network(folder / f"{split}.onnx", split, scene)
    return folder


def test_from_a_trained_network_to_a_packed_submission(tmp_path: Path, capsys: Printed) -> None:
    folder = tmp_path / "my-walker"
    trained = networks(tmp_path / "ppo-plaza-v0")
    assert submit("init", folder, "--track", "walk", "--policy", trained) == 0
    assert f"{folder}: track walk on plaza-v0" in capsys.readouterr().out
    assert submit("check", folder) == 2
    told = capsys.readouterr().err
    assert f"crowdbench: {folder}: 4 problems.\n" in told
    assert told.count("Replace the template's placeholder.") == 4

    fill_in(folder)
    assert submit("check", folder) == 0
    out = capsys.readouterr().out
    assert "walk, learned, trained: heldout" in out
    assert "networks: 3" in out
    assert "ranked: crowdbench runs the rollouts and scores them on held-out data" in out
    submission = read_submission(folder)
    assert submission.declared.name == "my-walker"
    assert submission.declared.training.parameters == 28


def test_folders_of_several_scenes_find_their_places(tmp_path: Path) -> None:
    folder = tmp_path / "both"
    trained = [networks(tmp_path / scene, scene) for scene in ("eth-v0", "plaza-v0")]
    assert submit("init", folder, "--track", "walk", "--name", "Both", "--policy", *trained) == 0
    fill_in(folder)
    submission = read_submission(folder)
    assert submission.declared.scenes == ["eth-v0", "plaza-v0"]
    assert len(submission.layout.networks) == 6


def test_one_network_that_knows_no_scene_is_for_those_of_the_overall_score(tmp_path: Path) -> None:
    folder = tmp_path / "stranger"
    file = write_network(tmp_path / "full.onnx", "full")
    assert submit("init", folder, "--track", "walk", "--policy", file) == 0
    fill_in(folder)
    submission = read_submission(folder)
    assert submission.declared.scenes == ["eth-v0", "gc-v0", "forum-v0"]
    assert submission.declared.training.protocol == "none"


@pytest.mark.parametrize("file", SHIPPED_FITS)
def test_files_are_put_into_the_empty_places(file: str, tmp_path: Path) -> None:
    folder = tmp_path / "crowd"
    assert submit("init", folder, "--track", "crowd", "--scene", "plaza-v0") == 0
    notes = (folder / "README.md").read_text()
    fill_in(folder)
    for split in FOLDS:
        write_network(folder / "plaza-v0" / "policy" / f"{split}.onnx", split)
    (folder / "plaza-v0" / "spawn" / file).write_bytes((PLAZA.folder / file).read_bytes())
    submission = read_submission(folder)
    assert submission.status == "ranked"
    assert file in notes
    assert "fold0.onnx" in notes


def test_rollouts_are_told_by_their_number(tmp_path: Path, capsys: Printed) -> None:
    assert submit("check", listed_submission(tmp_path / "crowd")) == 0
    assert "rollouts: 3" in capsys.readouterr().out


def endless(path: Path) -> None:
    """Let a network count to 2^62 before it acts."""
    model = onnx.load(path)
    truth, number = TensorProto.BOOL, TensorProto.INT64
    model.graph.node[-1].output[0] = "before"
    body = helper.make_graph(
        [helper.make_node("Identity", [a], [b]) for a, b in (("on", "on2"), ("v", "v2"))],
        "body",
        [helper.make_tensor_value_info("i", number, []),
         helper.make_tensor_value_info("on", truth, []),
         helper.make_tensor_value_info("v", TensorProto.FLOAT, None)],
        [helper.make_tensor_value_info("on2", truth, []),
         helper.make_tensor_value_info("v2", TensorProto.FLOAT, None)],
    )  # fmt: skip
    for name, kind, value in (("times", number, 2**62), ("true", truth, 1)):
        model.graph.initializer.append(helper.make_tensor(name, kind, [], [value]))
    loop = helper.make_node("Loop", ["times", "true", "before"], ["action"], body=body)
    model.graph.node.append(loop)
    onnx.save(model, path)


@pytest.mark.long
def test_a_network_that_never_ends_is_refused(tmp_path: Path) -> None:
    folder = walk_submission(tmp_path / "walker")
    endless(folder / "plaza-v0" / "policy" / "fold0.onnx")
    with pytest.raises(SandboxError, match="walker: got more than 8 s of CPU time"):
        check(folder, replace(LIMITS, cpu_s=8))


def test_what_exists_is_not_overwritten(tmp_path: Path, capsys: Printed) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    (tmp_path / "file").write_text("mine")
    for there in (tmp_path, tmp_path / "link", tmp_path / "file"):
        assert submit("init", there, "--track", "walk") == 2
        assert "expected a new folder" in capsys.readouterr().err
    assert submit("init", tmp_path / "file" / "new", "--track", "walk") == 2
    assert "a file in place of a folder" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link"]


def test_policies_that_do_not_fit_are_refused_and_nothing_is_left(
    tmp_path: Path, capsys: Printed
) -> None:
    trained, again = networks(tmp_path / "one"), networks(tmp_path / "two")
    file = trained / "full.onnx"
    folder = tmp_path / "new"
    for arguments, told in (
        (["--track", "spawn", "--policy", trained], "track spawn uses straight walkers"),
        (["--track", "walk", "--policy", trained, again], "one folder per scene"),
        (["--track", "walk", "--policy", trained, file], "a file among 2 policies"),
        (["--track", "walk", "--policy", tmp_path / "x.onnx"], "x.onnx"),
        (["--track", "walk", "--policy", tmp_path], "got no fold0.onnx, fold1.onnx, fold2.onnx"),
        (
            ["--track", "walk", "--policy", file, "--scene", "plaza-v0"],
            "got a network trained on full of plaza-v0; expected a folder with one network per",
        ),
        (["--track", "walk", "--scene", "moon-v0"], "'moon-v0'"),
        (["--track", "walk", "--name", "a\x1b"], "got 'a\\x1b'; expected printable"),
    ):
        assert submit("init", folder, *arguments) == 2
        assert told in capsys.readouterr().err
        assert not folder.exists()
    assert {p.name for p in tmp_path.iterdir()} == {"one", "two"}


def test_the_template_names_only_what_the_track_has(tmp_path: Path) -> None:
    for track, named in (
        ("walk", ["shipped_policy"]),
        ("spawn", ["shipped_spawn"]),
        ("crowd", ["shipped_policy", "shipped_spawn"]),
    ):
        assert submit("init", tmp_path / track, "--track", track) == 0
        text = (tmp_path / track / "submission.toml").read_text()
        assert [line.split()[1] for line in text.splitlines() if "shipped_" in line] == named


def test_names_are_written_as_they_are(tmp_path: Path) -> None:
    folder = tmp_path / "named"
    trained = networks(tmp_path / "net")
    name = 'Ada\'s "best" \\ walker é'
    assert submit("init", folder, "--track", "walk", "--policy", trained, "--name", name) == 0
    fill_in(folder)
    submission = read_submission(folder)
    assert submission.declared.name == name
