"""A player of crowds in a page: a minute of two crowds side by side, seen from above.

The page holds the people's positions and needs no network. A clip takes about 50 kB where 300
people are present, and 3 kB at ETH.
"""

import json
from base64 import b64decode, b64encode
from collections.abc import Iterator, Sequence
from typing import Any
from zlib import compress, decompressobj

import msgspec
import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from crowdbench.colours import COLOURS
from crowdbench.data.stops import standing
from crowdbench.data.table import Trajectories
from crowdbench.registry.map_images import WHITE, MapImage
from crowdbench.report.html.render import html, own
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Gaussians, read_areas

LENGTH_S = 60.0
"""Length of a clip, seconds."""
LARGEST_BYTES = 250_000
"""Clips of one player take at most this much of a page of 400 kB."""
_UNITS = 1000
"""Positions are multiples of the scene's longer side divided by this number."""
_MOST_FRAMES, _LARGEST_UNPACKED = 10_000, 10_000_000
SCRIPT, STYLE = own("player.js"), own("player.css")
"""JavaScript and CSS of a page with players."""


class Clip(msgspec.Struct, frozen=True, kw_only=True):
    """A minute of a crowd, as the player reads it."""

    start_s: float
    """Time in the crowd at which the clip begins, seconds."""
    frames: int
    unobserved: list[tuple[int, int]]
    """Intervals [start, stop) of the clip in which nobody looked, frames."""
    data: str
    """The people, packed (see `_packed`), deflated and in base 64."""


Labelled = tuple[str, Clip]
"""The name of a crowd, which may be anybody's text, and its clip."""


def busiest(crowd: Trajectories) -> int:
    """First frame of the minute in which most people are present, on average over the minute."""
    frames = _length(crowd)
    present = np.concatenate([[0], np.cumsum(np.where(crowd.is_observed(), crowd.present(), 0))])
    return int(np.argmax(present[frames:] - present[:-frames]))


def clip_of(crowd: Trajectories, scene: Scene, start: int | None = None) -> Clip:
    """The minute of a crowd from the frame `start` on; by default the busiest one."""
    start, frames = busiest(crowd) if start is None else start, _length(crowd)
    dark = np.concatenate([[False], ~crowd.is_observed()[start : start + frames], [False]])
    turns = np.flatnonzero(np.diff(dark.astype(np.int8))).tolist()
    data = compress(_packed(crowd, scene, start, start + frames), 9, -15)
    return Clip(
        start_s=round(start * crowd.dt_s, 3),
        frames=frames,
        unobserved=list(zip(turns[::2], turns[1::2], strict=True)),
        data=b64encode(data).decode(),
    )


def _length(crowd: Trajectories) -> int:
    """Number of frames of a clip."""
    return min(round(LENGTH_S / crowd.dt_s) + 1, crowd.frames)


def fitting(clips: Sequence[Labelled]) -> list[Labelled]:
    """The first clips, as many as a player may hold, but at least one."""
    total = np.cumsum([len(clip.data) for _, clip in clips])
    return list(clips[: max(1, int((total <= LARGEST_BYTES).sum()))])


def check_clip(clip: Clip) -> None:
    """Check that the player can read a clip.

    Raises:
        ValueError: it is damaged.
    """
    if not 1 <= clip.frames <= _MOST_FRAMES:
        raise ValueError(f"{clip.frames} frames")
    inflater = decompressobj(-15)
    data = inflater.decompress(b64decode(clip.data, validate=True), _LARGEST_UNPACKED)
    if not inflater.eof:
        raise ValueError("data that is cut off or too large")
    numbers = _numbers(data)
    at = 0
    while at < len(numbers):
        first, length, goal, group, runs = (numbers[at : at + 5] + [-1] * 5)[:5]
        stands = numbers[at + 5 : at + 5 + runs] if runs >= 0 else []
        at += 5 + max(runs, 0) + 2 * length
        inside = first >= 0 and length >= 1 and first + length <= clip.frames
        if not inside or goal < 0 or group < 0 or min(stands, default=-1) < 0:
            raise ValueError("a person outside the clip")
        if sum(stands) != length or at > len(numbers):
            raise ValueError("a person without all positions")


def player(scene: Scene, clips: Sequence[Labelled], image: MapImage | None = None) -> Markup:
    """HTML of a player, which draws on an image of the floor; its page needs `SCRIPT` and `STYLE`.

    The first two clips are shown; readers choose others from a list. Clips beyond `LARGEST_BYTES`
    are left out, which the caption says.
    """
    areas, kept = read_areas(scene), fitting(clips)
    b = scene.bounds
    content = {
        "bounds": [b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m],
        "dt": scene.dt_s,
        "unit": _unit(scene),
        "radius": scene.motion.person_radius_m,
        "walls": [_rounded(np.array(wall.corners_m)) for wall in scene.walls],
        "spawns": _outlines(areas.spawn),
        "goals": _outlines(areas.goal),
        "colours": COLOURS,
        "clips": [{"label": label, **msgspec.to_builtins(clip)} for label, clip in kept],
    }
    if image is not None:
        b = image.bounds
        content["map"] = {
            "image": _data_url(image),
            "bounds": [b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m],
        }
    # Nothing in a label may end the element.
    text = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
    return html(
        "player.html.j2",
        scene=scene,
        labels=[label for label, _ in kept],
        content=Markup(text),
        shown=[0, 1][: len(kept)],
        left_out=len(clips) - len(kept),
        length=f"{max(clip.frames for _, clip in kept) * scene.dt_s:.0f}",
    )


def _data_url(image: MapImage) -> str:
    return f"data:image/jpeg;base64,{b64encode(image.jpeg(WHITE)).decode()}"


def _unit(scene: Scene) -> float:
    b = scene.bounds
    return max(b.x_max_m - b.x_min_m, b.y_max_m - b.y_min_m) / _UNITS


def _outlines(areas: Gaussians) -> list[Any]:
    return [_rounded(areas.outline(k)[::3]) for k in range(len(areas))]


def _rounded(points: Float[np.ndarray, "n 2"]) -> list[list[float]]:
    return [[round(x, 2), round(y, 2)] for x, y in points.tolist()]


def _packed(crowd: Trajectories, scene: Scene, start: int, stop: int) -> bytes:
    """The people present in frames [start, stop), as whole numbers of variable length.

    Each person has: first frame in the clip, number of frames n, goal area + 1, number of the
    group + 1 (0: alone), number of runs r, the lengths of r runs of frames in which the person by
    turns walks and stands, and second differences of x and of y (n each, from 0), in units.
    """
    corner, unit = np.array([scene.bounds.x_min_m, scene.bounds.y_min_m]), _unit(scene)
    stands = standing(crowd)
    groups: dict[int, int] = {-1: 0}
    out = bytearray()
    for k in np.flatnonzero((crowd.first < stop) & (crowd.last >= start)).tolist():
        first, last = max(int(crowd.first[k]), start), min(int(crowd.last[k]), stop - 1)
        at = int(crowd.offsets[k]) - int(crowd.first[k])
        rows = slice(at + first, at + last + 1)
        group = groups.setdefault(int(crowd.group[k]), len(groups))
        runs = _runs(stands[rows].tolist())
        numbers = [first - start, last + 1 - first, int(crowd.goal_area[k]) + 1, group, len(runs)]
        numbers += runs
        for line in np.rint((crowd.xy[rows] - corner) / unit).astype(np.int64).T:
            numbers += np.diff(line, n=2, prepend=[0, 0]).tolist()
        out += bytes(_bytes_of(numbers))
    return bytes(out)


def _runs(stands: list[bool]) -> list[int]:
    """Lengths of runs of equal values; the first is of False, perhaps 0."""
    lengths, value = [0], False
    for each in stands:
        if each != value:
            lengths.append(0)
            value = each
        lengths[-1] += 1
    return lengths


def _numbers(data: bytes) -> list[int]:
    """The numbers of which `_bytes_of` made these bytes.

    Raises:
        ValueError: the last number is cut off.
    """
    numbers, value, shift = [], 0, 0
    for byte in data:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            numbers.append(-(value + 1) // 2 if value % 2 else value // 2)
            value = shift = 0
    if shift:
        raise ValueError("a number that is cut off")
    return numbers


def _bytes_of(numbers: Sequence[int]) -> Iterator[int]:
    """Seven bits per byte, the lowest first; the sign is the lowest bit of a number."""
    for number in numbers:
        rest = 2 * number if number >= 0 else -2 * number - 1
        while rest > 127:
            yield rest & 127 | 128
            rest >>= 7
        yield rest
