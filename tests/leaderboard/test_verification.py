"""Verification: entries are the same whoever makes them, and copies do not pass unflagged."""

import gzip
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from copier import JitteredBlocks
from submissions import edit

from crowdbench.cli import main
from crowdbench.data.storage import write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import CrowdbenchError, RecordingError
from crowdbench.exam import TRIALS
from crowdbench.files import write_json
from crowdbench.leaderboard.sandbox import isolation
from crowdbench.leaderboard.sandbox.parent import Limits, SandboxError
from crowdbench.leaderboard.submission.errors import SubmissionError
from crowdbench.leaderboard.submission.submission import Submission
from crowdbench.leaderboard.verification import verify as verification
from crowdbench.leaderboard.verification.entry import SCORER, Entry, read_entry
from crowdbench.leaderboard.verification.make_entry import make_entry
from crowdbench.leaderboard.verification.verify import verify
from crowdbench.policies import Straight
from crowdbench.progress import heard_by
from crowdbench.registry import import_recording
from crowdbench.run.jobs import DRAWS
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.scoring.score import LOWEST
from studies.__main__ import main as studies

PLAZA = load_scene("plaza-v0")


@pytest.fixture(scope="module", autouse=True)
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plaza's recording is made once; sandboxes find it too."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("recorded")
        patch.setenv("CROWDBENCH_HOME", str(folder))
        import_recording("plaza")
    return folder


@pytest.fixture(autouse=True)
def home(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CROWDBENCH_HOME", str(recorded))
    return recorded


def submitted(folder: Path, track: str, *, trained: str = "none", **fields: str) -> Path:
    """A submission's folder for the plaza."""
    lines = [
        "schema = 1",
        'name = "Mine, v2"',
        'authors = ["A. Person"]',
        'contact = "a@example.org"',
        'link = "https://example.org"',
        'licence = "MIT"',
        f'track = "{track}"',
        'kind = "model-based"',
        'scenes = ["plaza-v0"]',
        *[f'{key} = "{value}"' for key, value in fields.items()],
        "[training]",
        'data = "None."',
        f'protocol = "{trained}"',
        "parameters = 0",
    ]
    folder.mkdir(parents=True)
    (folder / "submission.toml").write_text("\n".join([*lines, ""]))
    return folder


@pytest.fixture(scope="module")
def walked(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Entry]:
    """Social forces, verified by the command line's way; the folder and the entry."""
    folder = tmp_path_factory.mktemp("walked")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROWDBENCH_HOME", str(recorded))
        mine = submitted(folder / "mine", "walk", shipped_policy="social-force")
        entry, _ = verify(mine, folder / "out", workers=1)
    return folder, entry


@pytest.mark.long
def test_an_entry_has_what_the_track_is_scored_by(walked: tuple[Path, Entry]) -> None:
    entry = walked[1]
    assert (entry.id, entry.status) == ("mine-v2", "ranked")
    scene = entry.scenes["plaza-v0"]
    assert set(scene.families) == {"motion", "interaction"}
    assert (scene.protocol, scene.fits, scene.rollouts) == ("heldout", 1, DRAWS)
    exact = scene.as_recorded
    assert exact is not None
    assert set(exact.families) == {"motion", "interaction"}
    assert exact.families["motion"].value != scene.families["motion"].value
    assert exact.at_goal == pytest.approx(scene.at_goal, abs=0.05)
    assert re.fullmatch("[0-9a-f]{32}", entry.key)
    speed = scene.metrics["speed"]
    assert speed.scored
    assert set(speed.splits) == {"fold0", "fold1", "fold2"}
    scored = [m for m in scene.metrics.values() if m.score is not None and m.interval is not None]
    assert len(scored) >= 5
    assert all(m.interval[0] <= m.score <= m.interval[1] for m in scored)  # type: ignore[index,operator]
    assert any(m.interval[0] < m.score < m.interval[1] for m in scored)  # type: ignore[index,operator]
    assert "inter_spawn" not in scene.metrics
    assert scene.copy.arrivals is None
    assert set(scene.curves) == {"Speed", "Deviation from the straight way"}
    assert scene.recorded_speed_mps == pytest.approx(1.1, abs=0.2)
    assert scene.recorded_at_goal is not None
    assert scene.recorded_at_goal > 0.99


def test_parts_are_around_the_score_whose_terms_they_are(walked: tuple[Path, Entry]) -> None:
    closest = walked[1].scenes["plaza-v0"].metrics["avoidance"]
    splits = [value for split in closest.splits.values() for value in split if value is not None]
    assert min(splits) > LOWEST  # where one is cut off, their mean is another
    assert np.mean(splits) == pytest.approx(closest.score, abs=1e-4)  # they are rounded


def test_curves_are_short_and_distributions_rise_to_one(walked: tuple[Path, Entry]) -> None:
    for curve in walked[1].scenes["plaza-v0"].curves.values():
        assert len(curve.x) == len(curve.recorded) == len(curve.simulated) <= 100
        assert (np.diff(curve.x) > 0).all()
        for line in (curve.recorded, curve.simulated):
            assert (np.diff(line) >= 0).all()
        assert max(curve.recorded[-1], curve.simulated[-1]) == pytest.approx(1, abs=0.01)


def test_the_file_is_the_entry(walked: tuple[Path, Entry]) -> None:
    assert read_entry(walked[0] / "out" / "mine-v2.json.gz") == walked[1]


def test_the_command_line_goes_on_after_a_refusal_and_writes_the_same_bytes(
    walked: tuple[Path, Entry], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = submitted(tmp_path / "bad", "walk", shipped_policy="nobody")
    asked = ["leaderboard", "verify", str(bad), str(walked[0] / "mine"), "--out", str(tmp_path)]
    assert main([*asked, "--workers", "2", "--key", walked[1].key]) == 2
    printed = capsys.readouterr()
    assert f"crowdbench: {bad}: 1 problem.\n  submission.toml, shipped_policy: got " in printed.err
    assert "'nobody'" in printed.err
    assert "1 of 2 rejected" in printed.err
    assert "Traceback" not in printed.err
    (head,) = [line for line in printed.out.splitlines() if "mine-v2 (ranked)" in line]
    assert head.split("  ")[-1].strip() == "copied trips"
    before = walked[0] / "out" / "mine-v2.json.gz"
    assert (tmp_path / "mine-v2.json.gz").read_bytes() == before.read_bytes()


def test_a_key_is_used_once(walked: tuple[Path, Entry], monkeypatch: pytest.MonkeyPatch) -> None:
    """An interrupted verification goes on with its key; a later one draws another."""
    assert not list((walked[0] / "out").rglob("*.key"))
    work = walked[0] / "again"
    first = verification._key_in(work, "mine")
    assert verification._key_in(work, "mine") == first != walked[1].key
    assert re.fullmatch("[0-9a-f]{32}", first)


def test_time_and_memory_stand_beside_the_entry(walked: tuple[Path, Entry]) -> None:
    out = walked[0] / "out"
    ran = json.loads((out / "mine-v2.run.json").read_text())
    assert ran["wall_s"] > 0
    assert ran["peak_bytes"] > 2**20
    assert "network" in ran
    assert b"wall_s" not in gzip.decompress((out / "mine-v2.json.gz").read_bytes())


def test_summaries_lie_in_the_folder_of_work(walked: tuple[Path, Entry]) -> None:
    work = walked[0] / "out" / "work" / "mine-v2" / "plaza-v0"
    assert {path.suffix for path in work.iterdir()} == {".summary"}


@pytest.fixture(scope="module")
def blocks(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Entry]:
    """The recording's blocks, played by a model that hides it; a rollout of each of two fits."""
    folder = tmp_path_factory.mktemp("blocks")
    submitted(folder / "mine", "spawn", trained="full", shipped_spawn="block-replay")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROWDBENCH_HOME", str(recorded))
        patch.setattr(Submission, "spawn_of", lambda self, scene: "copier:JitteredBlocks")
        return folder, make_entry(str(folder / "mine"), str(folder), 1, 2)


@pytest.mark.long
def test_a_policy_is_examined_if_that_is_asked_for(recorded: Path, tmp_path: Path) -> None:
    mine = submitted(tmp_path / "mine", "walk", shipped_policy="straight")
    entry, _ = verify(mine, tmp_path / "out", workers=1, exam=True)
    assert entry.exam is not None
    assert entry.exam.scene == "plaza-v0"
    assert {"rimea-1", "door", "rimea-9"} <= {*entry.exam.passed}
    assert sorted([*entry.exam.passed, *entry.exam.failed]) == sorted(TRIALS)
    assert read_entry(tmp_path / "out" / "mine-v2.json.gz") == entry


@pytest.mark.long
def test_blocks_of_the_recording_with_a_frame_of_jitter_are_flagged_as_a_model(
    blocks: tuple[Path, Entry],
) -> None:
    entry = blocks[1]
    flag = next(flag for flag in entry.flags if flag.what == "copied arrivals")
    copy = entry.scenes["plaza-v0"].copy
    assert copy.arrivals == flag.value
    assert copy.arrivals > copy.arrivals_limit + 0.1


def test_a_rollout_of_each_fit_gives_distances_and_no_score(blocks: tuple[Path, Entry]) -> None:
    scene = blocks[1].scenes["plaza-v0"]
    assert (scene.fits, scene.rollouts) == (2, 2)
    assert scene.families == {}
    assert scene.metrics["inter_spawn"].distance is not None
    assert scene.metrics["inter_spawn"].score is None
    assert "speed" not in scene.metrics  # not of track spawn
    assert len(scene.curves["Agents over time"].x) == 30


@pytest.mark.long
def test_entries_do_not_depend_on_the_number_of_workers(
    blocks: tuple[Path, Entry], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder, entry = blocks
    monkeypatch.setattr(Submission, "spawn_of", lambda self, scene: "copier:JitteredBlocks")
    told: list[tuple[int, int | None]] = []
    with heard_by(lambda stage, *of: told.append(of) if stage == "rollouts" else None):
        again = make_entry(str(folder / "mine"), str(tmp_path), 2, 2)
    write_json(tmp_path / "a.json", entry)
    write_json(tmp_path / "b.json", again)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert told[-1] == (2, 2)


@pytest.fixture(scope="module")
def crowds(recorded: Path) -> list[Trajectories]:
    """Two rollouts of the same, with areas that would hide what is copied if they were believed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROWDBENCH_HOME", str(recorded))
        model = JitteredBlocks(PLAZA)
        made = [rollout(PLAZA, model, Straight(), seed=seed) for seed in (0, 1)]
    return [replace(crowd, spawn_area=np.zeros_like(crowd.spawn_area)) for crowd in made]


def as_trajectories(folder: Path, crowds: list[Trajectories]) -> Path:
    submitted(folder, "crowd")
    for k, crowd in enumerate(crowds):
        write_parquet(crowd, folder / "plaza-v0" / "trajectories" / f"{k}.parquet")
    return folder


@pytest.mark.long
def test_blocks_of_the_recording_with_a_frame_of_jitter_are_flagged_as_trajectories(
    crowds: list[Trajectories], tmp_path: Path
) -> None:
    mine = as_trajectories(tmp_path / "mine", crowds)
    entry = make_entry(str(mine), str(tmp_path), 1)
    assert entry.status == "listed"
    assert "copied arrivals" in [flag.what for flag in entry.flags]
    scene = entry.scenes["plaza-v0"]
    assert (scene.protocol, scene.fits, scene.rollouts) == ("full", 1, 2)
    assert set(scene.families) == {"arrivals", "presence", "trips", "space"}
    assert scene.metrics["speed"].distance is not None
    assert scene.metrics["speed"].score is None  # not under the recorded arrivals


def test_a_crowd_of_one_rollout_is_refused(crowds: list[Trajectories], tmp_path: Path) -> None:
    mine = as_trajectories(tmp_path / "mine", crowds[:1])
    with pytest.raises(SubmissionError, match="expected 2 to 30 rollouts"):
        make_entry(str(mine), str(tmp_path), 1)


def test_without_the_recording_nothing_is_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CROWDBENCH_HOME", str(tmp_path))
    mine = submitted(tmp_path / "mine", "walk", shipped_policy="straight")
    text = (mine / "submission.toml").read_text().replace("plaza-v0", "eth-v0")
    (mine / "submission.toml").write_text(text)
    with pytest.raises(RecordingError, match="crowdbench data fetch eth"):
        make_entry(str(mine), str(tmp_path), 1)


@pytest.mark.parametrize("what", ["nothing", "empty"])
def test_a_refusal_reads_as_that_of_submit_check(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    assert main(["submit", "check", str(tmp_path / what)]) == 2
    told = capsys.readouterr().err
    assert main(["leaderboard", "verify", str(tmp_path / what), "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == told


def test_who_takes_too_long_is_refused_and_leaves_no_entry(tmp_path: Path) -> None:
    mine = submitted(tmp_path / "mine", "walk", shipped_policy="straight")
    with pytest.raises(SandboxError, match="no end after"):
        verify(mine, tmp_path / "out", workers=1, limits=Limits(wall_s=0.3))
    assert list((tmp_path / "out").glob("*.json*")) == []


def forge(entry: Entry, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let sandboxes answer with an entry."""

    def run(walls: list[str], desk: Path, *rest: object) -> dict[str, float]:
        answer = {"network": "none", "value": entry}
        (desk / "answer.json").write_bytes(msgspec.json.encode(answer))
        return {"wall_s": 1.0, "cpu_s": 1.0, "peak_bytes": 1}

    monkeypatch.setattr("crowdbench.leaderboard.sandbox.parent._run", run)
    monkeypatch.setattr(isolation, "lacking", lambda: "nothing is run")


@pytest.mark.parametrize("name", ["../elsewhere", "else\n", "e" * 61])
def test_an_answer_that_would_be_written_elsewhere_is_refused(
    name: str, walked: tuple[Path, Entry], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forge(msgspec.structs.replace(walked[1], id=name), monkeypatch)
    with pytest.raises(SandboxError, match=r"an answer that cannot be read .*`\$\.id`"):
        verify(walked[0] / "mine", tmp_path / "out")
    assert not list(tmp_path.rglob("*.json.gz"))


def test_an_answer_that_verification_cannot_have_given_is_refused(
    walked: tuple[Path, Entry], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes = {"eth-v0": walked[1].scenes["plaza-v0"]}
    forge(msgspec.structs.replace(walked[1], scenes=scenes), monkeypatch)
    with pytest.raises(SandboxError, match="an entry with an unknown scene, 'eth-v0'"):
        verify(walked[0] / "mine", tmp_path / "out")
    assert not list(tmp_path.rglob("*.json.gz"))


def test_an_answer_of_anothers_id_is_refused(
    walked: tuple[Path, Entry], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forge(msgspec.structs.replace(walked[1], id="orca"), monkeypatch)
    others = Path(__file__).parents[2] / "leaderboard" / "entries" / "orca.json.gz"
    shutil.copy(others, tmp_path)
    with pytest.raises(CrowdbenchError, match="the id orca of another submission by crowdbench"):
        verify(walked[0] / "mine", tmp_path)
    assert (tmp_path / "orca.json.gz").read_bytes() == others.read_bytes()


def test_two_submissions_of_one_id_are_not_both_verified(
    walked: tuple[Path, Entry], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    twin = submitted(tmp_path / "twin", "walk", shipped_policy="straight")
    edit(twin, "Mine, v2", "MINE v2!")
    shutil.copytree(walked[0] / "out" / "work", tmp_path / "work")
    asked = ["leaderboard", "verify", str(walked[0] / "mine"), str(twin), "--out", str(tmp_path)]
    assert main([*asked, "--workers", "1", "--key", walked[1].key]) == 2
    assert "got the id mine-v2 of another submission; expected" in capsys.readouterr().err
    assert read_entry(tmp_path / "mine-v2.json.gz") == walked[1]


def test_an_entry_by_others_is_not_overwritten(walked: tuple[Path, Entry], tmp_path: Path) -> None:
    before = (walked[0] / "out" / "mine-v2.json.gz").read_bytes()
    other = submitted(tmp_path / "other", "walk", shipped_policy="straight")
    edit(other, "A. Person", "B. Person")
    with pytest.raises(CrowdbenchError, match=r"another submission by A\. Person"):
        verify(other, walked[0] / "out", workers=1)
    assert (walked[0] / "out" / "mine-v2.json.gz").read_bytes() == before


def test_an_entry_is_overwritten_only_if_that_is_asked_for(
    walked: tuple[Path, Entry], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(walked[0] / "out", tmp_path / "out")
    before = (tmp_path / "out" / "mine-v2.json.gz").read_bytes()
    asked = ["leaderboard", "verify", str(walked[0] / "mine"), "--out", str(tmp_path / "out")]
    assert main([*asked, "--workers", "1"]) == 2
    said = capsys.readouterr().err
    assert "got the id mine-v2, which has an entry already" in said
    assert "`--replace`" in said
    (tmp_path / "out" / "mine-v2.run.json").unlink()
    assert main([*asked, "--workers", "1", "--replace", "--key", walked[1].key]) == 0
    assert (tmp_path / "out" / "mine-v2.json.gz").read_bytes() == before
    assert (tmp_path / "out" / "mine-v2.run.json").exists()


@pytest.fixture
def root(walked: tuple[Path, Entry], tmp_path: Path) -> Path:
    """A leaderboard with that entry; its rollouts are at hand."""
    shutil.copytree(walked[0] / "out" / "work", tmp_path / "out" / "work")
    root = tmp_path / "leaderboard"
    shutil.copytree(walked[0] / "mine", root / "submissions" / "mine-v2")
    write_json(root / "entries" / "mine-v2.json.gz", walked[1])
    return root


def rescored(root: Path, *named: str, reason: str = "Turning is measured anew.") -> int:
    asked = ["rescore", *named, "--reason", reason, "--root", str(root)]
    return studies([*asked, "--out", str(root.parent / "out"), "--workers", "1"])


def test_the_same_scorer_scores_nothing_anew(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (root / "entries" / "mine-v2.json.gz").read_bytes()
    assert rescored(root) == 2
    assert "The scores would be the same." in capsys.readouterr().err
    assert (root / "entries" / "mine-v2.json.gz").read_bytes() == before


def test_a_newer_scorer_keeps_the_earlier_result_with_the_reason(
    root: Path, walked: tuple[Path, Entry]
) -> None:
    path = root / "entries" / "mine-v2.json.gz"
    old = msgspec.structs.replace(walked[1], scorer=0)
    write_json(path, old)
    assert rescored(root, "mine-v2") == 0
    new = read_entry(path)
    assert new.scorer == SCORER
    (earlier,) = new.history
    assert (earlier.scorer, earlier.reason) == (0, "Turning is measured anew.")
    families = old.scenes["plaza-v0"].families.values()
    assert earlier.scenes == {"plaza-v0": pytest.approx(min(f.value for f in families))}
    assert earlier.overall is None  # it is not for all of the three scenes
    assert msgspec.structs.replace(new, history=[]) == walked[1]


@pytest.mark.parametrize(
    ("named", "reason", "message"),
    [
        (["nobody"], "Why not.", r"got 'nobody'; expected one of .*entries \(mine-v2\)"),
        ([], " ", "one line that says why"),
    ],
)
def test_what_cannot_be_scored_anew_is_said(
    named: list[str], reason: str, message: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rescored(root, *named, reason=reason) == 2
    assert re.search(message, capsys.readouterr().err)


def test_a_leaderboard_without_entries_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rescored(tmp_path / "nowhere") == 2
    assert "got no entries" in capsys.readouterr().err
