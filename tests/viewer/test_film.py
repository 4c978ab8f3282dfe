"""Films of crowds: each frame shows the people of the table, and no half a film is left behind."""

import resource
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pages
import pytest
from conftest import need
from PIL import Image, ImageSequence
from worlds import square

from crowdbench.cli import main
from crowdbench.colours import goal_colour
from crowdbench.data.storage import write_csv, write_parquet
from crowdbench.data.table import Trajectories, from_rows
from crowdbench.errors import OutputError, SettingError
from crowdbench.viewer.film import record
from crowdbench.viewer.place import rgb

PER_M = (640 - 24) / 20.0
FRAMES = 50


@pytest.fixture
def crowd() -> Trajectories:
    """One person who walks 0.2 m in a frame, seen in all frames but ten."""
    frame = np.arange(FRAMES)
    xy = np.stack([-5.0 + 0.2 * frame, np.full(FRAMES, 3.0)], axis=1)
    return from_rows(
        scene="plaza-v0", dt_s=0.4, person_id=np.zeros(FRAMES, np.int64), frame=frame, xy=xy,
        observed=np.array([[0, 30], [40, FRAMES]]),
        persons={"goal_area": np.full(FRAMES, 2), "goal_y": np.full(FRAMES, -8.0)},
        where="test",
    )  # fmt: skip


def column_of(picture: np.ndarray) -> float:
    """Where the person's disc is, from the left."""
    row = round(12 + PER_M * (10.0 - 3.0))
    near = np.abs(picture[row].astype(int) - rgb(goal_colour(2))).sum(axis=-1) < 40
    return float(np.flatnonzero(near).max())


def frames_of(path: Path) -> list[np.ndarray]:
    if path.suffix == ".gif":
        with Image.open(path) as film:
            return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(film)]
    from imageio_ffmpeg import get_ffmpeg_exe

    decode = [get_ffmpeg_exe(), "-v", "error", "-i", str(path), "-f", "rawvideo"]
    done = subprocess.run([*decode, "-pix_fmt", "rgb24", "-"], capture_output=True, check=True)
    return list(np.frombuffer(done.stdout, np.uint8).reshape(-1, 640, 640, 3))


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_film_shows_the_chosen_frames_in_their_time(
    crowd: Trajectories, suffix: str, tmp_path: Path
) -> None:
    if suffix == ".mp4":
        need(find_spec("imageio_ffmpeg"), "imageio-ffmpeg, of the extra video,")
    path = tmp_path / "deep" / f"film{suffix}"
    seen: list[tuple[int, int]] = []
    record(
        crowd, square(10.0), path, from_s=4.0, length_s=4.0, speed=2.0,
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    frames = frames_of(path)
    assert len(frames) == 10  # from the tenth on
    assert seen == [(k, 10) for k in range(11)]
    for k, frame in enumerate(frames):
        expected = 12 + PER_M * (10.0 - 5.0 + 0.2 * (10 + k) + 0.3)  # the disc's right edge
        assert column_of(frame) == pytest.approx(expected, abs=2.5)
    if suffix == ".gif":
        with Image.open(path) as film:
            assert film.info["duration"] == 200  # 0.4 s at twice the speed
            assert film.info["loop"] == 0  # for ever
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_a_film_ends_with_the_crowd_and_says_what_nobody_saw(
    crowd: Trajectories, tmp_path: Path
) -> None:
    record(crowd, square(10.0), tmp_path / "film.gif", from_s=11.2)
    frames = frames_of(tmp_path / "film.gif")
    assert len(frames) == FRAMES - 28
    written = [int((frame[12:40, 12:200].sum(axis=2) < 300).sum()) for frame in frames]
    assert min(written[3:11]) > 1.1 * max(written[0], written[-1])  # "not observed" is longer


BAD = {
    "no format": ({"path": "film.avi"}, r"got 'film.avi'; expected a name that ends in .gif or"),
    "no suffix": ({"path": "film"}, "expected a name that ends in"),
    "too fast": ({"speed": 30.0}, "speed: got 30; expected more than 0 and at most 20 times"),
    "still": ({"speed": 0.0}, "speed: got 0"),
    "too late": ({"from_s": 20.0}, "from_s: got 20; expected a time in the crowd, 0 to 20 s"),
    "too early": ({"from_s": -1.0}, "from_s: got -1"),
    "no number": ({"from_s": float("nan")}, "from_s: got nan"),
    "no length": ({"length_s": 0.0}, "length_s: got 0; expected a positive number"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_filmed_is_said(what: str, crowd: Trajectories, tmp_path: Path) -> None:
    asked, message = BAD[what]
    path = tmp_path / str(asked.get("path", "film.gif"))
    others = {name: value for name, value in asked.items() if name != "path"}
    with pytest.raises(SettingError, match=message):
        record(crowd, square(10.0), path, **others)
    assert list(tmp_path.iterdir()) == []


def test_without_ffmpeg_it_is_said_how_to_install_it(
    crowd: Trajectories, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # what is not installed
    monkeypatch.setattr("crowdbench.viewer.film.find_spec", lambda name: None)
    with pytest.raises(SettingError, match=r'-e "\.\[video\]".*Or write a \.gif'):
        record(crowd, square(10.0), tmp_path / "film.mp4")


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_no_half_a_film_is_left_on_a_full_disk(
    crowd: Trajectories, suffix: str, tmp_path: Path
) -> None:
    if suffix == ".mp4":
        need(find_spec("imageio_ffmpeg"), "imageio-ffmpeg, of the extra video,")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
    try:
        with pytest.raises(OutputError, match="film"):
            record(crowd, square(10.0), tmp_path / f"film{suffix}", length_s=4.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []


def test_the_command_films_a_rollout_and_a_table_of_others(
    crowd: Trajectories, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_parquet(crowd, tmp_path / "rollout.parquet")
    write_csv(crowd, tmp_path / "mine.csv")
    short = ["--length-s", "2", "--from-s", "4"]
    for table, named in (("rollout.parquet", []), ("mine.csv", ["--scene", "plaza-v0"])):
        out = tmp_path / f"{table}.gif"
        assert main(["record", str(tmp_path / table), str(out), *named, *short]) == 0
        assert f"written to {out}" in capsys.readouterr().out
        assert len(frames_of(out)) == 5
    assert main(["record", str(tmp_path / "rollout.parquet"), str(tmp_path / "x.webm")]) == 2
    assert "ends in .gif or .mp4" in capsys.readouterr().err
    assert not (tmp_path / "x.webm").exists()


PAGE = (Path(__file__).parents[2] / "docs" / "viewer.md").read_text()


@pytest.mark.long
def test_the_pages_example_films_each_tenth_trip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need(find_spec("moviepy"), "moviepy, of the extra video,")
    monkeypatch.chdir(tmp_path)
    exec(compile(pages.block_with(PAGE, "RecordVideo("), "viewer.md", "exec"), {})
    assert [path.suffix for path in Path("films").iterdir() if path.suffix != ".json"] == [".mp4"]
