"""Films of a finished crowd: an animated GIF, or a video (MP4)."""

import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError, SettingError, to_install
from crowdbench.files import replacing
from crowdbench.scene import Scene
from crowdbench.viewer.picture import Now, Pictures, trails

Picture = UInt8[np.ndarray, "h w 3"]
FASTEST_FPS = 50.0
"""Browsers show GIFs no faster."""


def record(
    crowd: Trajectories,
    scene: Scene,
    path: Path,
    *,
    from_s: float = 0.0,
    length_s: float = 60.0,
    speed: float = 4.0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Write a film of a crowd, seen from above. An incomplete file is never left behind.

    Args:
        crowd: the trajectories to show.
        scene: their scene.
        path: the file; its suffix `.gif` or `.mp4` is the format.
        from_s: time in the crowd at which the film begins, seconds.
        length_s: length in the crowd, seconds; the film ends with the crowd at the latest.
        speed: the film runs so many times as fast as the crowd.
        progress: called with the number of frames done and their total.

    Raises:
        SettingError: a value is out of range, or the extra `video` is not installed (MP4 only).
        OutputError: the file cannot be written.
    """
    frames = _frames(crowd, from_s, length_s)
    fps = speed / crowd.dt_s
    if not 0 < fps <= FASTEST_FPS:  # false for NaN
        expected = f"more than 0 and at most {FASTEST_FPS * crowd.dt_s:g} times real time"
        raise SettingError("speed", got=f"{speed:g}", expected=expected)
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    write = writers.get(path.suffix.lower())
    if write is None:
        expected = f"a name that ends in {' or '.join(writers)}"
        raise SettingError("format of the film", got=repr(path.name), expected=expected)
    if write is _write_mp4:
        _check_ffmpeg()
    with replacing(path) as temporary:
        write(drawn(crowd, scene, frames, progress), fps, temporary)


def _frames(crowd: Trajectories, from_s: float, length_s: float) -> range:
    """The frames of a crowd in an interval.

    Raises:
        SettingError: there are none.
    """
    if not 0 <= from_s < crowd.duration_s:
        expected = f"a time in the crowd, 0 to {crowd.duration_s:g} s"
        raise SettingError("from_s", got=f"{from_s:g}", expected=expected)
    if not length_s > 0:
        raise SettingError("length_s", got=f"{length_s:g}", expected="a positive number of seconds")
    first = int(from_s / crowd.dt_s + 1e-9)
    stop = min((from_s + length_s) / crowd.dt_s - 1e-9, crowd.frames - 1)
    return range(first, int(stop) + 1)


def drawn(
    crowd: Trajectories,
    scene: Scene,
    frames: range,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    areas: bool = True,
) -> Iterator[Picture]:
    """A picture of each of these frames of a crowd.

    `progress` is that of `record`, `areas` that of `Pictures`.
    """
    pictures, known = Pictures(scene, areas=areas), crowd.is_observed()
    row_frame, row_person = crowd.row_frame(), crowd.row_person()
    order = np.argsort(row_frame, kind="stable")
    starts = np.searchsorted(row_frame[order], np.arange(crowd.frames + 1))
    for done, frame in enumerate(frames):
        progress(done, len(frames))
        rows = order[starts[frame] : starts[frame + 1]]
        here = row_person[rows]
        now = Now(
            frame=frame,
            person_id=crowd.person_id[here],
            goal_area=crowd.goal_area[here],
            group=crowd.group[here],
            xy=crowd.xy[rows],
            target=crowd.goal[here],
            trail=trails(crowd, rows, crowd.offsets[here]),
            born=crowd.first[here],
            spawned=crowd.first[here] == frame,
            ended=np.zeros(len(here), np.int64),
        )
        yield pictures.draw(now, observed=bool(known[frame]))
    progress(len(frames), len(frames))


def _write_gif(pictures: Iterator[Picture], fps: float, path: Path) -> None:
    # Of few colours: what is smoothed at edges needs some between those that are drawn.
    images = (Image.fromarray(picture).quantize(64) for picture in pictures)
    next(images).save(
        path, format="GIF", save_all=True, append_images=images, duration=1000 / fps, loop=0
    )


def _check_ffmpeg() -> None:
    if find_spec("imageio_ffmpeg") is None:
        raise SettingError(
            "an MP4 film",
            got="no ffmpeg",
            expected="the package imageio-ffmpeg",
            hint=f"{to_install('video')} Or write a .gif.",
        )


def _write_mp4(pictures: Iterator[Picture], fps: float, path: Path) -> None:
    first = next(pictures)
    height, width, _ = first.shape
    with _ffmpeg(width, height, fps, path) as write:
        write(first.tobytes())
        for picture in pictures:
            write(picture.tobytes())


@contextmanager
def _ffmpeg(width: int, height: int, fps: float, path: Path) -> Iterator[Callable[[bytes], object]]:
    """Yield a function that writes a picture to an MP4 file.

    Raises:
        OutputError: ffmpeg could not write the file.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}"]
    # yuv420p is what all players show; 18 is the quality at which lines look sharp.
    made = ["-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    command = [get_ffmpeg_exe(), "-v", "error", "-y", *given, "-i", "-", *made, str(path.resolve())]
    with (
        tempfile.TemporaryFile() as told,
        subprocess.Popen(command, stdin=subprocess.PIPE, stderr=told) as process,
    ):
        assert process.stdin is not None  # a pipe
        try:
            yield process.stdin.write
            process.stdin.close()
        except BrokenPipeError:  # ffmpeg has ended, and says why
            pass
        except BaseException:
            process.kill()
            raise
        if process.wait() != 0:
            told.seek(0)
            lines = told.read().decode(errors="replace").strip().splitlines()
            got = lines[-1] if lines else f"ffmpeg's exit code {process.returncode}"
            raise OutputError(path, got=got, expected="a film", hint="Is the disk full?")
