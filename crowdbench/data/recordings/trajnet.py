"""The TrajNet++ format: one JSON object per line, either a position (`track`) or a scene.

A track has a frame `f`, a person `p`, and `x` and `y` in metres. A scene names a person whose path
from frame `s` to `e` is to be predicted, and the rows per second (`fps`), of which crowdbench uses
only the latter. Frame numbers are those of a video, so consecutive rows of a person are several
frame numbers apart.
"""

from pathlib import Path

import msgspec
import numpy as np

from crowdbench.data.recordings.mending import Stamped
from crowdbench.data.recordings.timing import plain_positions
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError
from crowdbench.files import write_text

_HINT = 'Lines look like {"track": {"f": 10, "p": 3, "x": 1.25, "y": 4.5}}.'


class _Track(msgspec.Struct, frozen=True):
    f: int
    p: int
    x: float
    y: float
    prediction_number: int | None = None


class _Scene(msgspec.Struct, frozen=True):
    fps: float | None = None


class _Line(msgspec.Struct, frozen=True):
    track: _Track | None = None
    scene: _Scene | None = None


def parse_trajnet(data: bytes, where: object) -> tuple[Stamped, float | None]:
    """The rows of a file, and seconds from one row of a person to the next if a scene states it.

    Raises:
        RecordingError: a line is broken, there are no tracks, the rates differ, or the tracks are
            predictions.
    """
    decoder = msgspec.json.Decoder(_Line)
    tracks, rates = [], set()
    for number, text in enumerate(data.splitlines(), start=1):
        if not text.strip():
            continue
        try:
            line = decoder.decode(text)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            expected = "a JSON object with a track or a scene"
            raise RecordingError(
                f"{where}, line {number}", got=str(error), expected=expected, hint=_HINT
            ) from error
        if line.scene is not None and line.scene.fps is not None:
            rates.add(line.scene.fps)
        if line.track is not None:
            if line.track.prediction_number is not None:
                raise RecordingError(
                    f"{where}, line {number}",
                    got="a predicted track",
                    expected="tracks of observed people",
                    hint="Use the file that the predictions were made from.",
                )
            tracks.append(line.track)
    if not tracks:
        raise RecordingError(where, got="no track", expected="at least one", hint=_HINT)
    if len(rates) > 1 or not all(0 < rate < np.inf for rate in rates):
        shown = ", ".join(f"{rate:g}" for rate in sorted(rates))
        got = f"scenes of {shown} rows per second"
        raise RecordingError(where, got=got, expected="the same positive rate in all scenes")
    person, frame = (np.array([getattr(track, name) for track in tracks]) for name in "pf")
    xy = np.array([(track.x, track.y) for track in tracks], dtype=np.float64)
    return Stamped.of_frames(person, frame, xy), 1 / rates.pop() if rates else None


def write_trajnet(crowd: Trajectories, path: Path) -> None:
    """Write the crowd with unchanged frame numbers, and one scene per person for its whole trip.

    Raises:
        OutputError: `path` cannot be written.
    """
    fps = round(1 / crowd.dt_s, 9)
    encode = msgspec.json.encode
    lines = [
        encode({"scene": {"id": k, "p": p, "s": s, "e": e, "fps": fps, "tag": 0}})
        for k, (p, s, e) in enumerate(
            zip(crowd.person_id.tolist(), crowd.first.tolist(), crowd.last.tolist(), strict=True)
        )
    ]
    ids = crowd.person_id[crowd.row_person()]
    lines += [
        encode({"track": {"f": f, "p": p, "x": x, "y": y}})
        for f, p, (x, y) in zip(
            crowd.row_frame().tolist(), ids.tolist(), plain_positions(crowd), strict=True
        )
    ]
    write_text(path, b"\n".join([*lines, b""]).decode())
