"""Flags: what is too good, too even or copied is said, and what is not is not."""

from dataclasses import replace

import numpy as np
import pytest
from copier import JitteredBlocks
from numpy.random import default_rng

from crowdbench.leaderboard.verification.copying import ArrivalCopies, TripCopies, independent_limit
from crowdbench.leaderboard.verification.entry import Copy
from crowdbench.leaderboard.verification.flags import MARGIN, evenness, flags_of
from crowdbench.registry import recording_of, spawn_model
from crowdbench.scene import load_scene
from crowdbench.scoring.energy import FitEnergies
from crowdbench.scoring.score import Score
from crowdbench.spawn import SpawnModel
from crowdbench.spawn.plaza import PlazaArrivals
from crowdbench.trajectories.table import Trajectories

PLAZA = load_scene("plaza-v0")
CLEAN = Copy(arrivals=0.4, arrivals_limit=0.45, trips=0.0)


@pytest.fixture(scope="module")
def recording() -> Trajectories:
    return recording_of(PLAZA)


@pytest.fixture(scope="module")
def copies(recording: Trajectories) -> ArrivalCopies:
    return ArrivalCopies(recording, PLAZA)


@pytest.fixture(scope="module")
def limit(copies: ArrivalCopies) -> float:
    found = independent_limit(copies, PLAZA)
    assert found is not None
    return found


def score(value: float, error: float) -> Score:
    around = default_rng(0).standard_normal(1000)
    around = (around - around.mean()) / around.std()
    return Score(value, value + error * around)


def raised(
    scored: Score | None = None, even: float | None = None, copy: Copy = CLEAN
) -> list[tuple[str, float, float]]:
    return [(f.what, f.value, f.limit) for f in flags_of("plaza-v0", scored, even, copy)]


def test_who_is_as_good_as_the_truth_by_chance_is_not_flagged() -> None:
    assert raised(score(1.19, 0.1)) == []


def test_who_is_better_than_the_truth_beyond_chance_is() -> None:
    ((what, value, limit),) = raised(score(1.25, 0.1))
    assert (what, value) == ("too good", 1.25)
    assert limit == pytest.approx(1.2)


def test_who_varies_half_as_much_as_the_truth_is_not_flagged_and_less_is() -> None:
    assert raised(even=0.5) == []
    assert raised(even=0.49) == [("too even", 0.49, 0.5)]


def test_evenness_is_the_mean_over_metrics_of_spread_over_floor() -> None:
    def spread(*values: float) -> FitEnergies:
        return FitEnergies(np.zeros(len(values)), np.array(values))

    energies = {
        "inter_spawn": {"fold0": spread(0.1, 0.3), "fold1": spread(0.4, 0.4)},
        "agents_sd": {"fold0": spread(0.0, 0.0)},
        "of no floor": {"fold0": spread(9.0, 9.0)},
    }
    assert evenness(energies, {"inter_spawn": 0.3, "agents_sd": 0.2}) == pytest.approx(0.5)
    assert evenness({}, {"inter_spawn": 0.3}) is None


def test_arrivals_are_flagged_from_a_margin_above_what_cannot_copy() -> None:
    limit = 0.45 + MARGIN
    near = Copy(arrivals=limit - 0.01, arrivals_limit=0.45, trips=None)
    assert raised(copy=near) == []
    far = Copy(arrivals=limit + 0.01, arrivals_limit=0.45, trips=None)
    assert raised(copy=far) == [("copied arrivals", limit + 0.01, limit)]
    by_rule = Copy(arrivals=None, arrivals_limit=None, trips=None)
    assert raised(copy=by_rule) == []


def test_one_life_in_twenty_may_be_like_a_recorded_one() -> None:
    assert raised(copy=Copy(arrivals=None, arrivals_limit=None, trips=0.05)) == []
    copied = Copy(arrivals=None, arrivals_limit=None, trips=0.06)
    assert raised(copy=copied) == [("copied trips", 0.06, 0.05)]


def test_each_flag_is_a_sentence_with_its_numbers() -> None:
    copy = Copy(arrivals=0.9, arrivals_limit=0.4, trips=0.5)
    texts = [flag.text for flag in flags_of("plaza-v0", score(2.0, 0.1), 0.1, copy)]
    assert len(texts) == 4
    for text, number in zip(texts, ("2.00", "0.10", "0.90", "50 %"), strict=True):
        assert text.startswith("On plaza-v0, ")
        assert text.endswith(".")
        assert number in text


def index(copies: ArrivalCopies, model: SpawnModel, seeds: int = 4) -> float:
    found = []
    for seed in range(seeds):
        events = model.sample(PLAZA.horizon_s, PLAZA, default_rng(seed))
        of_seed = copies.index(events.time_s, events.spawn_area.astype(np.int64))
        assert of_seed is not None
        found.append(of_seed)
    return float(np.mean(found))


def test_the_recording_is_a_copy_of_itself(copies: ArrivalCopies, recording: Trajectories) -> None:
    in_it = np.flatnonzero(recording.entered)
    area = recording.spawn_area[in_it].astype(np.int64)
    assert copies.index(recording.spawn_s[in_it], area) == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("model", ["renewal-gmm", "ntpp-gmm"])
def test_models_that_learned_are_no_copies(copies: ArrivalCopies, limit: float, model: str) -> None:
    assert index(copies, spawn_model(model, PLAZA)) < limit + MARGIN


def test_another_draw_of_the_true_process_is_no_copy(copies: ArrivalCopies, limit: float) -> None:
    assert index(copies, PlazaArrivals(PLAZA)) < limit + MARGIN


def test_jitter_of_a_frame_hides_no_copied_blocks(copies: ArrivalCopies, limit: float) -> None:
    assert index(copies, spawn_model("block-replay", PLAZA)) > limit + 2 * MARGIN
    assert index(copies, JitteredBlocks(PLAZA)) > limit + 2 * MARGIN


def test_a_few_arrivals_tell_nothing(copies: ArrivalCopies) -> None:
    few = np.array([10.0, 700.0])
    assert copies.index(few, np.zeros(2, dtype=np.int64)) is None


def test_areas_that_the_place_does_not_have_are_no_error(copies: ArrivalCopies) -> None:
    times = np.linspace(0, 1700, 400)
    found = copies.index(times, np.full(400, 99))
    assert found is not None
    assert found < 0.5


def test_every_recorded_life_is_found_at_another_time(recording: Trajectories) -> None:
    later = replace(recording, first=recording.first + 1000, frames=recording.frames + 1000)
    assert TripCopies(recording, PLAZA).share(later) == 1


def test_lives_within_ten_centimetres_are_copies_and_others_are_not(
    recording: Trajectories,
) -> None:
    trips = TripCopies(recording, PLAZA)

    def moved(by_m: float) -> Trajectories:
        return replace(recording, xy=recording.xy + np.float32(by_m))

    assert trips.share(moved(0.06)) == 1
    assert trips.share(moved(0.5)) < 0.05


def test_who_leaves_the_recorded_path_halfway_is_no_copy(recording: Trajectories) -> None:
    frame = recording.row_frame() - recording.first[recording.row_person()]
    strayed = recording.xy + np.where(frame > 20, 1.0, 0.0)[:, None].astype(np.float32)
    long = recording.last - recording.first > 20
    share = TripCopies(recording, PLAZA).share(replace(recording, xy=strayed))
    assert share is not None
    assert share < 1.1 * (1 - long.mean()) + 0.02
