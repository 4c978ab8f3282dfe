"""Evaluations: files, scorecards, and the same bytes whatever the number of workers."""

import io
import json
import os
import re
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from crowdbench.cli import main
from crowdbench.crowds import score
from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.data.storage import read_own
from crowdbench.data.table import OUTCOMES
from crowdbench.errors import OutputError, RecordingError, SceneError, SettingError
from crowdbench.evaluation import evaluate
from crowdbench.files import write_json
from crowdbench.run.processes import alone_in
from crowdbench.run.replay_check import compare_replay
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import rows
from crowdbench.scoring.scorecard import PairResult, Scorecard

ETH = load_scene("eth-v0")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("evaluation")


@pytest.fixture(scope="module")
def told() -> list[tuple[int, int]]:
    """What the evaluation of `card` told of its progress."""
    return []


@pytest.fixture(scope="module")
def card(out: Path, told: list[tuple[int, int]]) -> Scorecard:
    """Two policies, two seeds, one process."""
    return evaluate(
        "eth-v0", spawn=["poisson-gmm"], policy=["straight", "random"], seeds=2, workers=1, out=out,
        progress=lambda done, total: told.append((done, total)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def again(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The same by the command line and two processes, the policies in the other order.

    Its folder, and what it prints.
    """
    asked = ["--spawn", "poisson-gmm", "--policy", "random", "straight"]
    asked += ["--seeds", "2", "--workers", "2"]
    folder = tmp_path_factory.mktemp("again")
    text = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(text):
        patch.chdir(folder)
        assert main(["evaluate", "eth-v0", *asked]) == 0
    (made,) = (folder / "results").iterdir()
    return made, text.getvalue()


def read_card(folder: Path) -> Scorecard:
    return msgspec.json.decode((folder / "scorecard.json").read_bytes(), type=Scorecard)


def by_policy(card: Scorecard) -> dict[str, PairResult]:
    return {entry.policy: entry for entry in card.entries}


@pytest.mark.long
def test_all_files_are_there(card: Scorecard, out: Path) -> None:
    rollouts = {
        f"rollouts/poisson-gmm_{p}_full_{seed}.parquet"
        for p in ("straight", "random")
        for seed in (0, 1)
    }
    found = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    assert found == {"scorecard.json", "run.json", "report.html"} | rollouts


def test_the_scorecard_on_disk_is_the_one_returned(card: Scorecard, out: Path) -> None:
    assert read_card(out) == card


@pytest.mark.long
def test_rollouts_are_the_same_bytes_by_two_workers(
    card: Scorecard, out: Path, again: tuple[Path, str]
) -> None:
    names = [f"rollouts/{path.name}" for path in (out / "rollouts").iterdir()]
    assert len(names) == 4
    assert [n for n in names if (out / n).read_bytes() != (again[0] / n).read_bytes()] == []


def test_an_entry_does_not_depend_on_workers_or_the_order_of_policies(
    card: Scorecard, again: tuple[Path, str]
) -> None:
    other = read_card(again[0])
    assert [entry.policy for entry in other.entries] == ["random", "straight"]
    assert by_policy(other) == by_policy(card)


def test_but_for_the_order_scorecards_are_the_same_bytes(
    card: Scorecard, out: Path, again: tuple[Path, str], tmp_path: Path
) -> None:
    other = read_card(again[0])
    ordered = msgspec.structs.replace(other, entries=other.entries[::-1])
    write_json(tmp_path / "scorecard.json", ordered)
    assert (tmp_path / "scorecard.json").read_bytes() == (out / "scorecard.json").read_bytes()


def test_the_command_line_prints_a_row_per_pair(card: Scorecard, again: tuple[Path, str]) -> None:
    for entry in card.entries:
        assert re.search(rf"\d  poisson-gmm × {entry.policy}\b", again[1])
        assert f"{entry.metrics['dwell'].distance:.3f}" in again[1]


def test_the_command_line_writes_to_results_and_says_so(again: tuple[Path, str]) -> None:
    folder, printed = again
    assert re.fullmatch(r"eth-v0-\d{8}-\d{6}", folder.name)
    assert f"written to results/{folder.name}" in printed


def test_what_depends_on_the_machine_stands_in_run_json_only(card: Scorecard, out: Path) -> None:
    assert "workers" in json.loads((out / "run.json").read_text())
    assert "workers" not in (out / "scorecard.json").read_text()


def test_the_scorecard_is_the_score_of_the_written_rollouts(card: Scorecard, out: Path) -> None:
    for entry in card.entries:
        path = out / "rollouts" / f"poisson-gmm_{entry.policy}"
        results = [
            score("eth-v0", read_own(Path(f"{path}_full_{seed}.parquet"))) for seed in (0, 1)
        ]
        for name, metric in entry.metrics.items():
            each = [result[name] for result in results]
            assert metric.distances == pytest.approx([r.distance for r in each], rel=1e-5)
            assert metric.distance == np.mean([r.distance for r in each])
            if metric.simulated is not None:
                assert metric.simulated == np.mean([r.simulated for r in each])
            assert metric.n == sum(r.n for r in each)


def test_outcomes_count_the_lives_of_all_rollouts(card: Scorecard, out: Path) -> None:
    for entry in card.entries:
        crowds = [
            read_own(out / "rollouts" / f"poisson-gmm_{entry.policy}_full_{seed}.parquet")
            for seed in (0, 1)
        ]
        how = np.concatenate([crowd.outcome for crowd in crowds])
        assert entry.outcomes == {OUTCOMES[k]: int((how == k).sum()) for k in set(how.tolist())}
        assert entry.persons == len(how)


def test_walking_to_the_goal_is_nearer_to_the_recording_than_walking_at_random(
    card: Scorecard,
) -> None:
    dwell = {policy: entry.metrics["dwell"].distance for policy, entry in by_policy(card).items()}
    assert dwell["straight"] < dwell["random"]


def test_progress_is_told_before_the_first_and_after_each_batch_of_rollouts(
    card: Scorecard, told: list[tuple[int, int]]
) -> None:
    assert told == [(done, 4) for done in (0, 2, 3, 4)]  # straight walkers are walked together


@pytest.mark.usefixtures("no_report")
def test_models_and_policies_of_ones_own_are_walked_by_workers(tmp_path: Path) -> None:
    card = evaluate(
        "eth-v0", spawn=["given:OneByOne"], policy=["given:Announcing"], seeds=2, workers=2,
        out=tmp_path,
    )  # fmt: skip
    names = sorted(path.name for path in (tmp_path / "rollouts").iterdir())
    stem = r"given-OneByOne-\w{6}_given-Announcing-\w{6}_full"
    assert [re.fullmatch(rf"{stem}_(\d)\.parquet", name)[1] for name in names] == ["0", "1"]  # type: ignore[index]
    assert (card.entries[0].spawn, card.entries[0].policy) == ("given:OneByOne", "given:Announcing")


def test_a_replay_is_compared_person_by_person(opentraj: Path) -> None:
    eth = read_published(SOURCES["eth"], opentraj)
    facts = compare_replay(eth, eth, ETH)
    assert facts["identical"].startswith("360 paths")
    assert facts["differing"] == "none"


def test_replays_that_differ_say_why(opentraj: Path) -> None:
    eth = read_published(SOURCES["eth"], opentraj)
    xy, first = eth.xy.copy(), eth.first.copy()
    xy[eth.offsets[5] + 1] += 1.0
    first[7] += 1
    facts = compare_replay(eth, replace(eth, xy=xy, first=first), ETH)
    assert facts["identical"].startswith("358 paths")
    assert facts["differing"] == "1 meet a wall, 1 enter in another frame"


def test_a_place_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="Choose another folder"):
        evaluate("eth-v0", policy=["straight"], seeds=1, workers=1, out=tmp_path / "file" / "out")


def test_a_rollout_that_cannot_take_its_name_leaves_nothing_behind(tmp_path: Path) -> None:
    (tmp_path / "rollouts" / "poisson-gmm_straight_full_0.parquet").mkdir(parents=True)
    with pytest.raises(OutputError):
        evaluate("eth-v0", policy=["straight"], seeds=1, workers=1, out=tmp_path)
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []


@pytest.mark.parametrize(
    ("asked", "error", "message"),
    [
        ({"scene": "moon-v0"}, SceneError, "moon-v0"),
        ({"spawn": ["poisson"]}, SettingError, "spawn model"),
        ({"policy": ["crawl"]}, SettingError, "policy"),
        ({"policy": ["straight", "given:Incomplete"]}, SettingError, "without sees"),
        ({"policy": ["replay"]}, SettingError, "need the spawn model replay"),
        ({"spawn": []}, SettingError, "a valid pair"),
        ({"spawn": ["replay"]}, RecordingError, "crowdbench data import eth"),
        ({"seeds": 0}, SettingError, "seeds: got 0"),
        ({"seeds": 12}, SettingError, "a multiple of 5"),
        ({"workers": 0}, SettingError, "workers: got 0"),
    ],
)
def test_what_does_not_fit_is_refused_before_the_first_rollout(
    asked: dict[str, object], error: type[Exception], message: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with pytest.raises(error, match=message):
        evaluate(**{"scene": "eth-v0", "out": out} | asked)
    assert not out.exists()


def made_of(out: Path) -> dict[str, bytes]:
    """All files but the one that tells when and where."""
    return {
        str(p.relative_to(out)): p.read_bytes()
        for p in sorted(out.rglob("*"))
        if p.is_file() and p.name != "run.json"
    }


@pytest.mark.usefixtures("no_report")
def test_what_is_there_is_kept_and_what_is_missing_is_made(tmp_path: Path) -> None:
    def run() -> dict[str, bytes]:
        evaluate(
            "eth-v0", spawn=["poisson-gmm"], policy=["straight"], seeds=2, workers=1, out=tmp_path
        )
        return made_of(tmp_path)

    whole = run()
    kept, lost, broken, foreign = sorted((tmp_path / "rollouts").iterdir())[:2] * 2
    since = kept.stat().st_mtime_ns
    lost.unlink()
    (tmp_path / "scorecard.json").unlink()
    half = tmp_path / "rollouts" / f".{lost.stem}-0123abcd.parquet"  # of a killed process
    half.write_bytes(b"half a file")
    os.utime(half, (0, 0))
    assert run() == whole
    assert kept.stat().st_mtime_ns == since
    broken.write_bytes(b"no table")
    assert run() == whole
    # The rollout of another seed in this one's place.
    foreign.write_bytes(kept.read_bytes())
    assert run() == whole


@pytest.mark.long
@pytest.mark.usefixtures("no_report")
def test_folds_are_rolled_out_with_their_own_fits_and_random_numbers(tmp_path: Path) -> None:
    card = evaluate(
        "eth-v0", spawn=["renewal-gmm"], policy=["straight"], protocol="heldout", seeds=1,
        workers=1, out=tmp_path, keep_rollouts=True,
    )  # fmt: skip
    crowds = [read_own(p) for p in sorted((tmp_path / "rollouts").iterdir())]
    assert [c.provenance["split"] for c in crowds] == ["fold0", "fold1", "fold2"]
    assert len({c.spawn_s[:5].tobytes() for c in crowds}) == 3
    assert len(card.entries[0].metrics["dwell"].distances) == 3
    assert card.entries[0].metrics["dwell"].energy is None  # one rollout tells nothing of chance


@pytest.mark.long
@pytest.mark.usefixtures("no_report")
def test_recorded_arrivals_are_walked_where_the_recording_is_at_hand(tmp_path: Path) -> None:
    card = evaluate(
        "plaza-v0", spawn=["poisson-gmm"], policy=["straight"], seeds=10, workers=2, out=tmp_path
    )
    crowd, walk = card.entries
    assert (walk.spawn, walk.policy, walk.seeds) == ("replay", "straight", [0])
    assert walk.metrics["speed"].energy is not None
    assert crowd.metrics["speed"].energy is None  # judged under the recorded arrivals
    first, second, *anchors = rows(card)
    assert first.families["motion"].value == pytest.approx(0)
    assert first.walk is not None
    assert second.crowd is not None
    assert {row.kind for row in anchors} == {"baseline"}
    replayed = next(row for row in anchors if row.policy == "replay")
    assert replayed.walk is not None
    assert replayed.walk.value == pytest.approx(1)


@pytest.mark.long
@pytest.mark.usefixtures("no_report")
def test_without_the_recording_walking_has_no_score(tmp_path: Path) -> None:
    card = evaluate(
        "eth-v0", spawn=["poisson-gmm"], policy=["straight"], seeds=10, workers=2, out=tmp_path
    )
    (row, *_) = rows(card)
    assert row.walk is None
    assert row.overall is None
    assert row.crowd is not None
    assert row.crowd.value == pytest.approx(0, abs=0.15)  # the anchor, by other rollouts


def test_a_folder_in_which_another_evaluation_is_at_work_is_refused(tmp_path: Path) -> None:
    with alone_in(tmp_path), pytest.raises(OutputError, match="another evaluation"):
        evaluate("eth-v0", spawn=["poisson-gmm"], policy=["straight"], seeds=1, out=tmp_path)
    assert not (tmp_path / ".lock").exists()


@pytest.mark.usefixtures("no_report")
def test_a_lock_that_nobody_holds_is_no_hindrance(tmp_path: Path) -> None:
    (tmp_path / ".lock").write_text("99999999")
    evaluate("eth-v0", spawn=["poisson-gmm"], policy=["straight"], seeds=1, workers=1, out=tmp_path)
    assert not (tmp_path / ".lock").exists()


@pytest.mark.long
@pytest.mark.usefixtures("no_report")
def test_what_lies_beside_an_own_class_is_part_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "weighted.py").write_text(
        "from pathlib import Path\nfrom crowdbench.policies import Straight\n\n\n"
        "class Weighted(Straight):\n    name = 'weighted'\n\n"
        "    def act(self, seen):\n"
        "        scale = float(Path(__file__).with_name('weights.txt').read_text())\n"
        "        return scale * super().act(seen)\n"
    )

    def dwell(weight: str) -> float | None:
        (tmp_path / "weights.txt").write_text(weight)
        card = evaluate(
            "eth-v0", spawn=["poisson-gmm"], policy=["weighted:Weighted"], seeds=1, workers=1,
            out=tmp_path / "out",
        )  # fmt: skip
        return card.entries[0].metrics["dwell"].simulated

    fast, slow = dwell("1.0"), dwell("0.5")
    assert fast is not None
    assert slow is not None
    assert slow > 1.5 * fast


@pytest.mark.usefixtures("no_report")
def test_an_own_spawn_model_is_told_what_to_be_fitted_for(tmp_path: Path) -> None:
    evaluate(
        "eth-v0", spawn=["given:PerFold"], policy=["straight"], protocol="heldout", seeds=1,
        workers=1, out=tmp_path, keep_rollouts=True,
    )  # fmt: skip
    crowds = [read_own(p) for p in sorted((tmp_path / "rollouts").iterdir())]
    assert [len(c) for c in crowds] == [1, 2, 3]
