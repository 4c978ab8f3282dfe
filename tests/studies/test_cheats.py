"""Cheats: what they are, and that the present metrics see through them."""

from pathlib import Path

import numpy as np
import pytest
from worlds import Person, actions_of, simulate, square

from crowdbench.data.recordings.noise import with_noise
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError
from crowdbench.registry import import_recording, recording_of
from crowdbench.run.episode import generator
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import Row, rows
from studies.__main__ import main as studies_main
from studies.cheats import cheat, cheats_of
from studies.cheats.recordings import shifted, smoothed
from studies.cheats.search import search
from studies.cheats.walkers import Creeper, Runner, Wanderer

OPEN = square(200.0)
PLAZA = load_scene("plaza-v0")


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    return recording_of(PLAZA)


def steps(policy: Runner | Wanderer, frames: int, speed: float = 1.0) -> np.ndarray:
    """Displacements of one person, m per frame."""
    simulation = simulate(OPEN, Person(goal=(150.0, 0.0), speed=speed))
    policy.reset(OPEN, generator(0, 0, "policy"))
    path = [simulation.slots.position[0, 0].copy()]
    for _ in range(frames):
        simulation.step(actions_of(policy, simulation))
        path.append(simulation.slots.position[0, 0].copy())
    return np.diff(np.array(path, dtype=np.float64), axis=0)


def test_runners_run() -> None:
    np.testing.assert_allclose(steps(Runner(), 5), np.tile([1.7 * 0.4, 0.0], (5, 1)), atol=1e-4)


def test_creepers_creep_near_others_only() -> None:
    simulation = simulate(OPEN, Person(goal=(50.0, 0.0)), Person(start=(5.0, 1.0), goal=(-50.0, 1)))
    creeper, speeds = Creeper(), []
    creeper.reset(OPEN, generator(0, 0, "policy"))
    for _ in range(30):
        gap = np.linalg.norm(np.subtract(*simulation.slots.position[0, :2]))
        simulation.step(actions_of(creeper, simulation))
        speed = np.linalg.norm(simulation.slots.velocity[0, :2], axis=1)
        np.testing.assert_allclose(speed, 0.2 if gap < 2 else 1.0, rtol=1e-3)
        speeds.append(speed[0])
    assert len(np.unique(np.round(speeds, 1))) == 2


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_wanderers_have_the_asked_noise_and_memory(memory: float) -> None:
    velocity = steps(Wanderer("mine", (0.1, 0.2), memory), 300) / 0.4 - [1.0, 0.0]
    error = 0.2 if memory else 0.12
    np.testing.assert_allclose(velocity.std(axis=0), [0.1, 0.2], rtol=error)
    lagged = [np.corrcoef(v[1:], v[:-1])[0, 1] for v in velocity.T]
    np.testing.assert_allclose(lagged, memory, atol=0.13)


def test_noise_is_at_ticks_and_linear_in_between(crowd: Trajectories) -> None:
    rng = np.random.default_rng(0)
    offset = with_noise(crowd, (0.1, 0.1), 2, rng).xy.astype(np.float64) - crowd.xy
    frame, person = crowd.row_frame(), crowd.row_person()
    assert offset[frame % 2 == 0].std() == pytest.approx(0.1, rel=0.05)
    middle = np.flatnonzero(frame[1:-1] % 2 == 1) + 1
    middle = middle[(person[middle - 1] == person[middle]) & (person[middle + 1] == person[middle])]
    between = (offset[middle - 1] + offset[middle + 1]) / 2
    np.testing.assert_allclose(offset[middle], between, atol=1e-5)


def test_noise_along_the_path_is_not_noise_across_it(crowd: Trajectories) -> None:
    noisy = with_noise(crowd, (0.1, 0.0), 1, np.random.default_rng(0))
    p = int(np.argmax(np.linalg.norm(crowd.end - crowd.start, axis=1)))
    path = crowd.path(p).astype(np.float64)
    way = path[4:] - path[:-4]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    offset = (noisy.path(p) - path)[2:-2]
    across = offset[:, 1] * way[:, 0] - offset[:, 0] * way[:, 1]
    assert np.abs(across).max() < 1e-4
    assert np.abs((offset * way).sum(axis=1)).max() > 0.05


def test_smoothing_averages_three_ticks(crowd: Trajectories) -> None:
    path, smooth = crowd.path(3).astype(np.float64), smoothed(crowd, 1).path(3)
    np.testing.assert_allclose(smooth[5], path[4:7].mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(smooth[[0, -1]], path[[0, -1]], atol=1e-4)


def test_shifted_trips_keep_their_shape(crowd: Trajectories) -> None:
    moved = shifted(crowd, np.random.default_rng(0))
    assert len(moved) == len(crowd)
    at = {int(person): k for k, person in enumerate(moved.person_id)}
    by = []
    for p in range(len(crowd)):
        q = at[int(crowd.person_id[p])]
        np.testing.assert_array_equal(moved.path(q), crowd.path(p))
        by.append((moved.first[q] - crowd.first[p]) * crowd.dt_s)
    assert np.abs(by).max() <= 5.2
    assert np.std(by) > 2


def test_without_the_recording_there_are_no_cheats(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RecordingError, match="data fetch eth"):
        cheats_of(load_scene("eth-v0"))
    assert studies_main(["cheats", "eth-v0"]) == 2
    assert "data fetch eth" in capsys.readouterr().err


@pytest.mark.long
def test_the_metrics_see_through_the_cheats(opentraj: Path) -> None:
    import_recording("eth", opentraj)
    card, _ = cheat("eth-v0")
    of: dict[str, Row] = {row.policy: row for row in rows(card) if row.kind == "entry"}

    def family(name: str, policy: str) -> float:
        return of[policy].families[name].value

    def walk(policy: str) -> float:
        score = of[policy].walk
        assert score is not None
        return score.value

    for good, least in (
        ("recorded-paths", 0.95),
        ("recording-noise", 0.9),
        ("recording-smoothed", 0.85),  # with bodies, the span from 0 to 1 is smaller
    ):
        assert min(family("motion", good), family("interaction", good)) >= least
    for name in ("half", "same", "twice"):
        assert family("motion", f"position-noise-{name}") <= 0.15
    assert walk("velocity-noise") <= 0.15
    assert max(family("motion", "random"), family("interaction", "random")) <= 0
    assert walk("runner") <= 0
    assert of["runner"].fails == ("speed",)
    assert "arrivals" in of["random"].fails
    assert family("interaction", "recording-shifted") <= 0.75
    assert walk("wander") < walk("social-force")
    assert 0.3 < walk("social-force") < 0.6
    for name, metric in of["recorded-paths"].entry.metrics.items():
        assert metric.distance is not None, name
        assert metric.distance <= 0.05, name


@pytest.mark.nightly
def test_blind_wanderers_are_searched_beside_social_forces() -> None:
    found = search("plaza-v0", 2)
    assert {line.split()[0] for line in found} == {"draw", "social-force"}
    assert all("memory" in line for line in found if line.startswith("draw"))
    with pytest.raises(SettingError, match="draws: got 0"):
        search("plaza-v0", 0)
