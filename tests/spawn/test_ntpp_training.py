"""Training of the neural model: equal to the compiled network, honest windows, reproducible."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from models import AREAS, GRID_S, arrivals_at, parameters, random_ntpp, renewal
from strategies import arrivals_of_two_areas, intervals

from crowdbench.data.blocks import SPLITS
from crowdbench.scene import load_scene
from crowdbench.spawn import Arrivals, NtppGMM, RenewalGMM, arrivals_in
from crowdbench.spawn.ntpp import training as ntpp_training
from crowdbench.spawn.ntpp.likelihood import Packed, head, nats, pack
from crowdbench.spawn.ntpp.model import NEVER_FORGETS, SHAPES
from crowdbench.spawn.ntpp.sequences import Sequence, sequences, windows
from crowdbench.spawn.ntpp.training import DEFAULT, NtppSettings
from crowdbench.spawn.times.groups import group_size, spells_of

ETH = load_scene("eth-v0")
BRIEF = NtppSettings(epochs=12, patience=4, calibration_points=20_000)


def double(batch: Packed) -> Packed:
    names = ("x", "before", "until", "size", "persons")
    return replace(batch, **{name: getattr(batch, name).double() for name in names})


def bursty(horizon_s: float = 900.0, seed: int = 0) -> Arrivals:
    events = renewal().sample(horizon_s, ETH, np.random.default_rng(seed))
    return arrivals_in(events, horizon_s, GRID_S, 2)


@given(arrivals_of_two_areas(), st.integers(0, 3), st.integers(1, 12) | st.just(NEVER_FORGETS))
def test_torch_and_the_kernels_give_the_same_likelihood(
    arrivals: Arrivals, seed: int, memory: int
) -> None:
    model = replace(random_ntpp(seed=seed), memory=memory)
    cut = sequences(arrivals, arrivals.windows, memory=memory)
    batch = double(pack(cut, model.weights["scaling"]))
    weights = {name: torch.tensor(w).double() for name, w in model.weights.items()}
    by_kernels = model.log_likelihood(arrivals) * max(1, len(arrivals.tick))
    assert -float(nats(weights, batch).sum()) == pytest.approx(by_kernels, rel=1e-5, abs=1e-5)


def test_torch_and_the_kernels_give_the_same_parameters_along_a_sequence() -> None:
    model, arrivals = random_ntpp(), bursty()
    batch = double(pack(sequences(arrivals, arrivals.windows), model.weights["scaling"]))
    weights = {name: torch.tensor(w).double() for name, w in model.weights.items()}
    shape, log_scale, more = (x.numpy() for x in head(weights, batch))
    spells = spells_of(arrivals)
    area = spells.area[spells.of_group]
    for k in range(2):
        n = int((area == k).sum())
        expected = np.stack([shape[k], np.exp(log_scale[k]), more[k]], axis=1)[:n]
        np.testing.assert_allclose(parameters(model, arrivals)[area == k], expected, rtol=1e-5)


def test_the_loss_of_sequences_is_the_sum_of_theirs_whatever_their_length() -> None:
    long = Sequence(np.array([2, 1, 7, 3]), np.array([1, 2, 1, 1]), 5)
    short = Sequence(np.array([4]), np.array([3]), 0)
    empty = Sequence(np.array([], dtype=np.int64), np.array([], dtype=np.int64), 30)
    model = random_ntpp()
    scaling = model.weights["scaling"][:1]
    weights = {name: torch.tensor(w[:1]) for name, w in model.weights.items()}
    one_by_one = sum(float(nats(weights, pack([[s]], scaling))) for s in (long, short, empty))
    batch = pack([[short, empty, long]], scaling)
    assert float(nats(weights, batch)) == pytest.approx(one_by_one, rel=1e-5)
    assert batch.persons.tolist() == [8.0]


def test_the_loss_has_derivatives_at_gaps_of_one_step() -> None:
    model = random_ntpp()
    weights = {name: torch.tensor(w, requires_grad=True) for name, w in model.weights.items()}
    arrivals = arrivals_at([0, 1, 2, 2, 8], [0, 0, 0, 0, 1], [(0, 9)])
    nats(
        weights, pack(sequences(arrivals, arrivals.windows), model.weights["scaling"])
    ).sum().backward()
    assert all(bool(torch.isfinite(w.grad).all()) for w in weights.values() if w.grad is not None)


@given(intervals(300), st.integers(1, 60), st.integers(1, 60))
def test_windows_stay_in_their_stretch_and_cover_it(
    stretches: list[tuple[int, int]], width: int, stride: int
) -> None:
    stride = min(stride, width)
    found = windows(np.array(stretches), width, stride).tolist()
    for start, stop in found:
        assert any(
            a <= start and stop <= b and stop - start == min(width, b - a) for a, b in stretches
        )
    covered = {t for start, stop in found for t in range(start, stop)}
    assert covered == {t for a, b in stretches for t in range(a, b)}


def test_windows_start_at_any_time_and_not_at_their_first_group() -> None:
    arrivals = arrivals_at([7, 40, 61], [0, 0, 0], [(0, 100)])
    found = sequences(arrivals, windows(arrivals.windows, 30, 10))[0]
    first = [s.gap[0] for s in found if len(s.gap)]
    assert len(set(first)) > 5
    assert max(first) > 20


def test_training_windows_are_censored_at_their_end() -> None:
    arrivals = arrivals_at([7, 40], [0, 0], [(0, 100)])
    found = sequences(arrivals, np.array([[0, 30]]))[0][0]
    assert (found.gap.tolist(), found.rest) == ([8], 22)


@given(arrivals_of_two_areas(), st.integers(1, 12))
def test_sequences_that_forget_have_no_longer_silence_and_lose_nothing(
    arrivals: Arrivals, memory: int
) -> None:
    whole = sequences(arrivals, arrivals.windows)
    for one, other in zip(whole, sequences(arrivals, arrivals.windows, memory=memory), strict=True):
        assert all((s.gap <= memory).all() and s.rest <= memory for s in other)
        steps, persons = (
            [sum(int(s.gap.sum()) + s.rest for s in some) for some in (one, other)],
            [np.concatenate([s.size for s in some]).tolist() for some in (one, other)],
        )
        assert steps[0] == steps[1]
        assert persons[0] == persons[1]


def test_a_network_forgets_after_a_silence_of_any_length() -> None:
    # Frames of 0.4 s on a grid of 0.2 s: 40 frames are 80 steps.
    fine = replace(bursty(400.0), grid_s=0.2)
    brief = replace(
        BRIEF, window_frames=30, stride_frames=15, reset_frames=40, epochs=2, patience=1
    )
    fitted = ntpp_training.fit(fine, AREAS, replace(ETH, grid_s=0.2), seed=0, settings=brief)
    assert fitted.memory == 80


def test_training_starts_from_poisson() -> None:
    arrivals = bursty()
    weights = ntpp_training.start_weights(arrivals, 0)
    more, groups = group_size(arrivals)
    batch = pack(sequences(arrivals, arrivals.windows), weights["scaling"])
    shape, log_scale, log_more = head({n: torch.tensor(w) for n, w in weights.items()}, batch)
    assert torch.allclose(shape, torch.ones_like(shape))
    at_a_point = 1 - np.exp(-np.exp(-log_scale.numpy()))
    np.testing.assert_allclose(at_a_point, np.tile(groups[:, None], at_a_point.shape[1]), rtol=1e-4)
    np.testing.assert_allclose(
        np.exp(-log_more.numpy()), np.tile(more[:, None], at_a_point.shape[1]), rtol=1e-4
    )


def test_the_same_seed_gives_the_same_weights_and_torch_is_left_as_it_was() -> None:
    arrivals = bursty(400.0)
    threads = torch.get_num_threads()
    one, two = (ntpp_training.fit(arrivals, AREAS, ETH, seed=3, settings=BRIEF) for _ in range(2))
    assert all(np.array_equal(one.weights[name], two.weights[name]) for name in SHAPES)
    assert torch.get_num_threads() == threads
    assert not torch.are_deterministic_algorithms_enabled()


def test_a_fit_is_what_its_file_gives_back(tmp_path: Path) -> None:
    arrivals = bursty(400.0)
    fitted = ntpp_training.fit(arrivals, AREAS, ETH, seed=3, settings=replace(BRIEF, epochs=40))
    assert fitted.trained().any()
    NtppGMM.write(tmp_path, {split: [fitted] for split in SPLITS})
    back = NtppGMM.read(replace(ETH, folder=tmp_path), AREAS)
    for name in SHAPES:  # of areas without a network, only some weights are in the file
        one, other = (model.weights[name][fitted.trained()] for model in (fitted, back))
        np.testing.assert_array_equal(one, other)
    assert back.log_likelihood(arrivals) == fitted.log_likelihood(arrivals)
    samples = [m.sample(600.0, ETH, np.random.default_rng(0)) for m in (fitted, back)]
    np.testing.assert_array_equal(samples[0].time_s, samples[1].time_s)


def test_another_seed_gives_another_fit() -> None:
    arrivals = bursty(400.0)
    one, two = (ntpp_training.fit(arrivals, AREAS, ETH, seed=k, settings=BRIEF) for k in (3, 4))
    assert not np.array_equal(one.weights["state_weight"], two.weights["state_weight"])


def test_windows_that_overlap_much_are_judged_before_all_parts_had_their_turn() -> None:
    """Judged once in 64 steps, more than its patience, training would end there or at nothing."""
    arrivals = bursty(1200.0)
    often = replace(DEFAULT, window_frames=20, stride_frames=1, step_groups=64)
    training = ntpp_training._Training(
        arrivals, often, seed=0, width=20, stride=1, reset=20, block=150
    )
    ((chosen, parts),) = training.together()
    assert parts >= 64 > often.patience
    steps = training.best_steps(chosen, parts)
    assert (steps % parts > 0).any()


def test_parts_are_no_more_than_there_are_windows_for() -> None:
    arrivals = bursty(400.0)
    few = replace(BRIEF, window_frames=900, stride_frames=1, step_groups=4)
    fitted = ntpp_training.fit(arrivals, AREAS, ETH, seed=0, settings=few)
    assert all(np.isfinite(w).all() for w in fitted.weights.values())


def test_a_network_of_few_windows_takes_its_turns_more_often() -> None:
    one = Sequence(np.array([2, 1]), np.array([1, 1]), 5)
    scaling = np.tile([0.0, 1.0, 0.0, 1.0], (2, 1))
    batches = ntpp_training._Parts.of([[one] * 64, [one] * 16], scaling, 4, 0)
    assert batches.parts == [4, 2]
    persons = np.stack([batches.at(step).persons.numpy() for step in range(4)])
    assert persons.tolist() == [[32.0, 16.0]] * 4
    assert batches.at(4) is batches.at(0)


def test_without_a_single_group_there_is_still_a_likelihood() -> None:
    silent = Sequence(np.array([], dtype=np.int64), np.array([], dtype=np.int64), 30)
    model = random_ntpp()
    batch = pack([[silent], [silent]], model.weights["scaling"])
    weights = {name: torch.tensor(w) for name, w in model.weights.items()}
    assert bool(torch.isfinite(nats(weights, batch)).all())


def test_an_area_of_a_few_groups_stays_poisson() -> None:
    arrivals = bursty(400.0)
    few = arrivals.area == 1
    groups = np.unique(arrivals.tick[few])
    assert 30 < len(groups) < 120
    fitted = ntpp_training.fit(
        arrivals, AREAS, ETH, seed=0, settings=replace(BRIEF, least_groups=120)
    )
    assert (fitted.weights["out_weight"][1] == 0).all()
    assert (fitted.weights["out_weight"][0] != 0).any()


@pytest.mark.nightly
def test_it_learns_what_poisson_cannot_and_keeps_the_number_of_persons() -> None:
    arrivals, horizon_s = bursty(2400.0), 4000.0
    fresh = bursty(6000.0, seed=1)
    fitted = ntpp_training.fit(arrivals, AREAS, ETH, seed=0)
    start = replace(fitted, weights=ntpp_training.start_weights(arrivals, 0))
    truth = renewal().log_likelihood(fresh)
    estimated = RenewalGMM.fit(arrivals, AREAS).log_likelihood(fresh)
    assert start.log_likelihood(fresh) < estimated - 0.03
    assert fitted.log_likelihood(fresh) > truth - 0.05

    count, early = np.zeros(2), 0
    for seed in range(10):
        events = fitted.sample(horizon_s, ETH, np.random.default_rng(seed))
        count += np.bincount(events.spawn_area, minlength=2)
        early += int((events.time_s < horizon_s / 100).sum())
    recorded = np.bincount(arrivals.area) / arrivals.exposure_s()
    np.testing.assert_allclose(count / 10 / horizon_s, recorded, rtol=0.1)
    assert early * 100 == pytest.approx(count.sum(), rel=0.2)


def test_a_shared_network_learns_from_all_areas() -> None:
    arrivals = bursty(1200.0)
    shared = replace(BRIEF, epochs=40, shared=True)
    fitted = ntpp_training.fit(arrivals, AREAS, ETH, seed=0, settings=shared)
    own = {"base", "scaling"}
    for name, weights in fitted.weights.items():
        assert np.array_equal(weights[0], weights[1]) == (name not in own)
    start = replace(fitted, weights=ntpp_training.start_weights(arrivals, 0))
    assert (fitted.weights["out_weight"] != 0).any()
    assert fitted.log_likelihood(arrivals) > start.log_likelihood(arrivals) + 0.01
    # An area of a few groups has no network of its own, but a part of the shared one.
    few = replace(shared, least_groups=10_000)
    again = ntpp_training.fit(arrivals, AREAS, ETH, seed=0, settings=few)
    for name, weights in again.weights.items():
        np.testing.assert_array_equal(weights, fitted.weights[name])


def test_a_shared_network_takes_an_area_in_which_nobody_enters() -> None:
    arrivals = bursty(1200.0)
    first = arrivals.area == 0
    alone = replace(arrivals, tick=arrivals.tick[first], area=arrivals.area[first])
    fitted = ntpp_training.fit(alone, AREAS, ETH, seed=0, settings=replace(BRIEF, shared=True))
    events = fitted.sample(1200.0, ETH, np.random.default_rng(0))
    assert np.bincount(events.spawn_area, minlength=2)[1] < 5
