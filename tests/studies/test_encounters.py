"""Typical encounters: which are found, and that people go on from where they were recorded."""

import json
from io import BytesIO
from itertools import chain
from pathlib import Path

import numpy as np
import pages
import pytest
from PIL import Image
from recorded_crowds import DT, recorded, straight
from worlds import box, square

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError
from crowdbench.scene import list_scenes
from crowdbench.spawn.replay import Replay
from studies.__main__ import main as studies_main
from studies.encounters import write_encounters
from studies.encounters.snapshot import Snapshot
from studies.encounters.typical import Encounter, typical_encounters

PLACE = square(half_m=60.0)
ROWS = 30
MIDDLE = 15  # the row in which all pairs below are closest


def whole(crowd: Trajectories) -> TimeBlocks:
    return TimeBlocks(np.array([[0, crowd.frames]]), np.array([0]), DT, DT)


def pair(
    where: float, one: tuple[float, float], other: tuple[float, float], apart_m: float
) -> list[tuple[int, np.ndarray]]:
    """Two people who are closest in the middle of their rows, at y = `where`."""
    paths = []
    for velocity, y in ((one, where), (other, where + apart_m)):
        v = np.array(velocity)
        paths.append((0, straight(tuple(np.array([0.0, y]) - MIDDLE * DT * v), velocity, ROWS)))
    return paths


def found(crowd: Trajectories, **scene: object) -> dict[str, Encounter]:
    return {e.kind: e for e in typical_encounters(PLACE, crowd, whole(crowd))}


@pytest.mark.parametrize(
    ("kind", "one", "other"),
    [
        ("crossing", (1.0, 0.0), (0.0, 1.0)),
        ("overtaking", (1.0, 0.0), (1.8, 0.0)),
        ("none", (1.0, 0.0), (1.0, 1.0)),
    ],
)
def test_the_median_of_each_kind_is_typical(
    kind: str, one: tuple[float, float], other: tuple[float, float]
) -> None:
    each = [pair(20.0 * k - 40, one, other, 0.5 + 0.2 * k) for k in range(5)]
    encounters = found(recorded(*chain(*each)))
    if kind == "none":
        assert not encounters
        return
    (encounter,) = encounters.values()
    assert (encounter.kind, encounter.chosen_from) == (kind, 5)
    # Those of the third pair; of crossings, the path of the other one leads 0.9 m beside.
    assert encounter.people == (4, 5)
    assert abs(encounter.frame - MIDDLE) <= 1
    assert encounter.stop - encounter.first == 2 * round(4.0 / DT) + 1


def test_a_meeting_needs_a_companion() -> None:
    lone = [pair(20.0 * k - 40, (1.0, 0.0), (-1.0, 0.0), 0.8) for k in range(4)]
    lone = [[(1, path) for _, path in of] for of in lone]  # companions are seen to enter
    assert "meeting" not in found(recorded(*chain(*lone)))
    beside = [(1, path - np.array([0.0, 0.7])) for _, path in [of[0] for of in lone]]
    assert found(recorded(*chain(*lone), *beside))["meeting"].chosen_from == 8  # with each of both


def test_fewer_than_three_have_no_typical_one() -> None:
    two = [pair(20.0 * k, (1.0, 0.0), (1.8, 0.0), 0.5) for k in range(2)]
    assert not found(recorded(*chain(*two)))


def test_passages_lead_along_the_busiest_wall() -> None:
    place = square(60.0, box(-5.0, 1.0, 5.0, 2.0), box(-5.0, -40.0, 5.0, -39.0))
    ways = [(20 + 5 * k, straight((-8.0, 0.3 + 0.1 * k), (1.0, 0.0), ROWS)) for k in range(3)]
    rare = [(0, straight((-8.0, -38.5), (1.0, 0.0), ROWS))]
    crowd = recorded(*ways, *rare)
    (passage,) = typical_encounters(place, crowd, whole(crowd))
    assert (passage.kind, passage.chosen_from) == ("passage", 3)
    paths = {p: crowd.path(p) for p in range(len(crowd))}
    assert passage.measure(paths, DT) == pytest.approx(0.6, abs=0.01)


def stopping(wait_rows: int) -> np.ndarray:
    """Walks 5 m, stands, and walks on."""
    comes = straight((-5.0, 0.0), (1.0, 0.0), 13)
    stands = np.repeat(comes[-1:], wait_rows, axis=0)
    return np.concatenate([comes, stands, comes[-1] + np.arange(1, 25)[:, None] * [DT, 0.0]])


def test_stops_are_measured_by_the_time_stood() -> None:
    each = [(0, stopping(15 + 5 * k) + np.array([0.0, 9.0 * k])) for k in range(3)]
    stop = found(recorded(*each))["stop"]
    assert stop.people == (1,)
    paths = {1: stopping(20)}
    assert stop.measure(paths, DT) == pytest.approx(20 * DT)
    assert stop.measure({}, DT) is None


def test_people_go_on_from_where_they_were() -> None:
    walks, comes = straight((0.0, 0.0), (1.0, 0.5), ROWS), straight((9.0, 9.0), (0.0, -1.0), ROWS)
    crowd = recorded((0, walks), (12, comes), (0, stopping(15) - np.array([0.0, 20.0])))
    events = Replay(crowd).sample(np.inf, PLACE, np.random.default_rng(0))
    first = 8
    shot = Snapshot.of(PLACE, crowd, events, first, first + 10)
    assert crowd.first.tolist() == [0, 0, 12]
    assert shot.person.tolist() == [0, 1, 2]
    early, waits, later = (shot.events[np.array([k])] for k in range(3))
    np.testing.assert_allclose(early.start[0], walks[first], atol=1e-5)
    np.testing.assert_allclose(early.velocity[0], [1.0, 0.5], atol=1e-4)
    assert (early.time_s[0], early.entered[0]) == (0.0, False)
    assert (later.time_s[0], later.entered[0]) == (pytest.approx((12 - first) * DT), True)
    np.testing.assert_allclose(later.start[0], comes[0], atol=1e-5)
    assert waits.wait_s[0] == events.wait_s[1]  # the stop is still to come


def test_of_a_stop_that_has_begun_the_rest_is_left() -> None:
    crowd = recorded((0, stopping(20)), frames=80)
    events = Replay(crowd).sample(np.inf, PLACE, np.random.default_rng(0))
    left = [
        float(Snapshot.of(PLACE, crowd, events, first, first + 5).events.wait_s[0])
        for first in (5, 20, 25, 40)
    ]
    assert left[0] == pytest.approx(float(events.wait_s[0]))
    assert left[1] - left[2] == pytest.approx(5 * DT)
    assert left[3] == 0
    over = Snapshot.of(PLACE, crowd, events, 40, 45).events
    assert np.isnan(over.via).all()


def test_the_page_has_the_command_and_a_picture_of_each_recorded_scene() -> None:
    text = (pages.ROOT / "docs" / "encounters.md").read_text()
    assert pages.commands(text) == ["python -m studies encounters eth-v0"]
    for scene in set(list_scenes()) - {"plaza-v0"}:
        for suffix in (".png", ".gif"):
            assert f"](encounters/{scene}{suffix})" in text


@pytest.mark.long
def test_the_command_draws_and_measures_each_kind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        studies_main(["encounters", "plaza-v0", "--policy", "straight", "--out", str(tmp_path)])
        == 0
    )
    said = capsys.readouterr().out
    numbers = json.loads((tmp_path / "plaza-v0.json").read_text())
    kinds = [each["kind"] for each in numbers["encounters"]]
    assert kinds == ["meeting", "crossing", "overtaking", "stop", "passage"]
    assert all(f"{kind} " in said for kind in kinds)
    assert all(each["simulated"] is not None for each in numbers["encounters"])
    with Image.open(BytesIO((tmp_path / "plaza-v0.gif").read_bytes())) as image:
        assert image.n_frames == 2 * round(4.0 / 0.4) + 1
    assert (tmp_path / "plaza-v0.png").stat().st_size < 300_000


def test_a_scene_without_encounters_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.encounters.typical_encounters", lambda *of: [])
    assert studies_main(["encounters", "plaza-v0", "--policy", "straight"]) == 2


def test_a_negative_seed_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert studies_main(["encounters", "plaza-v0", "--policy", "straight", "--seed", "-1"]) == 2
    assert "seed: got -1; expected 0 or more" in capsys.readouterr().err


def test_by_default_the_policy_for_any_place_walks_where_none_ships(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And a folder that cannot be made is said before anything is simulated."""
    # Another test looks at the pictures, which take longest.
    monkeypatch.setattr("studies.encounters.animation", lambda *of, **more: b"")
    monkeypatch.setattr("studies.encounters.still", lambda *of, **more: b"")
    write_encounters("plaza-v0", out=tmp_path)
    assert json.loads((tmp_path / "plaza-v0.json").read_text())["policy"] == "anticipate-any"
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file"):
        write_encounters("plaza-v0", policy="straight", out=tmp_path / "file" / "below")
