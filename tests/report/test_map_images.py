"""Photographs of places: warped to the floor, and drawn under pictures, players and the viewer."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from PIL import Image
from worlds import square

from crowdbench.cli import main
from crowdbench.errors import RecordingError, SceneError
from crowdbench.registry.map_images import DARK, WHITE, add_map, map_of, map_path, warped
from crowdbench.report.html.player import clip_of, player
from crowdbench.report.plots import panels
from crowdbench.scene import Bounds, Scene, load_scene
from crowdbench.viewer.canvas import Canvas

RED, BLUE = (200, 20, 20), (20, 20, 200)
SQUARE = square(5.0)
PIXELS = 20  # of a photograph in which a metre is two pixels
STRAIGHT = np.array([[0.5, 0, -4.75], [0, -0.5, 4.75], [0, 0, 1]])
"""From pixels to metres, seen from above: the middle of the first pixel is at (−4.75, 4.75)."""


@pytest.fixture
def photograph(tmp_path: Path) -> Path:
    """A blue square whose upper left quarter is red."""
    pixels = np.full((PIXELS, PIXELS, 3), BLUE, np.uint8)
    pixels[:10, :10] = RED
    Image.fromarray(pixels).save(tmp_path / "place.png")
    return tmp_path / "place.png"


def written(matrix: np.ndarray, folder: Path) -> Path:
    np.savetxt(folder / "H.txt", matrix)
    return folder / "H.txt"


def colour_at(scene: Scene, x: float, y: float) -> tuple[int, ...]:
    image = map_of(scene)
    assert image is not None
    along, across = image.metres_per_pixel
    row = int((image.bounds.y_max_m - y) / across)
    return tuple(image.pixels[row, int((x - image.bounds.x_min_m) / along)].tolist())


def test_a_photograph_lies_where_its_matrix_says(photograph: Path, tmp_path: Path) -> None:
    assert map_of(SQUARE) is None
    add_map(SQUARE, photograph, written(STRAIGHT, tmp_path))
    assert colour_at(SQUARE, -3.0, 3.0) == (*RED, 255)
    assert {colour_at(SQUARE, *at) for at in ((3.0, 3.0), (-3.0, -3.0), (3.0, -3.0))} == {
        (*BLUE, 255)
    }
    image = map_of(SQUARE)
    assert image is not None
    assert image.bounds == SQUARE.bounds
    assert image.metres_per_pixel == pytest.approx((10 / 1200, 10 / 1200))


def test_matrices_of_rows_and_columns(photograph: Path, tmp_path: Path) -> None:
    add_map(SQUARE, photograph, written(STRAIGHT[:, [1, 0, 2]], tmp_path), row_first=True)
    assert colour_at(SQUARE, -3.0, 3.0) == (*RED, 255)
    assert colour_at(SQUARE, 3.0, 3.0) == (*BLUE, 255)


@given(st.lists(st.floats(-0.2, 0.2), min_size=8, max_size=8))
def test_the_floor_has_the_colours_of_the_pixels_that_show_it(noise: list[float]) -> None:
    """A camera at any angle, and a photograph whose colours tell column and row."""
    scale = np.array([0.5, 0.5, 5, 0.5, 0.5, 5, 0.05, 0.05])
    matrix = STRAIGHT + np.append(scale * noise, 0).reshape(3, 3)
    pixels = np.zeros((PIXELS, PIXELS, 3), np.uint8)
    column, row = np.meshgrid(np.arange(PIXELS), np.arange(PIXELS))
    pixels[..., 0], pixels[..., 1] = 10 * column, 10 * row
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("crowdbench.registry.map_images.LONGEST_PX", 60)
        found, covered = warped(pixels, matrix, SQUARE.bounds)
    assert found.shape == (60, 60, 4)
    assert covered == pytest.approx((found[..., 3] > 0).mean())
    x, y = np.meshgrid((np.arange(60) + 0.5) / 6 - 5, 5 - (np.arange(60) + 0.5) / 6)
    seen = np.linalg.solve(matrix, np.stack([x.ravel(), y.ravel(), np.ones(3600)]))
    at = (seen[:2] / seen[2]).T.reshape(60, 60, 2)
    ahead = seen[2].reshape(60, 60) * (matrix[2] @ (10, 10, 1)) > 1e-6
    clearly = ahead & (at > 0.01).all(axis=-1) & (at < PIXELS - 1.01).all(axis=-1)
    assert (found[clearly, 3] == 255).all()
    np.testing.assert_allclose(found[clearly, :2], 10 * at[clearly], atol=0.51)
    outside = ~ahead | (at < -0.51).any(axis=-1) | (at > PIXELS - 0.49).any(axis=-1)
    assert (found[outside] == 0).all()


def test_what_is_behind_the_camera_is_not_shown() -> None:
    pixels = np.full((PIXELS, PIXELS, 3), 90, np.uint8)
    camera = np.array([[1.0, 0, -10], [0, 1e-6, 4], [0, 0.2, 1]])  # which looks along y
    found, covered = warped(pixels, camera, Bounds(-50, 50, -50, 50))
    upper, lower = found[:600, :, 3], found[600:, :, 3]
    assert upper.any()
    assert not lower.any()  # y < 0 has no image ahead of this camera
    assert 0 < covered < 0.5


def test_what_does_not_show_the_place_is_refused(photograph: Path, tmp_path: Path) -> None:
    beside = STRAIGHT + np.array([[0, 0, 100.0], [0, 0, 0], [0, 0, 0]])
    with pytest.raises(SceneError, match=r"shows 0\.0% of square-v0 .* Try with --row-first"):
        add_map(SQUARE, photograph, written(beside, tmp_path))
    with pytest.raises(SceneError, match="got no image; expected a picture"):
        add_map(SQUARE, tmp_path / "H.txt", tmp_path / "H.txt")
    with pytest.raises(SceneError, match="got no such file"):
        add_map(SQUARE, tmp_path / "none.png", tmp_path / "H.txt")
    with pytest.raises(RecordingError, match="three rows of three numbers"):
        add_map(SQUARE, photograph, photograph)
    assert not map_path(SQUARE).exists()


def test_a_damaged_map_says_how_to_mend_it(photograph: Path, tmp_path: Path) -> None:
    path = add_map(SQUARE, photograph, written(STRAIGHT, tmp_path))
    path.write_bytes(path.read_bytes()[:400])
    with pytest.raises(SceneError, match="Add it again with `crowdbench scene map"):
        map_of(SQUARE)
    Image.new("RGB", (4, 4)).save(path)  # another image, without bounds
    with pytest.raises(SceneError, match="Add it again"):
        map_of(SQUARE)


def test_pictures_and_the_environment_show_the_map(photograph: Path, tmp_path: Path) -> None:
    axis = Figure().subplots()
    panels.place(axis, SQUARE)
    plain = np.array(Canvas(SQUARE).empty)
    assert len(axis.images) == 0
    add_map(SQUARE, photograph, written(STRAIGHT, tmp_path))
    axis = Figure().subplots()
    panels.place(axis, SQUARE)
    (image,) = axis.images
    assert image.get_extent() == [-5, 5, -5, 5]
    assert (axis.get_xlim(), axis.get_ylim()) == ((-5, 5), (-5, 5))
    mapped = np.array(Canvas(SQUARE).empty)
    assert mapped.shape == plain.shape
    height, width = mapped.shape[:2]
    faded = [(255 + c) // 2 for c in RED]
    assert np.abs(mapped[height // 4, width // 3] - np.array(faded)).max() <= 2


def test_pages_of_the_repository_show_none(
    photograph: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_map(SQUARE, photograph, written(STRAIGHT, tmp_path))
    monkeypatch.setenv("CROWDBENCH_MAPS", "off")
    assert map_of(SQUARE) is None
    monkeypatch.delenv("CROWDBENCH_MAPS")
    say = "import studies, os; print(os.environ['CROWDBENCH_MAPS'])"
    root = Path(__file__).parents[2]
    ran = subprocess.run([sys.executable, "-c", say], capture_output=True, text=True, cwd=root)
    assert ran.stdout.strip() == "off"


def test_images_are_faded_on_light_and_dark(photograph: Path, tmp_path: Path) -> None:
    shifted = STRAIGHT + np.array([[0, 0, 5.0], [0, 0, 0], [0, 0, 0]])
    add_map(SQUARE, photograph, written(shifted, tmp_path))
    image = map_of(SQUARE)
    assert image is not None
    left, right = image.on(WHITE)[900, 100], image.on(WHITE)[900, 1100]
    assert left.tolist() == [255] * 3
    assert np.abs(right - (255 + np.array(BLUE)) / 2).max() <= 0.5
    assert image.on(DARK)[600, 100].tolist() == [DARK] * 3


def test_players_hold_the_map_if_asked(photograph: Path, tmp_path: Path) -> None:
    from crowdbench.policies import Straight
    from crowdbench.registry import spawn_model
    from crowdbench.run.rollout import rollout

    eth = load_scene("eth-v0")
    crowd = rollout(eth, spawn_model("poisson-gmm", eth), Straight(), seed=0, horizon_s=40.0)
    clips = [("one", clip_of(crowd, eth))]
    whole = np.array([[1.0, 0, -8], [0, -1, 12], [0, 0, 1]])
    add_map(eth, photograph, written(whole, tmp_path))
    assert "data:image/jpeg;base64," in player(eth, clips, map_of(eth))
    assert "data:image" not in player(eth, clips)


def test_the_command(photograph: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    matrix = str(written(np.array([[1.0, 0, -8], [0, -1, 12], [0, 0, 1]]), tmp_path))
    eth = load_scene("eth-v0")
    assert main(["scene", "map", "eth-v0"]) == 2
    assert "got no IMAGE" in capsys.readouterr().err
    assert main(["scene", "map", "eth-v0", str(photograph)]) == 2
    assert "got no --homography" in capsys.readouterr().err
    assert main(["scene", "map", "eth-v0", str(photograph), "--homography", matrix]) == 0
    assert map_path(eth).exists()
    assert main(["scene", "map", "eth-v0", str(photograph), "--remove"]) == 2
    assert "got --remove and an image" in capsys.readouterr().err
    assert map_path(eth).exists()
    assert main(["scene", "map", "eth-v0", "--remove"]) == 0
    assert not map_path(eth).exists()
    assert main(["scene", "map", "eth-v0", "--remove"]) == 0
