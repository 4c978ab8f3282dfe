"""The README's moving picture: the simplest crowd of Grand Central beside the best one.

    python -m studies moving-picture

shows, of each crowd, the busiest seconds of its first minutes, at three times their speed.
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import crowdbench
from crowdbench.data.table import Trajectories
from crowdbench.files import replacing
from crowdbench.scene import Scene, load_scene
from crowdbench.viewer.film import Picture, drawn

SCENE = "gc-v0"
CROWDS = (("poisson-gmm", "straight"), ("cox-plans", "anticipate"))
HORIZON_S, LENGTH_S, SPEED = 600.0, 24.0, 3.0
HEIGHT_PX = 480
_TITLE_PX, _GAP_PX = 26, 12


def write_moving_picture(out: Path) -> Path:
    """Simulate the crowds, and write them as an animated WebP; returns its path.

    Raises:
        OutputError: the file cannot be written.
    """
    scene = load_scene(SCENE)
    sides = [_side(scene, *pair) for pair in CROWDS]
    images = [Image.fromarray(np.hstack(pair)) for pair in zip(*sides, strict=True)]
    with replacing(out) as temporary:
        images[0].save(
            temporary,
            format="WEBP",
            save_all=True,
            append_images=images[1:],
            duration=round(1000 * scene.dt_s / SPEED),
            loop=0,
            quality=60,
            method=6,
            minimize_size=True,
        )
    return out


def _side(scene: Scene, spawn: str, policy: str) -> list[Picture]:
    crowd = crowdbench.rollout(scene, spawn, policy, seed=0, horizon_s=HORIZON_S)
    frames = _busiest(crowd, round(LENGTH_S / crowd.dt_s))
    pictures = drawn(crowd, scene, frames, areas=False)
    return [_titled(picture, f"{spawn} + {policy}") for picture in pictures]


def _busiest(crowd: Trajectories, length: int) -> range:
    """The frames in which most people are present, on average."""
    total = np.concatenate([[0], np.cumsum(crowd.present())])
    start = int(np.argmax(total[length:] - total[:-length]))
    return range(start, start + length)


def _titled(picture: Picture, title: str) -> Picture:
    """The picture, smaller, below a title."""
    image = Image.fromarray(picture)
    width = round(image.width * HEIGHT_PX / image.height)
    small = image.resize((width, HEIGHT_PX), Image.Resampling.LANCZOS)
    page = Image.new("RGB", (width + _GAP_PX, HEIGHT_PX + _TITLE_PX), "white")
    page.paste(small, (_GAP_PX // 2, _TITLE_PX))
    place = (page.width / 2, _TITLE_PX / 2)
    ImageDraw.Draw(page).text(place, title, "black", font=ImageFont.load_default(16), anchor="mm")
    return np.asarray(page)
