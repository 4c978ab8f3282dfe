"""What scenes ship is computed from recordings, and contains none of their points."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from crowdbench.cli import main
from crowdbench.registry import recording_of
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.plan_files import read_plans
from crowdbench.spawn.way_fitting import FEWEST, NARROWEST_M
from crowdbench.trajectories.blocks import SPLITS

NEAR_M = 1e-3
RECORDINGS = {
    "eth-v0": "eth",
    "hotel-v0": "hotel",
    "zara1-v0": "zara01",
    "gc-v0": "gc",
    "forum-v0": "forum",
}
NUMBER = re.compile(r"-?\d+\.\d+(?:[eE][-+]?\d+)?")
"""Numbers with a point: integers are counts, and equal to coordinates by chance."""


@pytest.fixture(params=RECORDINGS)
def scene(request: pytest.FixtureRequest, opentraj: Path) -> Scene:
    assert main(["data", "import", RECORDINGS[request.param], "--source", str(opentraj)]) == 0
    return load_scene(request.param)


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


def shared(files: list[Path], recorded: np.ndarray) -> int:
    """Number of different recorded points of which a pair of numbers in the files is a copy."""
    tree, found = KDTree(recorded), set()
    low, high = recorded.min(axis=0), recorded.max(axis=0)
    for file in files:
        for pairs in points_in(file):
            with np.errstate(invalid="ignore"):
                inside = pairs[((pairs > low - 1) & (pairs < high + 1)).all(axis=1)]
            distance, nearest = tree.query(inside, distance_upper_bound=NEAR_M)
            found.update(nearest[np.isfinite(distance)].tolist())
    return len(found)


def test_no_file_of_a_scene_has_recorded_starts_or_ends(scene: Scene) -> None:
    """No more than there are points of a recording that is moved by a few millimetres."""
    crowd = recording_of(scene)
    recorded = np.unique(np.concatenate([crowd.start, crowd.end]).astype(np.float64), axis=0)
    files = [f for f in sorted(scene.folder.rglob("*")) if f.is_file() and f.suffix != ".pyc"]
    assert {"plans.json", "areas.json"} <= {f.name for f in files}
    moved = [
        shared(files, recorded + 0.004 * np.array([np.cos(a), np.sin(a)]))
        for a in np.arange(8) * np.pi / 4
    ]
    assert shared(files, recorded) <= np.mean(moved) + 4 * np.sqrt(np.mean(moved)) + 1


def test_a_recorded_point_would_be_found(scene: Scene, tmp_path: Path) -> None:
    crowd = recording_of(scene)
    some = crowd.start[:20].astype(np.float64) + 0.0002
    recorded = np.concatenate([crowd.start, crowd.end]).astype(np.float64)
    (tmp_path / "plans.json").write_text(json.dumps({"deep": [{"x": some.tolist()}]}))
    (tmp_path / "fit.safetensors").write_bytes(b"abcd" + crowd.start[:20].tobytes())
    for file in tmp_path.iterdir():
        assert shared([file], np.unique(recorded, axis=0)) >= 15


def test_no_place_is_narrower_than_thirty_centimetres_or_of_few_people(scene: Scene) -> None:
    crowd, areas = recording_of(scene), read_areas(scene)
    for split in SPLITS:
        ways = read_plans(scene, areas, split).ways
        for covariance in (
            ways.trip_covariance[..., :2, :2],
            ways.trip_covariance[..., 2:4, 2:4],
            ways.stop_covariance[..., :2, :2],
        ):
            if covariance.size:
                assert np.linalg.eigvalsh(covariance).min() >= NARROWEST_M**2 - 1e-9
        if len(ways.stop_mean):
            # `from_area` counts the people of each component, and shares some out evenly.
            assert ways.from_area.sum(axis=1).min() >= FEWEST
        pairs = np.stack([crowd.spawn_area, crowd.goal_area], axis=1)
        known = pairs[(pairs >= 0).all(axis=1)]
        own = (np.abs(ways.trip_mean[..., :2] - areas.spawn.mean[:, None]) > 1e-9).any(axis=-1)
        assert own.any()
        for a, g in np.argwhere(own):
            assert ((known == [a, g]).all(axis=1)).sum() >= FEWEST
