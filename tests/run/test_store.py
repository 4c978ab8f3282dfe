"""The store of rollouts: what one evaluation has made, another takes from it."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crowdbench.data.table import Trajectories
from crowdbench.metrics.trips import Dwell
from crowdbench.run import rollout_jobs, store
from crowdbench.run.jobs import Job, plan
from crowdbench.run.rollout_jobs import roll_out
from crowdbench.run.summaries import RolloutSummary, code_of_summaries
from crowdbench.scene import load_scene
from crowdbench.scoring.reference import Reference, read_reference

PLAZA = load_scene("plaza-v0")
PAIRS = [("poisson-gmm", "straight")]


def jobs(folder: Path, pairs: list[tuple[str, str]] = PAIRS) -> list[Job]:
    return plan("plaza-v0", PLAZA, pairs, "full", 2, folder)


def made(folder: Path, pairs: list[tuple[str, str]] = PAIRS) -> dict[str, bytes]:
    planned = jobs(folder, pairs)
    roll_out(planned, None, 1)
    return {job.path.name: job.path.read_bytes() for job in planned}


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The rollouts that are simulated, not found."""
    found: list[str] = []
    original = rollout_jobs._rolled_out

    def counted(each: list[Job]) -> object:
        found.extend(str(job) for job in each)
        return original(each)

    monkeypatch.setattr(rollout_jobs, "_rolled_out", counted)
    return found


def test_another_folder_gets_the_same_bytes_without_simulation(
    tmp_path: Path, simulated: list[str]
) -> None:
    first = made(tmp_path / "one")
    assert len(simulated) == 2
    assert made(tmp_path / "two") == first
    assert len(simulated) == 2


def test_the_same_fits_under_another_name_are_the_same_rollouts(
    tmp_path: Path, simulated: list[str]
) -> None:
    made(tmp_path / "one")
    (tmp_path / "fits").mkdir()
    file = "poisson-gmm.json"
    (tmp_path / "fits" / file).write_bytes((PLAZA.folder / file).read_bytes())
    pairs = [(str(tmp_path / "fits"), "straight")]
    made(tmp_path / "two", pairs)
    assert len(simulated) == 2
    assert all(rollout_jobs._kept(job) for job in jobs(tmp_path / "two", pairs))
    (tmp_path / "fits" / file).write_text((PLAZA.folder / file).read_text() + " ")
    made(tmp_path / "three", pairs)
    assert len(simulated) == 4


def test_a_damaged_file_is_not_used(tmp_path: Path, simulated: list[str]) -> None:
    first = made(tmp_path / "one")
    kept = sorted(store.folder().rglob("*.parquet"))
    other = kept[0].read_bytes()
    kept[1].write_bytes(other)  # a valid table, but another one
    assert made(tmp_path / "two") == first
    assert len(simulated) == 3
    assert sorted(store.folder().rglob("*.parquet")) == kept


def test_nothing_is_added_in_a_sandbox(
    tmp_path: Path, simulated: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CROWDBENCH_STORE", "read")
    made(tmp_path / "one")
    assert not store.folder().exists()
    monkeypatch.delenv("CROWDBENCH_STORE")
    made(tmp_path / "two")
    monkeypatch.setenv("CROWDBENCH_STORE", "read")
    made(tmp_path / "three")
    assert len(simulated) == 4  # the third are found


def test_classes_of_others_are_neither_kept_nor_found(
    tmp_path: Path, simulated: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "from crowdbench.policies import Straight\nclass Mine(Straight):\n    pass\n"
    (tmp_path / "mine_in_the_store.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    pairs = [("poisson-gmm", "mine_in_the_store:Mine")]
    made(tmp_path / "one", pairs)
    made(tmp_path / "two", pairs)
    assert len(simulated) == 4
    assert not store.folder().exists()


def test_what_was_used_least_recently_goes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "table.parquet"
    made(tmp_path / "one")
    table.write_bytes(next((tmp_path / "one").iterdir()).read_bytes())
    shutil.rmtree(store.folder())
    monkeypatch.setattr(store, "LIMIT_BYTES", 3 * table.stat().st_size)
    for k, key in enumerate("abc"):
        store.keep(key, ".parquet", table.read_bytes(), tmp_path)
        (kept,) = store.folder().rglob(f"{key}-*")
        os.utime(kept, (k, k))
    assert store.find("a", ".parquet", tmp_path) is not None  # used again: `b` is now the oldest
    store.keep("d", ".parquet", table.read_bytes(), tmp_path)
    store.clean()
    assert {path.name[0] for path in store.folder().rglob("*-*")} == {"a", "c", "d"}


def test_a_store_that_cannot_be_written_is_done_without(
    tmp_path: Path, home: Path, simulated: list[str]
) -> None:
    (home / "rollouts").write_text("in the way")
    made(tmp_path / "one")
    assert len(simulated) == 2


def test_of_two_processes_that_keep_the_same_rollout_one_file_stays(tmp_path: Path) -> None:
    made(tmp_path / "one")
    table = next((tmp_path / "one").iterdir())
    for _ in range(2):
        store.keep("same", ".parquet", table.read_bytes(), tmp_path)
    assert len(list(store.folder().rglob("same-*"))) == 1
    assert not list(store.folder().rglob(".*"))


@pytest.fixture
def summarised(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The crowds that are summarised, whose summaries are not found."""
    found: list[object] = []
    original = RolloutSummary.of_crowd

    def counted(
        crowd: Trajectories, reference: Reference, measured: dict[str, float]
    ) -> RolloutSummary:
        found.append(crowd)
        return original(crowd, reference, measured)

    monkeypatch.setattr(RolloutSummary, "of_crowd", counted)
    return found


def test_summaries_are_found_and_are_the_same(tmp_path: Path, summarised: list[object]) -> None:
    reference = read_reference(PLAZA)
    of_scene = [roll_out(jobs(tmp_path / name), reference, 1) for name in ("one", "two")]
    assert len(summarised) == 2
    for first, second in zip(*(each.values() for each in of_scene), strict=True):
        assert np.array_equal(first.outcomes, second.outcomes)
        assert list(first.arrays) == list(second.arrays)
        for metric in reference.metrics:
            seen, found = first.of(metric), second.of(metric)
            assert seen.keys() == found.keys()
            for name, values in seen.items():
                assert np.array_equal(values, found[name])
                assert values.dtype == found[name].dtype


def test_other_blocks_and_metrics_have_other_summaries() -> None:
    reference = read_reference(PLAZA)
    later = replace(reference.blocks, frames=reference.blocks.frames + 1)
    codes = {
        code_of_summaries(reference),
        code_of_summaries(replace(reference, place=replace(reference.place, radius_m=0.4))),
        code_of_summaries(replace(reference, blocks=later)),
    }
    assert len(codes) == 3


def test_with_metrics_of_others_no_summary_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    class Mine(Dwell):
        name = "mine"

    reference = read_reference(PLAZA)
    assert code_of_summaries(reference) is not None
    monkeypatch.setattr(Reference, "metrics", (*reference.metrics, Mine()))
    assert code_of_summaries(reference) is None


def hidden(folder: Path, pairs: list[tuple[str, str]] = PAIRS) -> list[Job]:
    return [replace(job, shown=False) for job in jobs(folder, pairs)]


def test_what_is_not_shown_leaves_no_trajectories(tmp_path: Path, simulated: list[str]) -> None:
    reference = read_reference(PLAZA)
    roll_out(hidden(tmp_path / "one"), reference, 1)
    assert not (tmp_path / "one").exists()
    assert {path.suffix for path in store.folder().rglob("*-*")} == {rollout_jobs.SUMMARY}
    roll_out(hidden(tmp_path / "two"), reference, 1)
    assert len(simulated) == 2
    roll_out(jobs(tmp_path / "three"), reference, 1)  # now they are to be seen
    assert len(simulated) == 4
    assert len(list((tmp_path / "three").glob("*.parquet"))) == 2


def test_where_the_store_must_not_be_written_summaries_are_kept_beside_the_results(
    tmp_path: Path, simulated: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CROWDBENCH_STORE", "read")
    reference = read_reference(PLAZA)
    for _ in range(2):
        roll_out(hidden(tmp_path / "one"), reference, 1)
    assert len(simulated) == 2
    assert {path.suffix for path in (tmp_path / "one").iterdir()} == {rollout_jobs.SUMMARY}
    roll_out(hidden(tmp_path / "two"), reference, 1)
    assert len(simulated) == 4


def persons(job: Job, crowd: Trajectories) -> dict[str, float]:
    """A measurement: the number of people."""
    return {"persons": float(len(crowd))}


def test_what_is_measured_is_in_the_summaries(tmp_path: Path, simulated: list[str]) -> None:
    reference = read_reference(PLAZA)
    plain = roll_out(hidden(tmp_path), reference, 1)
    for _ in range(2):
        rolled = roll_out(hidden(tmp_path), reference, 1, measure=persons)
        assert [s.measured("persons") for s in rolled.values()] == [
            s.outcomes.sum() for s in plain.values()
        ]
    assert len(simulated) == 4  # once without, once with the measurement


def test_summaries_with_measurements_serve_whoever_measures_nothing(
    tmp_path: Path, simulated: list[str]
) -> None:
    reference = read_reference(PLAZA)
    roll_out(hidden(tmp_path), reference, 1, measure=persons)
    roll_out(hidden(tmp_path), reference, 1)
    assert len(simulated) == 2


def test_a_measurement_is_made_again_if_the_recording_has_changed(
    tmp_path: Path, simulated: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    reference = read_reference(PLAZA)
    for recording in ("one", "another", "one"):
        monkeypatch.setattr(rollout_jobs, "recording_hash", lambda scene, name=recording: name)
        roll_out(hidden(tmp_path), reference, 1, measure=persons)
    assert len(simulated) == 4


def test_rollouts_leave_a_store_of_limited_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    roll_out(hidden(tmp_path), read_reference(PLAZA), 1)
    sizes = [path.stat().st_size for path in store.folder().rglob("*-*")]
    assert len(sizes) == 2
    monkeypatch.setattr(store, "LIMIT_BYTES", sum(sizes) - 1)
    roll_out(jobs(tmp_path), None, 1)
    assert sum(p.stat().st_size for p in store.folder().rglob("*-*")) < sum(sizes)
