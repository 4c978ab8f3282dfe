"""Submissions: read, judged by what they declare, and refused with everything that is wrong."""

import json
import os
import pickle
import shutil
from pathlib import Path

import msgspec
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from submissions import (
    FOLDS,
    PLAZA,
    SHIPPED_FITS,
    crowd,
    declare,
    edit,
    listed_submission,
    problem,
    refusal,
    spawn_submission,
    walk_submission,
    write_network,
)

from crowdbench import rollout
from crowdbench.data.blocks import SPLITS
from crowdbench.data.storage import write_parquet
from crowdbench.leaderboard.submission.errors import RefusedError, SubmissionError
from crowdbench.leaderboard.submission.layout import wrong_name
from crowdbench.leaderboard.submission.limits import (
    LARGEST_DECLARATION,
    LONGEST_PATH,
    MOST_FILES,
    MOST_SHOWN,
)
from crowdbench.leaderboard.submission.parse import _EXPECTED
from crowdbench.leaderboard.submission.schema import Declared, Trained
from crowdbench.leaderboard.submission.submission import read_submission, slug
from crowdbench.registry import policy, spawn_model

SUBMISSIONS = Path(__file__).parents[2] / "leaderboard" / "submissions"


@pytest.fixture
def walker(tmp_path: Path) -> Path:
    return walk_submission(tmp_path / "walker")


def test_networks_are_ranked_and_found_by_the_registry(walker: Path) -> None:
    submission = read_submission(walker)
    assert (submission.id, submission.status) == ("a-walker", "ranked")
    assert submission.protocol == "heldout"
    assert submission.spawn_of("plaza-v0") == "replay"
    assert submission.trajectories_of("plaza-v0") == []
    for split in FOLDS:
        assert policy(submission.policy_of("plaza-v0"), PLAZA, split).name == "tiny"
    assert sorted(submission.artefacts) == [
        *(f"plaza-v0/policy/{split}.onnx" for split in FOLDS),
        "submission.toml",
    ]


@pytest.mark.parametrize("file", SHIPPED_FITS)
def test_fits_are_ranked_and_found_by_the_registry(file: str, tmp_path: Path) -> None:
    submission = read_submission(spawn_submission(tmp_path / "rates", file))
    assert submission.status == "ranked"
    assert submission.policy_of("plaza-v0") == "straight"
    for split in SPLITS:
        spawn_model(submission.spawn_of("plaza-v0"), PLAZA, split, fit=3)


def test_trajectories_are_listed(tmp_path: Path) -> None:
    submission = read_submission(listed_submission(tmp_path / "crowd"))
    assert submission.status == "listed"
    assert "public" in submission.judged[1]
    assert submission.protocol == "full"
    rollouts = [path.name for path in submission.trajectories_of("plaza-v0")]
    assert rollouts == ["0.parquet", "1.parquet", "2.csv"]


def test_a_walk_may_be_one_rollout_and_other_crowds_may_not(tmp_path: Path) -> None:
    folder = declare(tmp_path / "one", "walk")
    (folder / "plaza-v0" / "trajectories").mkdir(parents=True)
    write_parquet(crowd(), folder / "plaza-v0" / "trajectories" / "0.parquet")
    submission = read_submission(folder)
    assert submission.status == "listed"
    assert "expected 2 to 30 rollouts" in problem(edit(folder, '"walk"', '"crowd"'))


def test_one_network_that_knows_no_scene_serves_all(tmp_path: Path) -> None:
    folder = declare(tmp_path / "stranger", protocol="none")
    write_network(folder / "policy.onnx", "full", scene="eth-v0")
    submission = read_submission(folder)
    assert submission.status == "ranked"
    assert policy(submission.policy_of("plaza-v0"), PLAZA, "fold1").name == "tiny"


def test_what_has_seen_whole_recordings_is_listed(tmp_path: Path) -> None:
    folder = declare(tmp_path / "full", protocol="full")
    write_network(folder / "plaza-v0" / "policy" / "full.onnx", "full")
    submission = read_submission(folder)
    assert (submission.status, submission.protocol) == ("listed", "full")
    assert policy(submission.policy_of("plaza-v0"), PLAZA, "full").name == "tiny"


@pytest.mark.parametrize(
    ("track", "spawn", "walker", "status"),
    [
        ("walk", "", "straight", "reference"),
        ("walk", "", "replay", "reference"),
        ("walk", "", "random", "reference"),
        ("walk", "", "social-force", "ranked"),
        ("walk", "", "crowdbench.baselines.heuristic:Heuristic", "ranked"),
        ("spawn", "poisson-gmm", "", "reference"),
        ("spawn", "replay", "", "reference"),
        ("spawn", "block-replay", "", "reference"),
        ("spawn", "ntpp-gmm", "", "ranked"),
        ("crowd", "poisson-gmm", "straight", "reference"),
        ("crowd", "poisson-gmm", "social-force", "ranked"),
        ("crowd", "ntpp-gmm", "straight", "ranked"),
        ("crowd", "block-replay", "social-force", "reference"),
    ],
)
def test_what_comes_with_crowdbench_is_named(
    track: str, spawn: str, walker: str, status: str, tmp_path: Path
) -> None:
    more = f'shipped_spawn = "{spawn}"\nshipped_policy = "{walker}"\n'
    submission = read_submission(declare(tmp_path / "shipped", track, more=more))
    assert submission.status == status
    assert submission.spawn_of("plaza-v0") == (spawn or "replay")
    assert submission.policy_of("plaza-v0") == (walker or "straight")


def test_the_submission_of_orca_names_its_class_as_first_verified() -> None:
    pytest.importorskip("pyrvo")
    submission = read_submission(SUBMISSIONS / "orca")
    assert submission.declared.shipped_policy == "baselines.orca:ORCA"
    assert submission.policy_of("eth-v0") == "crowdbench.baselines.orca:ORCA"
    assert policy(submission.policy_of("eth-v0"), "eth-v0").name == "orca"


def test_policies_that_come_with_a_scene_are_named_for_it(tmp_path: Path) -> None:
    folder = declare(tmp_path / "bc", more='shipped_policy = "bc"\n')
    assert "a policy that comes with plaza-v0: straight, " in problem(folder)
    edit(folder, '["plaza-v0"]', '["eth-v0", "gc-v0"]')
    submission = read_submission(folder)
    assert submission.status == "ranked"


@pytest.mark.parametrize(
    "name",
    [
        *("os:system", "../bc", "bc/../bc", "x", "baselines.command:main"),
        *("crowdbench.baselines.command:main", "crowdbench.baselines.nothing:Class"),
    ],
)
def test_no_other_names_stand_for_policies(name: str, tmp_path: Path) -> None:
    told = problem(declare(tmp_path / "evil", more=f'shipped_policy = "{name}"\n'))
    assert name in told


@pytest.mark.parametrize("name", ["os:system", "poisson-gmm+../x.toml", "/etc", "renewal"])
def test_no_other_names_stand_for_spawn_models(name: str, tmp_path: Path) -> None:
    told = refusal(declare(tmp_path / "evil", "spawn", more=f'shipped_spawn = "{name}"\n'))
    assert "with its code, in a pull request" in told


def test_a_track_names_only_what_it_has(tmp_path: Path) -> None:
    more = 'shipped_policy = "straight"\nshipped_spawn = "replay"\n'
    told = problem(declare(tmp_path / "walk", "walk", more=more))
    assert "shipped_spawn: got 'replay'; expected no such field" in told
    told = problem(declare(tmp_path / "spawn", "spawn", more=more))
    assert "shipped_policy: got 'straight'; expected no such field" in told


def test_everything_wrong_is_told_at_once(walker: Path) -> None:
    edit(walker, "Apache-2.0", "FILL IN: one")
    edit(walker, "https://", "http://")
    edit(walker, 'kind = "learned"', 'kind = "best"\ncolour = 3')
    (walker / "plaza-v0" / "policy" / "fold0.onnx").unlink()
    (walker / "plaza-v0" / "policy" / "fold1.onnx").write_bytes(b"no network")
    (walker / "notes.txt").write_text("mine")
    told = refusal(walker)
    assert "walker: 7 problems.\n" in told
    for split in (
        "submission.toml, licence: got 'FILL IN: one'",
        "submission.toml, link: got 'http://example.org/walker'",
        "submission.toml, kind: got 'best'; expected learned, model-based or privileged",
        "submission.toml, colour: got an unknown field",
        "plaza-v0/policy: got no fold0.onnx",
        "plaza-v0/policy/fold1.onnx: got ",
        "notes.txt: got an unexpected file",
    ):
        assert split in told


BIDI = "\u202etxt.exe"


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("schema = 1", "schema = 2", "schema"),
        ("schema = 1\n", "", "schema: got no such field"),
        ('"A walker"', "5", "name"),
        ('"A walker"', '""', "name"),
        ('"A walker"', '"   "', "name"),
        ('"A walker"', f'"{"x" * 10_000}"', "name"),
        ('"A walker"', f'"{BIDI}"', "name: got '\\u202etxt.exe'"),
        ('"A walker"', '"\\u001b[2J"', "name: got '\\x1b[2J'"),
        ('"A walker"', '"two\\nlines"', "name"),
        ('"A walker"', '"\u3164"', "name"),
        ('"A walker"', '"orca\u034f"', "name"),
        ('"A walker"', f'"Z{chr(0x301) * 100}"', "name"),
        ('["Ada Lovelace"]', '["\u2800"]', "authors"),
        ('["Ada Lovelace"]', "[]", "authors"),
        ('["Ada Lovelace"]', '["Ada", "\\u0000"]', "authors"),
        ('"ada@example.org"', '"FILL IN: an address"', "contact"),
        ("https://example.org/walker", "javascript:alert(1)", "link"),
        ("https://example.org/walker", "https://example.org/ x", "link"),
        ("https://example.org/walker", "https://e.org/<b>", "link"),
        ("Apache-2.0", "<b>mine</b>", "licence"),
        ("Apache-2.0", "see the file LICENSE", "licence"),
        ("Apache-2.0", "MIT OR ", "licence"),
        ("schema = 1", 'schema = 1\ndate = "tomorrow"', "date"),
        ("schema = 1", 'schema = 1\ndate = "2026-13-01"', "date"),
        ("schema = 1", "schema = 1\ndate = 2026-11-29", "date"),
        ('"walk"', '"run"', "track"),
        ('["plaza-v0"]', '["moon-v0"]', "scenes"),
        ('["plaza-v0"]', '["../plaza-v0"]', "scenes"),
        ('["plaza-v0"]', '["plaza-v0", "plaza-v0"]', "scenes"),
        ('"heldout"', '"some"', "training.protocol"),
        ("parameters = 28", "parameters = -1", "training.parameters"),
        ("parameters = 28", "parameters = 1e999", "training.parameters"),
        ("parameters = 28", f"parameters = 0x{'f' * 9000}", "training.parameters"),
        ('"A walker"', f"0x{'f' * 9000}", "name: got a value that is too long to print"),
        ("parameters = 28", 'parameters = 28\nsecret = "x"', "training.secret"),
        ('data = "the plaza"', f'data = "{"x" * 1001}"', "training.data"),
    ],
)
def test_fields_are_held_against_what_they_mean(
    old: str, new: str, where: str, walker: Path
) -> None:
    assert f"submission.toml, {where}" in refusal(edit(walker, old, new))


@pytest.mark.parametrize(
    "licence", ["MIT", "CC-BY-NC-4.0", "GPL-2.0+", "MIT OR (Apache-2.0 AND BSD-3-Clause)"]
)
def test_licences_are_spdx_expressions(licence: str, walker: Path) -> None:
    submission = read_submission(edit(walker, "Apache-2.0", licence))
    assert submission.declared.licence == licence


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("\u0430nticipate", "CYRILLIC SMALL LETTER A), which looks like an ASCII letter"),
        ("\u03b1nticipate", "GREEK SMALL LETTER ALPHA), which looks like an ASCII letter"),
        ("ant\u0131cipate", "LATIN SMALL LETTER DOTLESS I), which looks like an ASCII letter"),
        ("anticipate (official)", "Leave out “official”"),
        ("Verified walker", "Leave out “Verified”"),
        ("replay", "expected a name of its own"),
        ("Straight!", "the name of a reference"),
    ],
)
def test_a_name_cannot_pass_for_another_one(name: str, said: str, walker: Path) -> None:
    told = refusal(edit(walker, "A walker", name))
    assert "submission.toml, name: got" in told
    assert said in told


@pytest.mark.parametrize(
    "name", ["行人", "Müller’s walker", "cox-plans + anticipate", "Ångström 2"]
)
def test_other_names_stay_as_they_are(name: str, walker: Path) -> None:
    assert read_submission(edit(walker, "A walker", name)).declared.name == name


def test_a_network_that_sees_too_far_is_refused(walker: Path) -> None:
    path = walker / "plaza-v0" / "policy" / "fold1.onnx"
    model = onnx.load(path)
    (entry,) = model.metadata_props
    card = json.loads(entry.value) | {"ray_range_m": 200.0}
    entry.value = json.dumps(card)
    onnx.save(model, path)
    told = refusal(walker)
    assert "fold1.onnx: got a network with a ray_range_m of 200; expected at most 20 m" in told


@pytest.mark.parametrize("name", ["Fußgänger", "行人", "नमस्ते", "Nguyễn Ệ", "שָׁלוֹם", "ฟ้า"])
def test_names_are_of_any_script(name: str, walker: Path) -> None:
    submission = read_submission(edit(walker, "Ada Lovelace", name))
    assert submission.declared.authors == [name]


def test_each_field_says_what_is_expected() -> None:
    names = {field.name for field in msgspec.structs.fields(Declared)}
    names |= {f"training.{field.name}" for field in msgspec.structs.fields(Trained)}
    assert set(_EXPECTED) == names


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a = [",
        "\0",
        "a = " + "[" * 5000,
        "a = " + "9" * 5000,
        "x" * (LARGEST_DECLARATION + 1),
        "a." * 30_000 + "b = 1",
        "[" + "a." * 30_000 + "b]",
    ],
)
def test_what_is_no_declaration_is_refused(text: str, walker: Path) -> None:
    (walker / "submission.toml").write_text(text)
    assert "submission.toml" in refusal(walker)


def test_a_declaration_that_is_no_text_is_refused(walker: Path) -> None:
    (walker / "submission.toml").write_bytes(b'name = "\xff"')
    assert "valid TOML in UTF-8" in problem(walker)


def test_a_folder_without_a_declaration_is_refused(tmp_path: Path) -> None:
    assert "crowdbench submit init" in problem(tmp_path)
    assert "no such folder" in problem(tmp_path / "nothing")


def test_a_folder_in_the_folder_is_told_by_its_name(walker: Path, tmp_path: Path) -> None:
    assert "got only walker/submission.toml; expected the file at the top" in problem(tmp_path)


def test_a_zip_is_to_be_unpacked(walker: Path, tmp_path: Path) -> None:
    packed = shutil.make_archive(str(tmp_path / "packed"), "zip", walker)
    assert "got a file; expected a submission's folder. Unpack it" in problem(Path(packed))


@pytest.mark.parametrize(
    ("name", "got"),
    [
        ("/etc/passwd", "an absolute path"),
        ("../evil", "leads out of the folder"),
        ("a/../../evil", "leads out of the folder"),
        ("C:/evil", "a drive letter"),
        ("a\\evil", "a backslash"),
        ("a//b", "invalid characters"),
        ("./a", "invalid characters"),
        (".git/config", "hidden"),
        ("ä.onnx", "invalid characters"),
        ("a\u202eb", "invalid characters"),
        ("a b", "invalid characters"),
        ("a\nb", "invalid characters"),
        ("a\x1b[2Jb", "invalid characters"),
        ("x" * (LONGEST_PATH + 1), f"a path of {LONGEST_PATH + 1} characters"),
    ],
)
def test_names_that_are_no_plain_paths_are_refused(name: str, got: str) -> None:
    told = str(wrong_name(name))
    assert got in told
    assert all(c.isprintable() for c in told.replace("\n", ""))


@pytest.mark.parametrize(
    ("split", "scene", "expected"),
    [
        ("fold1", "plaza-v0", "one trained on fold0 of plaza-v0"),
        ("full", "plaza-v0", "one trained on fold0 of plaza-v0"),
        ("fold0", "eth-v0", "one trained on fold0 of plaza-v0"),
    ],
)
def test_a_network_that_was_not_trained_as_its_place_says_is_refused(
    split: str, scene: str, expected: str, walker: Path
) -> None:
    write_network(walker / "plaza-v0" / "policy" / "fold0.onnx", split, scene)
    told = problem(walker)
    assert f"a network trained on {split} of {scene}; expected {expected}" in told


def test_a_network_of_one_scene_in_anothers_folder_is_refused(walker: Path) -> None:
    edit(walker, '["plaza-v0"]', '["plaza-v0", "eth-v0"]')
    for split in FOLDS:
        scene = "plaza-v0" if split == "fold0" else "eth-v0"
        write_network(walker / "eth-v0" / "policy" / f"{split}.onnx", split, scene)
    assert "eth-v0/policy/fold0.onnx: got a network trained on fold0 of plaza-v0" in problem(walker)


def test_who_says_that_it_knows_no_recording_must_not_know_one(walker: Path) -> None:
    told = refusal(edit(walker, '"heldout"', '"none"'))
    assert told.count("trained on no recording of the submission's scenes") == 3
    (walker / "plaza-v0").rename(walker.parent / "aside")
    write_network(walker / "policy.onnx", "fold0")
    assert "policy.onnx: got a network trained on fold0 of plaza-v0" in problem(walker)


def test_files_of_another_kind_are_surplus(walker: Path) -> None:
    (walker / "plaza-v0" / "spawn").mkdir()
    (walker / "plaza-v0" / "spawn" / "poisson-gmm.json").write_text("{}")
    assert "spawn/poisson-gmm.json: got an unexpected file" in problem(walker)
    (walker / "plaza-v0" / "spawn" / "poisson-gmm.json").unlink()
    write_network(walker / "plaza-v0" / "policy" / "full.onnx", "full")
    assert "policy/full.onnx: got an unexpected file" in problem(walker)
    (walker / "plaza-v0" / "policy" / "full.onnx").unlink()
    write_network(walker / "policy.onnx", "full", scene="eth-v0")
    told = refusal(walker)
    assert told.count("expected policy.onnx instead of networks for each scene.") == 1


def test_what_is_surplus_is_told_once(walker: Path) -> None:
    edit(walker, "[training]", 'shipped_policy = "straight"\n[training]')
    files = ", ".join(f"plaza-v0/policy/{split}.onnx" for split in FOLDS)
    assert f"{files}: got unexpected files" in problem(walker)


def test_trajectories_of_another_name_are_not_taken_for_models(tmp_path: Path) -> None:
    folder = listed_submission(tmp_path / "crowd")
    place = folder / "plaza-v0" / "trajectories"
    for k, name in enumerate(("0.parquet", "1.parquet", "2.csv")):
        (place / name).rename(place / f"run{k}.{name[2:]}")
    told = refusal(folder)
    assert "plaza-v0/trajectories: got no files; expected 2 to 30 rollouts" in told
    assert "run2.csv: got unexpected files; expected in the folder of each scene" in told
    assert "policy" not in told


def test_models_and_trajectories_do_not_mix(tmp_path: Path) -> None:
    folder = listed_submission(tmp_path / "crowd")
    edit(folder, "[training]", 'shipped_spawn = "replay"\n[training]')
    assert "expected either trajectories or models" in problem(folder)


def test_files_do_not_see_the_state(walker: Path) -> None:
    assert "files receive observations" in problem(edit(walker, '"learned"', '"privileged"'))


def test_broken_fits_are_told_by_their_own_reader(tmp_path: Path) -> None:
    folder = spawn_submission(tmp_path / "rates", "poisson-gmm.json")
    file = folder / "plaza-v0" / "spawn" / "poisson-gmm.json"
    good = file.read_text()
    for bad in (
        good.replace("plaza-v0", "eth-v0"),
        good.replace('"fold1"', '"fold7"'),
        good.replace("0.", "-0."),
        "[" * 100_000,
        good.replace("0.", "9" * 400 + "."),
    ):
        file.write_text(bad)
        assert "plaza-v0/spawn/poisson-gmm.json" in problem(folder)
    file.write_bytes(b" " * 1_000_001)
    assert "at most 1 MB" in problem(folder)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"fits":5', '"fits":1000000000000'),
        ('"fits":5', '"fits":0'),
        ('"model":"ntpp-gmm"', '"model":"other"'),
        ('"memory":', '"memory":-'),
        ("{", "[" * 3000),
    ],
)
def test_a_header_that_lies_is_refused(old: str, new: str, tmp_path: Path) -> None:
    folder = spawn_submission(tmp_path / "net", "ntpp-gmm.safetensors")
    path = folder / "plaza-v0" / "spawn" / "ntpp-gmm.safetensors"
    with safe_open(path, "numpy") as file:
        header = file.metadata()["crowdbench"]
    assert old in header
    save_file(load_file(path), path, {"crowdbench": header.replace(old, new, 1)})
    assert "plaza-v0/spawn/ntpp-gmm.safetensors" in problem(folder)


def test_no_fits_and_two_fits_are_refused(tmp_path: Path) -> None:
    folder = spawn_submission(tmp_path / "rates")
    other = folder / "plaza-v0" / "spawn" / "poisson-gmm.json"
    other.write_bytes((PLAZA.folder / "poisson-gmm.json").read_bytes())
    assert "got poisson-gmm.json, renewal-gmm.json; expected one of them" in problem(folder)
    for file in other.parent.iterdir():
        file.unlink()
    assert "crowdbench scene fit plaza-v0 --out FOLDER" in problem(folder)


def test_links_and_hidden_files_are_refused(walker: Path) -> None:
    (walker / "plaza-v0" / "policy" / "fold0.onnx").unlink()
    (walker / "plaza-v0" / "policy" / "fold0.onnx").symlink_to("/etc/passwd")
    (walker / "aside").symlink_to("/tmp")
    (walker / ".hidden").write_text("x")
    told = refusal(walker)
    assert told.count("got a link or a device") == 2
    assert "'.hidden': got a hidden path or invalid characters" in told


def test_too_many_files_are_refused(walker: Path) -> None:
    for k in range(MOST_FILES + 1):
        (walker / f"{k}.txt").touch()
    assert f"more than {MOST_FILES} files" in problem(walker)


def test_folders_in_folders_without_end_are_refused(walker: Path) -> None:
    (walker / "/".join("d" * 900)).mkdir(parents=True)
    assert "got a path of 101 characters" in problem(walker)


def test_files_that_cannot_be_read_are_told(walker: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: object) -> None:
        raise PermissionError(13, "Permission denied", "secret")

    monkeypatch.setattr(os, "scandir", fail)
    assert "got secret: Permission denied; expected readable files" in problem(walker)


def test_notes_are_neither_read_nor_packed(walker: Path) -> None:
    (walker / "README.md").write_bytes(b"\xff\0")
    submission = read_submission(walker)
    assert "README.md" not in submission.artefacts


def test_nothing_that_is_told_moves_the_cursor_or_is_too_long() -> None:
    problems = [RefusedError("a\x1b[2J", got="x" * 10_000, expected="y")] * (MOST_SHOWN + 3)
    error = SubmissionError("here", problems)
    told = str(error)
    assert "\x1b" not in told
    assert "and 3 more" in told
    assert len(told) < MOST_SHOWN * 500
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), len(again.problems)) == (told, MOST_SHOWN + 3)


@given(st.text())
def test_ids_are_safe_names(name: str) -> None:
    made = slug(name)
    assert 1 <= len(made) <= 60
    assert set(made) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")
    assert not made.startswith("-")
    assert not made.endswith("-")
    assert "--" not in made


@pytest.mark.parametrize(
    ("name", "made"),
    [
        ("A walker", "a-walker"),
        ("<script>alert(1)</script>", "script-alert-1-script"),
        ("../../etc/passwd", "etc-passwd"),
        ("Fußgänger v2.1", "fuganger-v2-1"),
    ],
)
def test_ids_are_made_of_names(name: str, made: str) -> None:
    assert slug(name) == made
    assert slug("行人").startswith("submission-")


def test_a_submission_can_be_rolled_out(walker: Path, tmp_path: Path) -> None:
    edit(walker, '"walk"', '"crowd"')
    (spawn_submission(tmp_path / "rates") / "plaza-v0" / "spawn").rename(walker / "plaza-v0/spawn")
    submission = read_submission(walker)
    spawn = spawn_model(submission.spawn_of("plaza-v0"), PLAZA, "fold2", fit=1)
    walks = policy(submission.policy_of("plaza-v0"), PLAZA, "fold2")
    assert len(rollout(PLAZA, spawn, walks, seed=0, horizon_s=40.0)) > 5
