"""A scene of another recording of the same place."""

from dataclasses import replace
from pathlib import Path

import pytest

from crowdbench import cli
from crowdbench.cli import scene as command
from crowdbench.data.preprocessing import paper_preprocessed
from crowdbench.errors import SceneError
from crowdbench.registry import recording
from crowdbench.scene import load_scene
from crowdbench.scene_building import NewScene, create, create_like
from crowdbench.scene_building.fit import dwell_p99_s

PLAZA = load_scene("plaza-v0")


@pytest.fixture(autouse=True)
def nothing_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(create, "_fill", lambda *of: {})


def new(folder: Path) -> NewScene:
    return NewScene(name="new-v0", out=folder / "new")


def changed(folder: Path, old: str, new: str) -> Path:
    """A copy of the plaza's settings with some text replaced."""
    folder.mkdir()
    text = (PLAZA.folder / "scene.toml").read_text(encoding="utf-8")
    assert old in text
    (folder / "scene.toml").write_text(text.replace(old, new), encoding="utf-8")
    return folder


def test_a_new_version_of_a_scene_has_its_settings(tmp_path: Path) -> None:
    made = create_like(
        NewScene(name="plaza-v1", out=tmp_path / "plaza-v1", fits=2), "plaza-v0", "plaza"
    ).scene
    assert (made.id, made.recording) == ("plaza-v1", PLAZA.recording)
    assert (made.bounds, made.walls, made.walking) == (PLAZA.bounds, PLAZA.walls, PLAZA.walking)
    assert (made.protocol.fits, made.protocol.scored) == (2, ())


def test_words_of_the_other_scenes_comment_do_not_matter(tmp_path: Path) -> None:
    like = changed(tmp_path / "like", "# A synthetic", "# The schema of a synthetic")
    made = create_like(new(tmp_path), like, "plaza").scene
    text = (made.folder / "scene.toml").read_text()
    assert text.startswith("# New. Made by `crowdbench scene create` from plaza, like plaza-v0.\n")
    assert "synthetic" not in text.split("schema = 1")[0]


def test_the_other_scene_need_not_have_scored_metrics(tmp_path: Path) -> None:
    text = (PLAZA.folder / "scene.toml").read_text(encoding="utf-8")
    scored = text[text.index("scored = [") : text.index("]", text.index("scored = [")) + 1]
    like = changed(tmp_path / "like", scored, "")
    assert create_like(new(tmp_path), like, "plaza").scene.protocol.scored == ()


def test_people_are_dropped_as_in_the_other_scene(tmp_path: Path) -> None:
    like = changed(tmp_path / "like", 'name = "plaza"', 'name = "plaza"\npreprocess = "paper"')
    made = create_like(new(tmp_path), like, "plaza").scene
    kept, _ = paper_preprocessed(recording("plaza"))
    assert made.recording.preprocess == "paper"
    assert made.recording.dwell_p99_s == round(dwell_p99_s(kept), 2)
    assert made.recording.dwell_p99_s != round(dwell_p99_s(recording("plaza")), 2)


@pytest.mark.parametrize("name", ["grid_s", "dt_s"])
def test_a_recording_with_other_times_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    crowd = recording("plaza")
    other = replace(crowd, **{name: 2 * getattr(crowd, name)})
    monkeypatch.setattr(create, "named_recording", lambda of: other)
    with pytest.raises(SceneError, match=f"{name} = 0.4; expected {name} = 0.8") as told:
        create_like(new(tmp_path), "plaza-v0", "plaza")
    assert str(PLAZA.folder / "scene.toml") in str(told.value)  # a file that is there
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "asked",
    [
        ["Day", "--like", "plaza-v0"],
        ["day-v0", "--like", "nowhere-v0"],
        ["day-v0", "--like", "plaza-v0", "--fits", "0"],
        ["day-v0", "--like", "plaza-v0", "--out", "."],
    ],
)
def test_what_is_wrong_is_said_before_anything_is_fetched(
    monkeypatch: pytest.MonkeyPatch, asked: list[str]
) -> None:
    def fetch(name: str) -> None:
        raise AssertionError(name)

    monkeypatch.setattr(command, "fetch", fetch)
    assert cli.main(["scene", "create", *asked, "--recording", "forum-14jul"]) == 2
