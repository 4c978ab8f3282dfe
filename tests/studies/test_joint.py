"""The study of one neural process for all areas: its measures, and its page."""

from collections.abc import Callable

import numpy as np
import pytest
from jaxtyping import Float
from worlds import poisson, square

from crowdbench.policies import Straight
from crowdbench.run.rollout import rollout
from studies.joint import NAMES, PLANS, _best, _long, _scores
from studies.joint.classifier import _auc, _times, _times_and_speeds
from studies.joint.measures import LongSample, _statistics

Arrivals = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]


def arrivals(seed: int, people: int = 1_500, *, every_s: float = 1.0) -> Arrivals:
    """Times of a Poisson process, and log-normal speeds."""
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.exponential(every_s, people)), np.exp(rng.normal(0.3, 0.2, people))


def auc(features: Callable[..., np.ndarray], one: Arrivals, other: Arrivals) -> float:
    return _auc(features(*one, 10), features(*other, 10))


@pytest.mark.parametrize("features", [_times, _times_and_speeds])
def test_samples_of_one_process_cannot_be_told_apart(features: Callable[..., np.ndarray]) -> None:
    assert auc(features, arrivals(0), arrivals(1)) == pytest.approx(0.5, abs=0.08)


def test_other_times_are_told_by_times_and_other_speeds_by_speeds_only() -> None:
    recorded, rng = arrivals(0), np.random.default_rng(2)
    even = np.arange(1_500) + rng.uniform(0, 0.5, 1_500), arrivals(1)[1]
    assert auc(_times, recorded, even) > 0.9
    time_s, speed = arrivals(3)
    alike = time_s, np.repeat(speed[::10], 10)
    assert auc(_times, recorded, alike) == pytest.approx(0.5, abs=0.08)
    assert auc(_times_and_speeds, recorded, alike) > 0.9


def test_people_without_a_known_speed_are_left_out() -> None:
    time_s, speed = arrivals(0)
    known = np.random.default_rng(0).random(len(speed)) > 0.1
    all_known = _times_and_speeds(time_s[known], speed[known], 10)
    some = _times_and_speeds(time_s, np.where(known, speed, np.nan), 10)
    np.testing.assert_array_equal(all_known, some)


def test_statistics_of_poisson_arrivals() -> None:
    """People who walk 8 m at about 1.3 m/s: Fano factors are 1, and nobody is there for 60 s."""
    scene = square(10.0)
    crowd = rollout(scene, poisson(scene, 0.5), Straight(), seed=0, horizon_s=20_000.0)
    found = _statistics(crowd, scene)
    assert found.people_per_s == pytest.approx(0.5, rel=0.05)
    assert found.fano == pytest.approx([1, 1, 1, 1], abs=0.35)
    assert found.autocorrelation == pytest.approx([0, 0], abs=0.1)
    present = crowd.present()
    assert found.present_sd == pytest.approx(present.std())
    assert found.present_sd == pytest.approx(np.sqrt(present.mean()), rel=0.15)


def test_a_sample_is_shown_beside_the_recording_with_its_range() -> None:
    def sample(sd: float) -> LongSample:
        return LongSample(1.0, sd, [0.5, 0.25], [1.0, 2.0, 3.0, 40.0])

    shown = _long({"recorded": [sample(3.0)], **{name: [sample(2), sample(4)] for name in PLANS}})
    lines = shown.splitlines()
    assert len(lines) == 2 + len(NAMES)
    assert "| sd of people present | 3.00 | 3.00 [2.00, 4.00] |" in shown
    assert lines[-1].startswith("| Fano factor of arrivals in 300 s | 40.0 | 40.0 [40.0, 40.0]")


def test_the_best_model_of_each_scene_is_named() -> None:
    nats = {"a": {"one": [-2.0], "two": [-1.0, -1.2]}, "b": {"one": [-3.0], "two": [-3.5, -2.7]}}
    assert _best(nats).endswith("is `two` on a and `one` on b.")


def test_scores_are_those_of_the_entries() -> None:
    shown = _scores(["eth-v0"])
    assert "| `poisson-gmm` | 0.00 [0.00, 0.00] | 0.00 [0.00, 0.00] |" in shown
