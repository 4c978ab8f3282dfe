"""Formats with positions in pixels: splines of UCY, and boxes of the Stanford Drone Dataset."""

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.recordings.mending import Stamped
from crowdbench.data.recordings.text_rows import numbered
from crowdbench.errors import RecordingError

UCY_FPS = 25.0
UCY_SIZE = (720, 576)
"""Width and height of the videos of UCY, in pixels."""
SDD_FPS = 30.0
PEDESTRIAN = "Pedestrian"
_SPLINES = "`N - the number of splines`, then for each person the number of points and its points"


def parse_vsp(data: bytes, where: object) -> tuple[Stamped, float]:
    """The control points of a file of splines, and seconds of a frame of the video.

    A control point is `x y frame gaze` with the origin in the middle of the image, x to the right
    and y up. Positions are returned for each frame of the video, as row and column of the image,
    which the published homographies of UCY take.

    Raises:
        RecordingError: the file is broken, or it has no person.
    """
    lines = [line.split(" - ")[0].split() for line in _text(data).splitlines()]
    lines = [words for words in lines if words]
    person: list[int] = []
    points: list[list[float]] = []
    at = 1
    try:
        for k in range(int(lines[0][0])):
            number = int(lines[at][0])
            for words in lines[at + 1 : at + 1 + number]:
                person.append(k)
                points.append([float(word) for word in words[:3]])
            at += 1 + number
    except (ValueError, IndexError) as error:
        expected = f"UCY's splines: {_SPLINES}"
        raise RecordingError(where, got=str(error), expected=expected) from error
    if not len(points) or at > len(lines):
        got = "fewer rows than stated" if at > len(lines) else "no person"
        raise RecordingError(where, got=got, expected=f"UCY's splines: {_SPLINES}")
    at_points, of = np.array(points, dtype=np.float64), np.array(person, dtype=np.int64)
    splines = [_between(at_points[of == k]) for k in np.unique(of)]
    x, y, frame = np.concatenate(splines).T
    row_column = np.stack([UCY_SIZE[1] / 2 - y, UCY_SIZE[0] / 2 + x], axis=1)
    who: Int[np.ndarray, " R"] = np.repeat(
        np.arange(len(splines)), [len(spline) for spline in splines]
    )
    return Stamped(who, frame.astype(np.int64), row_column, "frame", 1.0), 1 / UCY_FPS


def _between(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Positions and frames from the first to the last point: a curve that does not overshoot."""
    from scipy.interpolate import PchipInterpolator

    _, first = np.unique(np.round(points[:, 2]), return_index=True)
    points = points[first]
    frame = np.round(points[:, 2])
    if len(points) < 2:
        return np.column_stack([points[:, :2], frame])
    every = np.arange(frame[0], frame[-1] + 1)
    return np.column_stack([PchipInterpolator(frame, points[:, :2])(every), every])


def parse_sdd(data: bytes, where: object) -> tuple[Stamped, float]:
    """The middles of the boxes of pedestrians who are seen, and seconds from row to row.

    A row is `track xmin ymin xmax ymax frame lost occluded generated "label"`. Boxes out of the
    image (`lost`) are left out.

    Raises:
        RecordingError: a row is broken, or no pedestrian is seen.
    """
    boxes, tracks = [], []
    for number, line in enumerate(_text(data).splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        try:
            track, *box, frame, lost = (float(word) for word in words[:7])
            label = words[9].strip('"')
        except (ValueError, IndexError) as error:
            raise RecordingError(
                f"{where}, line {number}",
                got=str(error),
                expected='a row `track xmin ymin xmax ymax frame lost occluded generated "label"`',
            ) from error
        if label == PEDESTRIAN and not lost:
            tracks.append(track)
            boxes.append([*box, frame])
    if not boxes:
        raise RecordingError(where, got="no pedestrian", expected=f'rows with "{PEDESTRIAN}"')
    of = np.array(boxes, dtype=np.float64)
    xy = np.stack([of[:, [0, 2]].mean(axis=1), of[:, [1, 3]].mean(axis=1)], axis=1)
    rows = Stamped.of_frames(numbered(tracks), of[:, 4].astype(np.int64), xy)
    return rows, rows.step / SDD_FPS


def _text(data: bytes) -> str:
    return data.decode("utf-8-sig", "replace")
