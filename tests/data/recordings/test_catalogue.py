from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from strategies import crowd_of, differences

from crowdbench.data.recordings.catalogue import (
    SOURCES,
    cached,
    import_recording,
    load_imported,
    read_published,
)
from crowdbench.data.recordings.describe import describe
from crowdbench.data.recordings.timing import observed_intervals
from crowdbench.data.storage import write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError
from crowdbench.scene import load_scene
from crowdbench.spawn import Replay


@pytest.fixture(scope="module")
def recordings(opentraj: Path) -> dict[str, Trajectories]:
    return {name: read_published(source, opentraj) for name, source in SOURCES.items()}


@pytest.fixture(scope="module")
def eth(recordings: dict[str, Trajectories]) -> Trajectories:
    return recordings["eth"]


@pytest.mark.parametrize(
    ("name", "persons", "frames", "intervals"),
    [("eth", 360, 1934, 15), ("hotel", 390, 1807, 25), ("zara01", 148, 902, 1)],
)
def test_real_recordings_have_their_persons_frames_and_intervals(
    recordings, name, persons, frames, intervals
):
    crowd = recordings[name]
    assert (len(crowd), crowd.frames, len(crowd.observed)) == (persons, frames, intervals)


@pytest.mark.parametrize("name", SOURCES)
def test_walking_speeds_are_those_of_people(recordings, name):
    # With the wrong interval they would be off by a factor of 1.67.
    speeds = recordings[name].mean_speeds()
    assert 1.0 < np.nanmedian(speeds[speeds > 0.5]) < 1.6


@pytest.mark.parametrize("name", SOURCES)
def test_nobody_is_present_where_nothing_was_observed(recordings, name):
    crowd = recordings[name]
    inside = np.zeros(crowd.frames, dtype=bool)
    for start, stop in crowd.observed:
        inside[start:stop] = True
    assert not crowd.present()[~inside].any()


def eth_frame(video_frame: int) -> int:
    return (video_frame - 780) // 6  # the recording's first annotated video frame is 780


def test_who_vanishes_at_a_cut_of_eth_has_not_left(eth):
    there = eth.last == eth_frame(10527)
    assert there.sum() == eth.present()[eth_frame(10527)] == 15
    assert not eth.left[there].any()


def test_who_appears_after_a_cut_of_eth_has_not_entered(eth):
    there = eth.first == eth_frame(10665)
    assert there.sum() == eth.present()[eth_frame(10665)] == 10
    assert not eth.entered[there].any()


def test_a_cut_of_eth_lies_between_two_observed_intervals(eth):
    assert eth_frame(10527) + 1 in eth.observed[:, 1]
    assert eth_frame(10665) in eth.observed[:, 0]


def corridor(*further: tuple[int, float, float]) -> Trajectories:
    """Twenty people walk from x = 0 to 10 m, one every five frames; the last ends at frame 105.

    `further` people: first frame, x at the start, x at the end; one metre a frame.
    """
    walks = [(5 * k, 0.0, 10.0) for k in range(20)] + list(further)
    trips = [(first, first + int(abs(end - start))) for first, start, end in walks]
    paths = [np.linspace(start, end, int(abs(end - start)) + 1) for _, start, end in walks]
    x = np.concatenate(paths)
    return crowd_of(trips, xy=np.stack([x, np.zeros_like(x)], axis=1))


def test_a_pause_between_usual_ends_and_starts_is_an_empty_scene():
    assert observed_intervals(corridor((120, 0, 10))).tolist() == [[0, 131]]


def test_a_pause_after_which_someone_stands_mid_scene_is_unobserved():
    crowd = corridor((120, 5, 10), (120, 0, 10))
    assert observed_intervals(crowd).tolist() == [[0, 106], [120, 131]]


def test_a_pause_before_which_someone_vanishes_mid_scene_is_unobserved():
    crowd = corridor((100, 0, 5), (120, 0, 10))
    assert observed_intervals(crowd).tolist() == [[0, 106], [120, 131]]


def test_a_birth_mid_scene_while_others_are_there_is_no_gap():
    assert observed_intervals(corridor((50, 5, 10), (120, 0, 10))).tolist() == [[0, 131]]


@pytest.mark.parametrize("name", SOURCES)
def test_an_imported_recording_is_loaded_as_it_was_read(opentraj, recordings, name):
    import_recording(name, opentraj)
    assert differences(load_imported(name), recordings[name]) == []


def test_the_folder_may_be_named_by_the_environment(opentraj, monkeypatch):
    monkeypatch.setenv("CROWDBENCH_DATA", str(opentraj))
    assert len(import_recording("zara01")) == 148


def test_importing_twice_gives_equal_bytes(opentraj):
    import_recording("zara01", opentraj)
    before = cached("zara01").read_bytes()
    import_recording("zara01", opentraj)
    assert cached("zara01").read_bytes() == before


def test_a_failed_import_leaves_nothing_behind(tmp_path):
    with pytest.raises(RecordingError):
        import_recording("eth", tmp_path)
    assert not cached("eth").exists()


def test_an_imported_table_tells_its_source(opentraj):
    import_recording("zara01", opentraj)
    source = SOURCES["zara01"]
    assert load_imported("zara01").provenance == {
        "source": source.address,
        "sha256": source.sha256,
    }


def test_a_recording_that_was_not_imported_says_how_to(home):
    with pytest.raises(RecordingError) as caught:
        load_imported("eth")
    assert str(home) in caught.value.expected
    assert "`crowdbench data fetch eth`" in caught.value.hint
    assert "`crowdbench data import eth --source DIR`" in caught.value.hint


def test_a_recording_in_the_place_of_another_one_is_refused():
    write_parquet(replace(crowd_of([(0, 3), (1, 2)]), scene="hotel"), cached("eth"))
    with pytest.raises(RecordingError, match="got the recording hotel; expected the recording eth"):
        load_imported("eth")


@pytest.mark.parametrize("use", [import_recording, load_imported])
def test_an_unknown_recording_is_refused_with_the_known_names(use):
    with pytest.raises(SettingError) as caught:
        use("nowhere")
    assert "nowhere" in caught.value.got
    assert "eth, hotel, zara01" in caught.value.expected


def test_an_import_from_no_folder_is_refused(monkeypatch):
    monkeypatch.delenv("CROWDBENCH_DATA", raising=False)
    with pytest.raises(SettingError, match="--source"):
        import_recording("eth")


def test_the_description_counts_only_observed_frames():
    crowd = crowd_of([(0, 3), (1, 2)], frames=10, observed=[(0, 4)], dt_s=0.5)
    figures = describe(crowd)
    assert figures["agents at once"] == "mean 1.50, max 2"
    assert figures["observed"] == "2.0 s in 1 interval"
    assert figures["total duration"] == "5.0 s"


def test_the_description_tells_who_was_not_seen_to_enter_or_leave():
    figures = describe(crowd_of([(0, 3), (1, 2), (1, 3)], frames=4))
    assert figures["in frame 0"] == "1"
    assert figures["entered"] == "2 (1 was there at the start)"
    assert figures["left"] == "1 (2 were still there at the end)"


def test_the_description_tells_that_people_stand_there_at_the_start_of_each_interval():
    crowd = crowd_of([(0, 3), (6, 8), (6, 8)], frames=10, observed=[(0, 4), (6, 10)])
    figures = describe(replace(crowd, entered=np.zeros(3, bool)))
    assert figures["in frame 0"] == "1"
    assert figures["observed"].endswith(" in 2 intervals")
    assert figures["entered"] == "0 (3 were there at the start of one of the 2 intervals)"


def test_the_description_takes_dwell_times_of_whole_lives_only():
    trips = [(0, 8), (1, 4), (3, 9)]
    assert "p50 1.50" in describe(crowd_of(trips, frames=10, dt_s=0.5))["dwell time"]


def test_the_description_of_a_crowd_without_whole_lives_says_none():
    assert describe(crowd_of([(0, 3)], frames=4))["dwell time"] == "none"


def test_replayed_arrivals_are_the_recorded_ones(eth):
    events = Replay(eth).sample(eth.duration_s, load_scene("eth-v0"), np.random.default_rng(0))
    assert len(events) == len(eth)
    np.testing.assert_allclose(events.time_s, eth.first * 0.4)
    np.testing.assert_array_equal(events.start, eth.start)
    np.testing.assert_array_equal(events.goal, eth.end)
    np.testing.assert_array_equal(events.entered, eth.entered)


def test_replayed_people_cut_off_by_the_recording_leave_with_it(eth):
    events = Replay(eth).sample(eth.duration_s, load_scene("eth-v0"), np.random.default_rng(0))
    np.testing.assert_array_equal(events.leave_frame[~eth.left], eth.last[~eth.left])
    assert (events.leave_frame[eth.left] == -1).all()
    np.testing.assert_array_equal(events.censored, ~eth.left)


def test_replay_stops_at_the_horizon(eth):
    events = Replay(eth).sample(40.0, load_scene("eth-v0"), np.random.default_rng(0))
    assert len(events) == (eth.first < 100).sum()


def test_scripted_people_leave_at_their_recorded_last_frame(eth):
    replay = Replay(eth)
    events = replay.sample(40.0, load_scene("eth-v0"), np.random.default_rng(0))
    np.testing.assert_array_equal(replay.scripted(events).leave_frame, eth.last[: len(events)])


def test_replay_of_another_time_step_is_refused(eth):
    with pytest.raises(SettingError, match=r"frames of 0.8 s"):
        Replay(replace(eth, dt_s=0.8)).sample(1.0, load_scene("eth-v0"), np.random.default_rng(0))
