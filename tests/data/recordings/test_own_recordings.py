"""Recordings that nobody here has seen, in every format, and what is refused of them."""

import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import made_up
import numpy as np
import pytest
from strategies import crowd_of

from crowdbench.cli import main, options
from crowdbench.data.recordings.formats import FORMATS, WRITERS, read_recording
from crowdbench.data.recordings.own import import_own
from crowdbench.data.recordings.timing import at_scene_frames
from crowdbench.data.storage import columns_of, read_table, write_csv, write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import CrowdbenchError, RecordingError, SettingError
from crowdbench.registry import recording


@pytest.fixture(scope="module")
def yard() -> Trajectories:
    return made_up.record(120.0)


def read(crowd: Trajectories, layout: str, folder: Path, **asked: float) -> Trajectories:
    path = made_up.write(crowd, layout, folder)
    dt_s = asked.get("dt_s", made_up.SAID.get(layout))
    scale = made_up.SCALES.get(layout)
    return read_recording(path, layout, name="yard", dt_s=dt_s, scale=scale)


GRIDS_S = {"forum": 1 / 9, "gc": 0.8, "vadere": 0.1} | dict.fromkeys(
    ("viswalk", "pathfinder", "crowdit"), 0.2
)
"""Seconds between the rows of a file, in which people enter, where these are not 0.4."""


@pytest.mark.parametrize("layout", FORMATS)
def test_a_new_place_is_read_from_every_format(
    yard: Trajectories, tmp_path: Path, layout: str
) -> None:
    found = read(yard, layout, tmp_path)
    assert found.scene == "yard"
    assert found.dt_s == pytest.approx(4 / 9 if layout == "forum" else 0.4)
    assert found.grid_s == pytest.approx(GRIDS_S.get(layout, 0.4))
    assert len(found) >= len(yard) - (2 if layout == "gc" else 0)
    assert abs(found.duration_s - yard.duration_s) < 1.0
    assert abs(int(found.entered.sum()) - int(yard.entered.sum())) <= 2
    place = np.interp(
        np.arange(found.first[5], found.last[5]) * found.dt_s,
        np.arange(yard.first[5], yard.last[5] + 1) * 0.4,
        yard.path(5)[:, 0],
    )
    if layout not in ("gc", "forum"):
        np.testing.assert_allclose(found.path(5)[:-1, 0], place, atol=1e-3)
    extent = [np.ptp(crowd.xy, axis=0) for crowd in (found, yard)]
    np.testing.assert_allclose(*extent, atol=0.2)


def test_pixels_become_metres_as_in_the_known_places(yard: Trajectories, tmp_path: Path) -> None:
    for layout, words in (("gc", "by H.json × 0.8 m"), ("forum", "24.7 mm per pixel")):
        found = read(yard, layout, tmp_path)
        assert words in found.provenance["notes"]["metres"]
        middle = np.median(found.xy, axis=0) - np.median(yard.xy, axis=0)
        assert np.abs(middle).max() < 0.2


@pytest.mark.parametrize("layout", ["obsmat", "trajnet", "jupedsim", "gc", "forum"])
def test_a_time_step_that_contradicts_the_file_is_refused(
    yard: Trajectories, tmp_path: Path, layout: str
) -> None:
    with pytest.raises(RecordingError, match="--dt-s"):
        read(yard, layout, tmp_path, dt_s=0.25)


def test_a_wrong_time_step_of_a_table_shows_in_the_speeds(
    yard: Trajectories, tmp_path: Path
) -> None:
    with pytest.raises(RecordingError, match=r"walking speed of .* m/s; expected 0.2 to 3 m/s"):
        read(yard, "csv", tmp_path, dt_s=0.04)


def test_centimetres_show_in_the_speeds(yard: Trajectories, tmp_path: Path) -> None:
    large = replace(yard, xy=(yard.xy * 100).astype(np.float32))
    with pytest.raises(RecordingError, match="Positions must be in metres"):
        read(large, "csv", tmp_path)


def test_rows_every_twentieth_of_a_second_are_thinned_out() -> None:
    """Of a person who enters at 0.30 s a row at 0.4 s is the first that stays."""
    xy = np.concatenate([np.c_[np.arange(n) * 0.06, np.zeros(n)] for n in (100, 40, 3)])
    crowd = crowd_of([(0, 99), (6, 45), (49, 51)], dt_s=0.05, xy=xy)
    thin = at_scene_frames(crowd, pauses=False, where="here")
    assert thin.dt_s == pytest.approx(0.4)
    assert thin.grid_s == thin.dt_s  # rows closer than 0.1 s are no grid for arrivals
    assert thin.person_id.tolist() == [0, 1]
    assert thin.first.tolist() == [0, 1]
    assert thin.spawn_s.tolist() == pytest.approx([0.0, 0.3])
    assert thin.entered.tolist() == [False, True]
    assert "every 0.05 s, of which 1 in 8 is kept" in thin.provenance["notes"]["rows"]
    assert thin.provenance["notes"]["left out"].startswith("1 persons")


def test_a_recording_begins_with_its_first_row() -> None:
    crowd = crowd_of([(500, 520), (505, 540)], frames=600, dt_s=0.4)
    begun = at_scene_frames(crowd, pauses=False, where="here")
    assert begun.first.tolist() == [0, 5]
    assert begun.frames == 41
    assert begun.spawn_s.tolist() == pytest.approx([0.0, 2.0])


def test_who_a_table_says_was_there_before_has_not_entered() -> None:
    crowd = crowd_of([(0, 9), (3, 9)], dt_s=0.4, persons={"entered": [False, False]})
    assert not at_scene_frames(crowd, pauses=True, where="here").entered.any()


def side_by_side() -> Trajectories:
    """Two who walk together, and one who is alone."""
    x = 1.2 * 0.4 * np.arange(40)
    xy = np.concatenate([np.c_[x, np.full(40, y)] for y in (0.0, 0.7, 6.0)])
    return crowd_of([(0, 39)] * 3, dt_s=0.4, xy=xy, frames=60)


def test_companions_of_a_new_place_are_found(tmp_path: Path) -> None:
    crowd = side_by_side()
    lines = [f"{p},{t + 5},{x},{y}" for p in range(3) for t, (x, y) in enumerate(crowd.path(p))]
    lines += [f"3,{t},{0.4 * t},12" for t in range(20)]  # whoever is there at first has none
    (tmp_path / "mine.csv").write_text("\n".join(["person_id,frame,x,y", *lines]))
    found = read_recording(tmp_path / "mine.csv", "csv", name="mine", dt_s=0.4)
    assert found.group.tolist() == [-1, 0, 0, -1]


def test_companions_that_a_table_states_are_kept(tmp_path: Path) -> None:
    stated = replace(side_by_side(), group=np.array([-1, 4, 4], np.int32))
    write_csv(stated, tmp_path / "mine.csv")
    found = read_recording(tmp_path / "mine.csv", "csv", name="mine", dt_s=0.4)
    assert found.group.tolist() == [-1, 4, 4]
    asked = ["--to", "csv", "--out", str(tmp_path / "b.csv"), "--dt-s", "0.4"]
    assert main(["data", "convert", str(tmp_path / "mine.csv"), *asked]) == 0
    written = tmp_path / "b.csv"
    assert columns_of(read_table(written), written)["group"][-1] == 4


def test_a_table_that_crowdbench_wrote_is_taken_as_it_is(
    yard: Trajectories, tmp_path: Path
) -> None:
    whole = replace(yard, observed=np.array([[3, 200]]))
    write_parquet(whole, tmp_path / "yard.parquet")
    found = read_recording(tmp_path / "yard.parquet", "csv", name="mine")
    assert found.observed.tolist() == [[3, 200]]
    assert found.scene == "mine"
    np.testing.assert_array_equal(found.spawn_s, yard.spawn_s)


def test_an_own_recording_is_found_by_its_name(yard: Trajectories, tmp_path: Path) -> None:
    path = made_up.write(yard, "csv", tmp_path)
    with pytest.raises(SettingError, match=r"name of an imported recording.*data import NAME"):
        recording("yard")
    crowd = import_own("yard", path, "csv", dt_s=0.4)
    np.testing.assert_array_equal(recording("yard").xy, crowd.xy)
    import_own("yard", path, "csv", dt_s=0.4)  # the same again


def test_another_recording_of_that_name_is_refused(yard: Trajectories, tmp_path: Path) -> None:
    import_own("yard", made_up.write(yard, "csv", tmp_path), "csv", dt_s=0.4)
    other = replace(yard, xy=yard.xy + np.float32(1))
    with pytest.raises(SettingError, match="another imported recording of that name"):
        import_own("yard", made_up.write(other, "csv", tmp_path), "csv", dt_s=0.4)
    assert recording("yard").xy.max() == yard.xy.max()


@pytest.mark.parametrize("name", ["eth", "plaza", "forum-14jul", "../up", "Yard", ""])
def test_names_that_are_not_the_users_to_give(name: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="a new name of lower-case letters"):
        import_own(name, tmp_path / "nothing.csv", "csv", dt_s=0.4)


@pytest.mark.parametrize("layout", FORMATS)
def test_what_is_not_there_is_told_with_what_the_format_is(layout: str, tmp_path: Path) -> None:
    with pytest.raises(CrowdbenchError) as told:
        read_recording(tmp_path / "nowhere", layout, name="yard", dt_s=0.4)
    assert "no such file" in told.value.got
    assert FORMATS[layout] in told.value.hint


@pytest.mark.parametrize("layout", ["obsmat", "forum"])
def test_who_brings_a_broken_file_is_not_sent_to_the_published_one(
    layout: str, tmp_path: Path
) -> None:
    path = tmp_path / "broken.txt"
    path.write_text("1 2 3\n")
    with pytest.raises(RecordingError) as told:
        read_recording(path, layout, name="yard", dt_s=0.4 if layout == "obsmat" else None)
    assert told.value.hint == f"The format {layout}: {FORMATS[layout]}."


def test_the_command_imports_an_own_recording(
    yard: Trajectories, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made_up.write(yard, "jupedsim", tmp_path)
    asked = ["data", "import", "yard", "--source", str(path), "--format", "jupedsim"]
    assert main(asked) == 0
    assert f"persons         {len(yard)}" in capsys.readouterr().out
    assert main(["data", "list"]) == 0
    assert re.search(r"^ yard +imported +your own *$", capsys.readouterr().out, re.M)
    assert main(["data", "describe", "yard"]) == 0
    assert main(["data", "import", "yard", "--format", "csv"]) == 2
    assert "expected --source PATH" in capsys.readouterr().err


def test_the_command_line_knows_all_formats(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["data", "import", "--help"]) == 0
    assert set(FORMATS) <= set(re.findall(r"[\w-]+", capsys.readouterr().out))
    assert tuple(WRITERS) == get_args(options.Written)


def test_a_format_is_named_by_the_function_that_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rows_of_mine.py").write_text(
        "from crowdbench import read\n"
        "def rows(path, *, name, dt_s):\n"
        "    return read(path, 'eth-v0')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    lines = [f"3,{t},{0.4 * t},0" for t in range(9)]
    (tmp_path / "mine.csv").write_text("\n".join(["person_id,frame,x,y", *lines]))
    crowd = read_recording(tmp_path / "mine.csv", "rows_of_mine:rows", name="mine")
    assert (crowd.scene, crowd.frames, crowd.provenance["source"]) == ("mine", 9, "mine.csv")
    with pytest.raises(SettingError, match="got the format rows_of_mine:rows, whose frames"):
        read_recording(tmp_path / "mine.csv", "rows_of_mine:rows", name="mine", offset_s=0.4)
    with pytest.raises(SettingError, match=r"format: got 'obsmats'.*Did you mean `obsmat`"):
        read_recording(tmp_path / "mine.csv", "obsmats", name="mine")


def test_eth_as_an_own_recording_is_the_published_one(opentraj: Path) -> None:
    path = opentraj / "datasets/ETH/seq_eth/obsmat.txt"
    crowd = read_recording(path, "obsmat", name="mine", dt_s=0.4)
    assert main(["data", "import", "eth", "--source", str(opentraj)]) == 0
    published = recording("eth")
    np.testing.assert_array_equal(crowd.xy, published.xy)
    np.testing.assert_array_equal(crowd.observed, published.observed)
    np.testing.assert_array_equal(crowd.entered, published.entered)
