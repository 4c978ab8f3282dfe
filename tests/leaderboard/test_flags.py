"""Flags: what is too good, too even or copied is said, and what is not is not."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
from copier import JitteredBlocks
from entries import made_up
from numpy.random import default_rng

from crowdbench.data.table import Trajectories
from crowdbench.leaderboard.verification.copying import (
    BINS,
    COARSE_S,
    ArrivalCopies,
    independent_limits,
)
from crowdbench.leaderboard.verification.entry import (
    CoarseCopy,
    Copy,
    Flag,
    entry_paths,
    read_entry,
)
from crowdbench.leaderboard.verification.flags import (
    MARGIN,
    PATH,
    evenness,
    flags_of,
    honest_share,
    moved_limit,
    read_limits,
    trip_limit,
)
from crowdbench.registry import recording_of, spawn_model
from crowdbench.scene import list_scenes, load_scene
from crowdbench.scoring.energy import FitEnergies
from crowdbench.scoring.score import Score
from crowdbench.spawn import SpawnModel
from crowdbench.spawn.plaza import PlazaArrivals
from studies.copied_arrivals import moved
from studies.copy_limits import HONEST, measure
from studies.site.standings import with_current_limits

PLAZA = load_scene("plaza-v0")
ENTRIES = Path(__file__).parents[2] / "leaderboard" / "entries"
CLEAN = Copy(arrivals=0.4, arrivals_limit=0.45, trips=0.0)


@pytest.fixture(scope="module")
def recording() -> Trajectories:
    return recording_of(PLAZA)


@pytest.fixture(scope="module")
def copies(recording: Trajectories) -> ArrivalCopies:
    return ArrivalCopies(recording, PLAZA)


@pytest.fixture(scope="module")
def limit(copies: ArrivalCopies) -> float:
    found = independent_limits(PLAZA)[0]
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


def of_trips(share: float) -> Copy:
    return Copy(arrivals=None, arrivals_limit=None, trips=share)


@pytest.mark.parametrize("scene", list_scenes())
def test_trips_are_flagged_from_five_points_above_walkers_who_cannot_copy(scene: str) -> None:
    limit = trip_limit(scene)
    assert limit == pytest.approx(honest_share(scene) + 0.05, abs=0.0006)
    assert flags_of(scene, None, None, of_trips(limit)) == []
    (flag,) = flags_of(scene, None, None, of_trips(limit + 0.001))
    assert (flag.what, flag.limit) == ("copied trips", limit)
    said = f"On {scene}, {100 * limit + 0.1:.1f} % of the trips", f"above {100 * limit:.1f} % are"
    assert all(words in flag.text for words in said)


def test_limits_are_measured_on_all_scenes_and_again_give_the_same() -> None:
    shares = json.loads(PATH.read_text())["shares"]
    assert set(shares) == set(list_scenes())
    assert all(tuple(sorted(each)) == tuple(sorted(HONEST)) for each in shares.values())
    # Another processor rounds otherwise, and the crowd of social-force is chaotic.
    assert measure(PLAZA) == pytest.approx(shares["plaza-v0"], abs=0.01)
    assert independent_limits(PLAZA) == pytest.approx(read_limits().arrivals["plaza-v0"], abs=0.01)
    assert set(read_limits().arrivals) == set(list_scenes())


def test_a_third_of_a_recording_is_flagged_in_all_real_places() -> None:
    """People of the plaza walk by social forces, so their paths are like those of that policy."""
    assert max(trip_limit(name) for name in list_scenes() if name != PLAZA.id) < 0.3


def test_shipped_entries_have_the_flags_of_the_present_limits() -> None:
    entries = [read_entry(path) for path in entry_paths(ENTRIES).values()]
    assert [e.id for e in entries if with_current_limits(e) != e] == []
    flagged = {e.id for e in entries if any(f.what == "copied trips" for f in e.flags)}
    assert flagged == {"replay"}


def test_flags_of_copied_trips_follow_the_limits_and_others_are_kept() -> None:
    kept = Flag(what="too even", scene="eth-v0", value=0.4, limit=0.5, text="It is.")
    stale = Flag(what="copied trips", scene="gc-v0", value=0.051, limit=0.05, text="It was.")
    entry = made_up("one", "walk", 0.5, flags=(kept, stale))
    entry.scenes["forum-v0"] = msgspec.structs.replace(entry.scenes["forum-v0"], copy=of_trips(0.3))
    found = with_current_limits(entry).flags
    assert found[0] == kept
    assert [(f.what, f.scene) for f in found[1:]] == [("copied trips", "forum-v0")]


def test_each_flag_is_a_sentence_with_its_numbers() -> None:
    copy = Copy(arrivals=0.9, arrivals_limit=0.4, trips=0.5)
    texts = [flag.text for flag in flags_of("plaza-v0", score(2.0, 0.1), 0.1, copy)]
    assert len(texts) == 4
    for text, number in zip(texts, ("2.00", "0.10", "0.90", "50.0 %"), strict=True):
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


@pytest.mark.parametrize("by_s", COARSE_S)
def test_moving_recorded_groups_by_seconds_hides_no_copy(
    recording: Trajectories, by_s: float
) -> None:
    coarse = ArrivalCopies(recording, PLAZA, by_s)
    most = read_limits().arrivals[PLAZA.id][BINS.index(by_s)]
    assert most is not None
    flagged = moved_limit(most)
    in_it = np.flatnonzero(recording.entered)
    area = recording.spawn_area[in_it].astype(np.int64)
    group = np.arange(len(in_it))
    when = moved(recording.spawn_s[in_it], group, by_s, PLAZA.horizon_s, default_rng(1))
    found = coarse.index(when, area)
    assert found is not None
    assert found > flagged
    for model in ("renewal-gmm", "ntpp-gmm", "block-replay"):
        assert index(coarse, spawn_model(model, PLAZA), seeds=3) < flagged


def test_the_clearest_sign_of_moved_arrivals_is_flagged() -> None:
    coarse = [
        CoarseCopy(bin_s=4, index=0.7, limit=0.5),
        CoarseCopy(bin_s=10, index=0.9, limit=0.5),
        CoarseCopy(bin_s=20, index=0.95, limit=0.8),
        CoarseCopy(bin_s=30, index=None, limit=None),
    ]
    copy = Copy(arrivals=0.3, arrivals_limit=0.4, coarse=coarse, trips=None)
    assert raised(copy=copy) == [("copied arrivals", 0.9, 0.667)]
    frame = msgspec.structs.replace(copy, arrivals=0.9)
    assert raised(copy=frame) == [("copied arrivals", 0.9, 0.4 + MARGIN)]
