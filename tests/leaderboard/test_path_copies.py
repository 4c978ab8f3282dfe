"""Copied paths are found in any disguise; walkers who know no path are not taken for copies."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crowdbench.data.table import Trajectories
from crowdbench.leaderboard.verification.path_copies import (
    FEWEST,
    SIMILAR,
    PathCopies,
    similarity,
)
from crowdbench.policies import Policy
from crowdbench.registry import policy, recording_of, spawn_model
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from studies.copies import Alter, bowed, copies_of, mirrored, warped

PLAZA = load_scene("plaza-v0")


@pytest.fixture(scope="module")
def recording() -> Trajectories:
    return recording_of(PLAZA)


@pytest.fixture(scope="module")
def paths(recording: Trajectories) -> PathCopies:
    return PathCopies(recording, PLAZA)


def altered(recording: Trajectories, alter: Alter) -> Trajectories:
    each = [alter(recording.path(k).astype(np.float64), k) for k in range(len(recording))]
    return replace(recording, xy=np.concatenate(each).astype(np.float32))


def test_the_recording_is_a_copy_of_itself(paths: PathCopies, recording: Trajectories) -> None:
    assert paths.share(recording) == 1


@pytest.mark.parametrize("by_m", [0.12, 0.3, 0.5])
def test_bowed_copies_are_copies(paths: PathCopies, recording: Trajectories, by_m: float) -> None:
    assert paths.share(altered(recording, bowed(by_m))) > 0.8
    assert paths.share(altered(recording, bowed(by_m, alternating=True))) > 0.8


def test_mirrored_copies_are_copies(paths: PathCopies, recording: Trajectories) -> None:
    assert paths.share(altered(recording, mirrored)) > 0.9


def test_slightly_warped_copies_are_copies(paths: PathCopies, recording: Trajectories) -> None:
    assert paths.share(altered(recording, warped(0.2, PLAZA.dt_s))) > 0.4


def test_walkers_who_know_no_path_are_no_copies(paths: PathCopies) -> None:
    """On the plaza many ways are bent by walls alone, so more are alike than in real places."""
    crowd = rollout(PLAZA, spawn_model("replay", PLAZA), policy("straight", PLAZA), seed=0)
    found = paths.similarities(crowd)
    assert len(found) > 100
    assert (found > SIMILAR).mean() < 0.3


def test_other_people_are_not_compared(paths: PathCopies, recording: Trajectories) -> None:
    elsewhere = replace(recording, xy=recording.xy + np.float32(3.0))
    assert len(paths.similarities(elsewhere)) < len(recording) / 2
    few = replace(recording, xy=recording.xy + np.float32(500.0))
    assert paths.share(few) is None
    assert FEWEST > 0


def test_a_copying_policy_has_no_paths_for_people_who_never_came(paths: PathCopies) -> None:
    """It walks recorded paths of whom it recognises, and by social forces among others."""
    copy = next(of for of in copies_of(PLAZA) if of.name == "bowed by 0.12 m")

    def share(arrivals: str, walker: Policy) -> float:
        crowd = rollout(PLAZA, spawn_model(arrivals, PLAZA), walker, seed=0)
        found = paths.share(crowd)
        assert found is not None
        return found

    assert share("replay", copy) > 0.95
    honest = share("perturbed-replay", policy("social-force", PLAZA))
    assert share("perturbed-replay", copy) == pytest.approx(honest, abs=0.1)


@given(st.integers(8, 60), st.integers(0, 2**31), st.floats(-np.pi, np.pi), st.booleans())
def test_rotations_and_reflections_change_no_similarity(
    length: int, seed: int, angle: float, reflected: bool
) -> None:
    rng = np.random.default_rng(seed)
    a, b = (rng.standard_normal(length) + 1j * rng.standard_normal(length) for _ in range(2))
    found = similarity(a, b, 5)
    turned = 3.0 * np.exp(1j * angle) * (b.conj() if reflected else b)
    assert similarity(a, turned, 5) == pytest.approx(found, rel=1e-6)
    assert 0 <= found <= 1 + 1e-9
    assert similarity(a, np.exp(1j * angle) * a, 5) == pytest.approx(1)


@given(st.integers(20, 60), st.integers(0, 2**31), st.integers(-5, 5))
def test_delays_are_found(length: int, seed: int, delay: int) -> None:
    rng = np.random.default_rng(seed)
    long = rng.standard_normal(length + 20) + 1j * rng.standard_normal(length + 20)
    a, b = long[10 : 10 + length], long[10 + delay : 10 + delay + length]
    assert similarity(a, b, 5) == pytest.approx(1)
