"""What scenes ship is computed from recordings, and contains none of their points."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.special import softmax

from crowdbench.data.blocks import SPLITS
from crowdbench.data.table import Trajectories
from crowdbench.registry import import_recording, recording_of
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.plans.files import read_plans
from crowdbench.spawn.plans.fitting import marks_of, trips_alone
from crowdbench.spawn.plans.mixtures import FEWEST, NARROWEST_M, log_gaussians
from crowdbench.spawn.plans.way_fitting import Trips
from crowdbench.spawn.plans.ways import TripMixtures

NEAR_M = 1e-3
MOVED_M = 4e-3
"""How far a recording is moved to count the copies that are there by chance."""
RECORDINGS = {
    "eth-v0": "eth",
    "hotel-v0": "hotel",
    "zara1-v0": "zara01",
    "gc-v0": "gc",
    "forum-v0": "forum",
}
NUMBER = re.compile(r"-?\d+\.\d+(?:[eE][-+]?\d+)?")
"""Numbers with a point: integers are counts, and equal to coordinates by chance."""


@pytest.fixture(scope="module", params=RECORDINGS)
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene(request.param)


@pytest.fixture(scope="module")
def crowd(scene: Scene, opentraj: Path, tmp_path_factory: pytest.TempPathFactory) -> Trajectories:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROWDBENCH_HOME", str(tmp_path_factory.mktemp("imported")))
        import_recording(RECORDINGS[scene.id], opentraj)
        return recording_of(scene)


def points_in(file: Path) -> list[np.ndarray]:
    """All pairs of numbers that follow each other in a file, as text or in binary."""
    if file.suffix in (".json", ".toml", ".py"):
        numbers = [np.array([float(x) for x in NUMBER.findall(file.read_text())])]
    else:
        content = file.read_bytes()
        numbers = [
            np.frombuffer(content[k:], kind, count=(len(content) - k) // size)
            for kind, size in (("<f4", 4), ("<f8", 8))
            for k in range(size)
        ]
    with np.errstate(invalid="ignore"):  # bytes that are no numbers
        return [np.column_stack([x[:-1], x[1:]]).astype(np.float64) for x in numbers if len(x) > 1]


def points_around(files: list[Path], recorded: np.ndarray) -> np.ndarray:
    """Those of the files that lie where people walk, or up to a metre beside it."""
    low, high = recorded.min(axis=0), recorded.max(axis=0)
    around = []
    for file in files:
        for pairs in points_in(file):
            with np.errstate(invalid="ignore"):
                around.append(pairs[((pairs > low - 1) & (pairs < high + 1)).all(axis=1)])
    return np.concatenate(around)


def shared(points: np.ndarray, recorded: np.ndarray) -> int:
    """Number of different recorded points of which one of these is a copy."""
    distance, nearest = KDTree(recorded).query(points, distance_upper_bound=NEAR_M)
    return len(np.unique(nearest[np.isfinite(distance)]))


def test_no_file_of_a_scene_has_recorded_starts_or_ends(scene: Scene, crowd: Trajectories) -> None:
    """No more than there are points of a recording that is moved by a few millimetres."""
    recorded = np.unique(np.concatenate([crowd.start, crowd.end]).astype(np.float64), axis=0)
    files = [f for f in sorted(scene.folder.rglob("*")) if f.is_file() and f.suffix != ".pyc"]
    assert {"plans.json", "areas.json"} <= {f.name for f in files}
    points = points_around(files, recorded)
    away, _ = KDTree(recorded).query(points, distance_upper_bound=MOVED_M + NEAR_M)
    points = points[np.isfinite(away)]  # all others are copies of none of the points below
    moved = [
        shared(points, recorded + MOVED_M * np.array([np.cos(a), np.sin(a)]))
        for a in np.arange(8) * np.pi / 4
    ]
    assert shared(points, recorded) <= np.mean(moved) + 4 * np.sqrt(np.mean(moved)) + 1


def test_a_recorded_point_would_be_found(crowd: Trajectories, tmp_path: Path) -> None:
    some = crowd.start[:20].astype(np.float64) + 0.0002
    recorded = np.concatenate([crowd.start, crowd.end]).astype(np.float64)
    recorded = np.unique(recorded, axis=0)
    (tmp_path / "plans.json").write_text(json.dumps({"deep": [{"x": some.tolist()}]}))
    (tmp_path / "fit.safetensors").write_bytes(b"abcd" + crowd.start[:20].tobytes())
    for file in tmp_path.iterdir():
        assert shared(points_around([file], recorded), recorded) >= 15


def test_no_place_is_narrower_than_thirty_centimetres_or_of_few_people(
    scene: Scene, crowd: Trajectories
) -> None:
    areas = read_areas(scene)
    blocks = read_reference(scene).blocks
    for split in SPLITS:
        plans = read_plans(scene, areas, split)
        ways, mixtures = plans.ways, plans.ways.trips
        _, of_trips = mixtures.gaussians
        for covariance in (
            of_trips[..., :2, :2],
            of_trips[..., 2:4, 2:4],
            mixtures.starts.covariance,
            mixtures.goals.covariance,
            ways.stop_covariance[..., :2, :2],
        ):
            if covariance.size:
                assert np.linalg.eigvalsh(covariance).min() >= NARROWEST_M**2 - 1e-9
        if len(ways.stop_mean):
            # `from_area` counts the people of each component, and shares some out evenly.
            assert ways.from_area.sum(axis=1).min() >= FEWEST
        slower = plans.links.group_log_speed
        alone = trips_alone(crowd, marks_of(crowd, blocks.training(split)), slower)
        assert len(mixtures.own)
        for i, j in mixtures.own:
            pair = [mixtures.starts.area[i], mixtures.goals.area[j]]
            assert (areas_of(alone) == pair).all(axis=1).sum() >= FEWEST
        for people in (of_pairs(mixtures, alone), *of_places(mixtures, alone)):
            # Gaussians move a little after people are assigned for the last time.
            assert people.min() >= 0.9 * FEWEST


def of_pairs(mixtures: TripMixtures, trips: Trips) -> np.ndarray:
    """Number of people of each pair of places that has a Gaussian of its own."""
    people = np.zeros(mixtures.weight.shape)
    mean, covariance = mixtures.gaussians
    for a, g in np.unique(areas_of(trips), axis=0).tolist():
        mine, at = (areas_of(trips) == [a, g]).all(axis=1), mixtures.between(a, g)
        log = log_gaussians(trips.trip[mine], mean[at], covariance[at])
        people[at] = softmax(log + np.log(mixtures.weight[at] + 1e-9), axis=1).sum(axis=0)
    return people[tuple(mixtures.own.T)]


def areas_of(trips: Trips) -> np.ndarray:
    return np.stack([trips.spawn_area, trips.goal_area], axis=1)


def of_places(mixtures: TripMixtures, trips: Trips) -> list[np.ndarray]:
    """Numbers of people of places in areas with several, except that of the area itself."""
    found = []
    for places, area, x in (
        (mixtures.starts, trips.spawn_area, trips.trip[:, :2]),
        (mixtures.goals, trips.goal_area, trips.trip[:, 2:4]),
    ):
        people = [np.array([np.inf])]
        for k in np.unique(places.area):
            at = np.flatnonzero(places.area == k)[:-1]  # the last one is the area
            if len(at):
                log = log_gaussians(x[area == k], places.mean[at], places.covariance[at])
                people.append(softmax(log + np.log(places.weight[at]), axis=1).sum(axis=0))
        found.append(np.concatenate(people))
    return found
