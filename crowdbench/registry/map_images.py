"""Images of places, seen from above, which are drawn under figures, viewer and player.

A photograph that a camera took is warped to the floor by the homography of its recording. The
warped image is kept on this machine, in the folder `maps` of `CROWDBENCH_HOME`: it is no part of
the scene, and nothing that is published shows it. `CROWDBENCH_MAPS=off` shows none.
"""

import io
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, PngImagePlugin, UnidentifiedImageError

from crowdbench.data.recordings.placing import matrix_of
from crowdbench.errors import SceneError
from crowdbench.files import home, read_bytes, replacing
from crowdbench.scene import Bounds, Scene

LONGEST_PX = 1200
FADED = 0.5
"""Share of the background that is mixed into images, so that what is drawn on them is seen."""
WHITE, DARK = 255, 17
_LEAST_COVERED = 0.05
_BOUNDS = "bounds"


@dataclass(frozen=True, eq=False)
class MapImage:
    """An image of the floor whose first row is at the greatest y."""

    pixels: UInt8[np.ndarray, "h w 4"]
    """Red, green, blue, and 255 where the photograph shows the place, else 0."""
    bounds: Bounds
    """What it covers, metres."""

    @property
    def metres_per_pixel(self) -> tuple[float, float]:
        """Along x and y."""
        (height, width), b = self.pixels.shape[:2], self.bounds
        return (b.x_max_m - b.x_min_m) / width, (b.y_max_m - b.y_min_m) / height

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top, as `imshow` of matplotlib wants them."""
        b = self.bounds
        return b.x_min_m, b.x_max_m, b.y_min_m, b.y_max_m

    def on(self, background: int) -> UInt8[np.ndarray, "h w 3"]:
        """The image, faded, on a grey background from 0 to 255."""
        share = (1 - FADED) * (self.pixels[..., 3:] / 255)
        return np.round(background + share * (self.pixels[..., :3] - float(background))).astype(
            np.uint8
        )

    def jpeg(self, background: int) -> bytes:
        """The image, faded, on a background, as a JPEG file."""
        file = io.BytesIO()
        Image.fromarray(self.on(background)).save(file, "jpeg", quality=80)
        return file.getvalue()


def map_path(scene: Scene) -> Path:
    """Where the image of a scene is kept."""
    return home() / "maps" / f"{scene.id}.png"


def map_of(scene: Scene) -> MapImage | None:
    """The image of a scene's place, if one was added with `add_map` on this machine.

    Raises:
        SceneError: its file is damaged.
    """
    path = map_path(scene)
    if os.environ.get("CROWDBENCH_MAPS") == "off" or not path.is_file():
        return None
    try:
        with Image.open(path) as image:
            pixels, text = np.asarray(image.convert("RGBA")), image.info[_BOUNDS]
        return MapImage(pixels, Bounds(*map(float, text.split())))
    except (OSError, ValueError, KeyError, TypeError, Image.DecompressionBombError) as error:
        hint = f"Add it again with `crowdbench scene map {scene.asked} IMAGE --homography FILE`."
        raise SceneError(path, got=str(error), expected="a map image", hint=hint) from error


def add_map(scene: Scene, image: Path, homography: Path, *, row_first: bool = False) -> Path:
    """Warp a photograph to the floor and keep it as the map of a scene; returns its path.

    Args:
        scene: the scene, whose bounds are kept.
        image: a picture of the place, PNG or JPEG.
        homography: text file with the 3 × 3 matrix that maps (column, row, 1) of a pixel's centre
            to metres on the floor, in homogeneous coordinates.
        row_first: the matrix maps (row, column, 1), as those of ETH's recordings do.

    Raises:
        SceneError: the image cannot be read, or shows next to nothing of the scene.
        RecordingError: the matrix cannot be read or inverted.
        OutputError: the map cannot be written.
    """
    content = read_bytes(image, SceneError, "")
    try:
        with Image.open(io.BytesIO(content)) as opened:
            taken = opened.convert("RGB")
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        got = "no image" if isinstance(error, UnidentifiedImageError) else f"{error}"
        raise SceneError(image, got=got, expected="a picture, such as PNG or JPEG") from error
    matrix = matrix_of(homography)
    if row_first:
        matrix = matrix[:, [1, 0, 2]]
    pixels, covered = warped(np.asarray(taken), matrix, scene.bounds)
    if covered < _LEAST_COVERED:
        other = "without" if row_first else "with"
        raise SceneError(
            image,
            got=f"a picture that shows {covered:.1%} of {scene.id} through {homography}",
            expected="a picture of the place, and the matrix from its pixels to metres",
            hint=f"Try {other} --row-first: some matrices map (row, column).",
        )
    path, told = map_path(scene), PngImagePlugin.PngInfo()
    b = scene.bounds
    told.add_text(_BOUNDS, f"{b.x_min_m} {b.x_max_m} {b.y_min_m} {b.y_max_m}")
    with replacing(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="png", pnginfo=told)
    return path


def warped(
    pixels: UInt8[np.ndarray, "h w 3"], matrix: Float[np.ndarray, "3 3"], bounds: Bounds
) -> tuple[UInt8[np.ndarray, "H W 4"], float]:
    """A picture as seen from above within the bounds, and the share of them that it shows.

    `matrix` maps (column, row, 1) to metres. What the picture does not show is transparent.
    """
    from scipy.ndimage import map_coordinates  # slow to import

    wide_m, high_m = bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m
    per_px = max(wide_m, high_m) / LONGEST_PX
    size = max(1, round(wide_m / per_px)), max(1, round(high_m / per_px))
    x = bounds.x_min_m + (np.arange(size[0]) + 0.5) * wide_m / size[0]
    y = bounds.y_max_m - (np.arange(size[1]) + 0.5) * high_m / size[1]
    height, width = pixels.shape[:2]
    floor = np.stack([*np.meshgrid(x, y), np.ones(size[::-1])], axis=-1)
    column, row, depth = np.moveaxis(floor @ np.linalg.inv(matrix).T, -1, 0)
    # Points behind the camera have the other sign than those that the picture shows.
    middle = matrix[2] @ (width / 2, height / 2, 1.0)
    ahead = depth * np.sign(middle) > 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        column, row = column / depth, row / depth
    inside = ahead & (column > -0.5) & (column < width - 0.5) & (row > -0.5) & (row < height - 0.5)
    found = np.zeros((*inside.shape, 4), np.uint8)
    at = np.stack([row[inside], column[inside]])
    for k in range(3):
        colour = pixels[..., k].astype(np.float64)
        found[inside, k] = np.round(map_coordinates(colour, at, order=1, mode="nearest"))
    found[inside, 3] = 255
    return found, float(inside.mean())
