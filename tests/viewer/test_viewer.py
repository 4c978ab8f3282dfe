"""The viewer: a file of it shows what the tables say, and the real viewer draws it."""

import io
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pages
import pytest
import shapely
from conftest import REQUIRE_ALL, need
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from rrds import always, chunks, columns, entities, forget_types, rerun, rows
from worlds import box, square

from crowdbench.cli import main
from crowdbench.colours import goal_colour
from crowdbench.data.storage import read_own, write_parquet
from crowdbench.data.table import OUTCOMES, Trajectories, from_rows
from crowdbench.envs.parallel_env import parallel_env
from crowdbench.errors import OutputError, SettingError
from crowdbench.policies import Straight
from crowdbench.registry import spawn_model
from crowdbench.registry.map_images import add_map
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.simulation import Settings
from crowdbench.viewer import access, check_screen, save
from crowdbench.viewer.chosen import ray_lengths
from crowdbench.viewer.place import UNKNOWN, dashes, hatching, rgb

PLAZA = load_scene("plaza-v0")
UNSEEN = (10, 40)
"""Frames of the recording that nobody observed, and its first ones besides."""
CHOSEN = 12

if not find_spec("rerun") and not REQUIRE_ALL:
    pytest.skip("rerun, of the extra viewer, is missing", allow_module_level=True)


def crowd_of(seed: int) -> Trajectories:
    spawn = spawn_model("poisson-gmm", PLAZA)
    return rollout(PLAZA, spawn, Straight(), seed=seed, horizon_s=60.0)


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    return crowd_of(0)


@pytest.fixture(scope="module")
def recording(crowd: Trajectories) -> Trajectories:
    """A crowd that is known in two intervals, as if it were the plaza's recording."""
    observed = np.array([[5, UNSEEN[0]], [UNSEEN[1], crowd.frames]])
    return replace(crowd_of(1), scene=PLAZA.recording.name).observed_in(observed)


@pytest.fixture(scope="module")
def saved(
    crowd: Trajectories, recording: Trajectories, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "plaza.rrd"
    save(crowd, PLAZA, path, against=recording, person=CHOSEN)
    return path


def in_frame(crowd: Trajectories, frame: int) -> np.ndarray:
    """Rows of those who are there."""
    return np.flatnonzero(crowd.row_frame() == frame)


def test_rerun_itself_finds_no_fault_with_a_file(saved: Path) -> None:
    assert "verified without error" in rerun("rrd", "verify", saved)


def test_what_is_shown(saved: Path) -> None:
    place = {f"/world/place/{name}" for name in ("bounds", "walls", "spawn_areas", "goal_areas")}
    sides = {
        f"/{where}/{side}{what}"
        for side in ("simulation", "recording")
        for where, what in (
            ("world", "/people"), ("world", "/trails"), ("agents", ""), ("spawns", ""),
        )
    }  # fmt: skip
    chosen = {f"/world/simulation/chosen/{what}" for what in ("rays", "ring", "way", "goal")}
    more = {"/", "/world", "/outcomes", "/world/recording/unobserved", "/__properties"}
    assert entities(saved) == place | {"/world/place/walls/hatching"} | sides | chosen | more


def test_a_photograph_lies_below_everything_else(crowd: Trajectories, tmp_path: Path) -> None:
    photograph, matrix, b = tmp_path / "place.png", tmp_path / "H.txt", PLAZA.bounds
    Image.new("RGB", (40, 40), "green").save(photograph)
    wide, high = b.x_max_m - b.x_min_m, b.y_max_m - b.y_min_m
    np.savetxt(matrix, [[wide / 40, 0, b.x_min_m], [0, -high / 40, b.y_max_m], [0, 0, 1]])
    add_map(PLAZA, photograph, matrix)
    path = tmp_path / "plaza.rrd"
    save(crowd, PLAZA, path)
    shown = always(path, "/world/place/map")
    (translation,) = shown["Transform3D:translation"]
    np.testing.assert_allclose(translation, [b.x_min_m, b.y_max_m, 0])
    (scale,) = shown["Transform3D:scale"]
    pixels = max(wide, high) / 1200
    np.testing.assert_allclose(scale, [pixels, -pixels, 1], rtol=2e-3)
    (order,) = shown["EncodedImage:draw_order"]
    assert order < always(path, "/world/place/walls")["LineStrips2D:draw_order"][0]


def test_plots_show_all_of_either_time_line(saved: Path) -> None:
    """A range in seconds would be one in nanoseconds as frames, in which the plot is empty."""
    views = [chunk for chunk in chunks(saved, "blueprint") if "view_range" in str(columns(chunk))]
    assert columns(next(iter(chunks(saved, "blueprint"))))  # it was sent
    assert views == []
    for clock in ("frame", "time"):
        assert len(rows(saved, "/agents/simulation", "Scalars:scalars", clock)) == 150


@pytest.mark.parametrize("side", ["simulation", "recording"])
def test_each_frame_shows_who_is_there(
    saved: Path, crowd: Trajectories, recording: Trajectories, side: str
) -> None:
    table = crowd if side == "simulation" else recording
    people = f"/world/{side}/people"
    xy = rows(saved, people, "Points2D:positions")
    ids, classes = rows(saved, people, "person_id"), rows(saved, people, "Points2D:class_ids")
    assert list(xy) == list(range(table.frames))
    for frame in range(table.frames):
        there = in_frame(table, frame)
        if not any(start <= frame < stop for start, stop in table.observed):
            there = there[:0]
        who = table.row_person()[there]
        assert np.array_equal(xy[frame].reshape(-1, 2), table.xy[there])
        assert np.array_equal(ids[frame], table.person_id[who])
        goal = table.goal_area[who]
        assert np.array_equal(classes[frame], np.where(goal < 0, UNKNOWN, goal))


def test_people_are_as_large_as_the_scene_says(saved: Path) -> None:
    (radius,) = always(saved, "/world/simulation/people")["Points2D:radii"]
    assert radius == pytest.approx(PLAZA.motion.person_radius_m)


def test_a_class_has_the_colour_that_figures_give_its_goal_area(saved: Path) -> None:
    classes = always(saved, "/")["AnnotationContext:context"][0]
    for known in classes:
        info = known["class_description"]["info"]
        if known["class_id"] != UNKNOWN:
            assert info["label"] == f"to goal area {known['class_id']}"
            colour = int.from_bytes([*rgb(goal_colour(known["class_id"])), 255], "big")
            assert info["color"] == colour
    assert UNKNOWN in [known["class_id"] for known in classes]


def test_trails_are_the_last_two_seconds(saved: Path, crowd: Trajectories) -> None:
    strips = rows(saved, "/world/simulation/trails", "LineStrips2D:strips")
    steps = round(2.0 / crowd.dt_s)
    for frame in (0, 3, 70):
        for trail, row in zip(strips[frame], in_frame(crowd, frame), strict=True):
            person = crowd.row_person()[row]
            before = np.arange(frame - steps, frame + 1) - crowd.first[person]
            assert np.array_equal(trail, crowd.path(int(person))[np.maximum(before, 0)])


def test_metres_are_logged_and_one_transform_puts_y_up(saved: Path) -> None:
    assert always(saved, "/world")["Transform3D:scale"] == [[1.0, -1.0, 1.0]]
    b = PLAZA.bounds
    corners = np.array(always(saved, "/world/place/bounds")["LineStrips2D:strips"][0])
    assert np.array_equal(corners[2], np.float32([b.x_max_m, b.y_max_m]))


def test_both_clocks_tell_the_same_time(saved: Path, crowd: Trajectories) -> None:
    for entity, component in (
        ("/world/simulation/people", "Points2D:positions"), ("/outcomes", "TextLog:text"),
        ("/agents/simulation", "Scalars:scalars"), ("/spawns/recording", "Scalars:scalars"),
        ("/world/simulation/chosen/rays", "LineStrips2D:strips"),
    ):  # fmt: skip
        frames = rows(saved, entity, component)
        nanoseconds = rows(saved, entity, component, clock="time")
        expected = [frame * crowd.dt_s for frame in frames]
        assert np.array(list(nanoseconds)) / 1e9 == pytest.approx(expected)


def test_plots_count_agents_and_spawns(saved: Path, crowd: Trajectories) -> None:
    agents = rows(saved, "/agents/simulation", "Scalars:scalars")
    assert np.array_equal(np.concatenate(list(agents.values())), crowd.present())
    spawns = rows(saved, "/spawns/simulation", "Scalars:scalars")
    assert list(spawns) == list(range(0, crowd.frames, 10))
    assert sum(v.sum() for v in spawns.values()) == crowd.entered.sum() > 0
    assert always(saved, "/agents/recording")["SeriesLines:names"] == ["recording"]


def test_what_nobody_observed_is_not_drawn_but_said(saved: Path) -> None:
    agents = rows(saved, "/agents/recording", "Scalars:scalars")
    assert [f for f, v in agents.items() if not len(v)] == [*range(5), *range(*UNSEEN)]
    spawns = rows(saved, "/spawns/recording", "Scalars:scalars")
    assert [f for f, v in spawns.items() if not len(v)] == [0, *range(*UNSEEN, 10)]
    said = rows(saved, "/world/recording/unobserved", "Points2D:labels")
    assert {f: v.tolist() for f, v in said.items()} == {
        0: ["not observed"], 5: [], UNSEEN[0]: ["not observed"], UNSEEN[1]: [],
    }  # fmt: skip


def test_the_log_tells_how_each_life_ended(saved: Path, crowd: Trajectories) -> None:
    from rerun.chunk import RrdReader

    said = [
        text[0]
        for chunk in RrdReader(saved).stream()
        if chunk.entity_path == "/outcomes"
        for text in chunk.to_record_batch().column("TextLog:text").to_pylist()
    ]
    assert len(said) == len(crowd)
    chosen = int(np.flatnonzero(crowd.person_id == CHOSEN)[0])
    assert OUTCOMES[crowd.outcome[chosen]] == "goal"
    dwell_s = (crowd.last[chosen] - crowd.first[chosen]) * crowd.dt_s
    to_s = crowd.last[chosen] * crowd.dt_s
    assert f"{to_s:.1f} s: person 12 reached the goal after {dwell_s:.1f} s" in said
    assert any("was still present at the end" in text for text in said)


def test_rays_are_those_that_the_environment_saw() -> None:
    env = parallel_env("plaza-v0", spawn="poisson-gmm", horizon_s=60.0)
    observations, _ = env.reset(seed=3)
    seen: dict[str, list[np.ndarray]] = {}
    while env.agents:
        for name, observation in observations.items():
            seen.setdefault(name, []).append(observation[6:])
        slow = np.float32(0.25)
        observations, *_ = env.step({name: slow * observations[name][3:5] for name in env.agents})
    for name, observation in observations.items():
        seen[name].append(observation[6:])
    crowd = env.trajectories()
    for person in range(3, len(crowd), 7):
        rays = ray_lengths(crowd, person, PLAZA, Settings(max_alive=64))
        # At the horizon people are seen once more; the table ends in the frame before.
        expected = np.array(seen[f"person_{crowd.person_id[person]}"][: len(rays)])
        np.testing.assert_allclose(rays, 10 * expected, atol=1e-5)


def test_rays_are_there_while_the_person_is(saved: Path, crowd: Trajectories) -> None:
    chosen = int(np.flatnonzero(crowd.person_id == CHOSEN)[0])
    for what, component, count in (
        ("rays", "LineStrips2D:strips", 32), ("ring", "Points2D:positions", 1),
    ):  # fmt: skip
        shown = rows(saved, f"/world/simulation/chosen/{what}", component)
        first, last = int(crowd.first[chosen]), int(crowd.last[chosen])
        assert {f: len(v) for f, v in shown.items()} == {
            **dict.fromkeys(range(first, last + 1), count), last + 1: 0,
        }  # fmt: skip
    goal = rows(saved, "/world/simulation/chosen/goal", "Points2D:labels")
    assert goal[first].tolist() == ["goal of person 12"]


def test_a_crowd_that_is_nobodys_is_shown_alone(crowd: Trajectories, tmp_path: Path) -> None:
    unfitted = square(half_m=20.0)  # nobody knows its areas
    here = replace(crowd, scene=unfitted.id, goal_area=np.full(len(crowd), -1))
    save(here, unfitted, tmp_path / "square.rrd")
    assert "/world/recording/people" not in entities(tmp_path / "square.rrd")


@settings(deadline=None)
@given(st.floats(-4, 3), st.floats(-4, 3), st.floats(0.5, 6), st.floats(0.5, 6))
def test_hatching_lies_within_walls(x: float, y: float, width: float, height: float) -> None:
    wall = box(x, y, x + width, y + height)
    strokes = hatching(square(10.0, wall))
    inside = shapely.Polygon(wall).buffer(1e-6)
    assert all(inside.covers(shapely.LineString(stroke)) for stroke in strokes)


def test_dashes_have_one_length_however_far_their_line_turns() -> None:
    angle = np.linspace(0, 2 * np.pi, 400)
    found = dashes(np.stack([9 * np.cos(angle), 0.5 * np.sin(angle)], axis=1), 0.3)
    lengths = [np.linalg.norm(b - a) for a, b in found]
    assert np.median(lengths) == pytest.approx(max(lengths), rel=0.02)
    assert np.median(lengths) == pytest.approx(0.3, rel=0.05)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def real_viewer(window_size: str) -> Iterator[tuple[Any, int]]:
    """A viewer that listens on a port and has no window: what it tells of itself."""
    need(list(Path("/usr/share/vulkan/icd.d").glob("lvp_*")), "mesa-vulkan-drivers")
    from rerun.experimental import ViewerClient

    port = free_port()
    options = ["--headless", "--window-size", window_size, "--port", str(port)]
    process = subprocess.Popen([sys.executable, "-m", "rerun", *options], start_new_session=True)
    try:
        while not listens(port):
            assert process.poll() is None
            time.sleep(0.1)
        yield ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy"), port
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()


@pytest.fixture
def viewer(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The viewer that crowdbench finds, small: it draws all that it gets."""
    with real_viewer("320x240") as (client, port):
        monkeypatch.setattr(access, "PORT", port)
        yield client


def goals_shown(picture: bytes) -> np.ndarray:
    """Pixels of each goal area's colour in the left and the right half, below rerun's notices."""
    with Image.open(io.BytesIO(picture)) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    height, width = pixels.shape[:2]
    places = pixels[round(0.35 * height) : round(0.65 * height)]
    return np.array(
        [
            [(np.abs(half - rgb(goal_colour(area))).sum(axis=2) < 40).sum() for area in range(4)]
            for half in (places[:, : width // 2], places[:, width // 2 :])
        ]
    )


def test_the_real_viewer_draws_discs_where_people_are(saved: Path) -> None:
    with real_viewer("1000x800") as (client, _):
        (recording,) = client.open(str(saved)).store_ids
        client.set_time("frame", sequence=0, play_state="paused", recording=recording)
        for _ in range(60):  # a busy machine draws bit by bit
            shown = goals_shown(client.take_screenshot())
            # Both halves have the areas, one of which lies outside; only the left has people:
            # the right is not observed yet.
            areas = np.sort(shown, axis=1)[:, 1:].min()
            people = (shown[0] - shown[1]).sum()
            if areas > 50 and people > 80:
                break
            time.sleep(0.5)
    assert areas > 50, shown
    assert people > 80, shown


def arrived(viewer: Any, recordings: int) -> list[str]:
    """Ids of the viewer's recordings when they all have come; none of its views has a fault."""
    for _ in range(100):
        state = viewer.get_state()
        if len(state.recordings) >= recordings and all(r.timelines for r in state.recordings):
            break
        time.sleep(0.1)
    assert [report.summary for view in state.views for report in view.reports] == []
    return [str(recording.store_id) for recording in state.recordings]


def test_an_environment_opens_the_real_viewer(viewer: Any) -> None:
    env = parallel_env("plaza-v0", horizon_s=20.0, render_mode="human")
    env.reset(seed=0)
    env.close()
    (recording,) = arrived(viewer, 1)
    assert "crowdbench plaza-v0" in recording


def test_nobody_of_that_id(crowd: Trajectories, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="person: got 4711; expected an id from the table"):
        save(crowd, PLAZA, tmp_path / "x.rrd", person=4711)
    assert list(tmp_path.iterdir()) == []


def test_where_it_cannot_be_written(crowd: Trajectories, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="Choose another folder"):
        save(crowd, PLAZA, tmp_path / "file" / "x.rrd")


def test_a_disk_that_is_full_is_an_error_and_leaves_nothing(
    crowd: Trajectories, tmp_path: Path
) -> None:
    table = tmp_path / "rollout.parquet"
    write_parquet(crowd, table)
    code = (
        "import resource, sys; from crowdbench.cli import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))\n"
        "sys.exit(main(sys.argv[1:]))"
    )
    # Without -B, compiled modules would be cut off there too, and stay behind for other tests.
    view = ["view", table, "--save", tmp_path / "crowd.rrd"]
    command = [sys.executable, "-B", "-c", code, *view]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert "crowd.rrd: got File too large" in done.stderr
    assert list(tmp_path.iterdir()) == [table]


def test_without_rerun_it_is_said_how_to_install_it(
    crowd: Trajectories, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)  # what is not installed cannot be found
    with pytest.raises(SettingError, match=r'-e "\.\[viewer\]"'):
        save(crowd, PLAZA, tmp_path / "x.rrd")


@pytest.fixture
def no_screen(monkeypatch: pytest.MonkeyPatch) -> int:
    """The port on which a viewer would listen, and does not."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    port = free_port()
    monkeypatch.setattr(access, "PORT", port)
    return port


def test_a_viewer_that_listens_needs_no_screen(no_screen: int) -> None:
    with pytest.raises(SettingError, match="no screen"):
        check_screen()
    with socket.create_server(("127.0.0.1", no_screen)):
        check_screen()


def test_the_command_writes_a_file(
    crowd: Trajectories, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, out = tmp_path / "rollout.parquet", tmp_path / "deep" / "rollout.rrd"
    write_parquet(crowd, table)
    assert main(["view", str(table), "--against", str(table), "--save", str(out)]) == 0
    assert f"written to {out}" in capsys.readouterr().out
    assert {"/world/simulation/people", "/world/against/people"} <= entities(out)
    assert [path.name for path in out.parent.iterdir()] == ["rollout.rrd"]


def test_another_simulators_people_have_colours_too(tmp_path: Path) -> None:
    rows_of_two = [f"{p},{f},{2 + 0.5 * f},{9.5 + p}" for p in (0, 1) for f in range(50)]
    table, out = tmp_path / "mine.csv", tmp_path / "mine.rrd"
    table.write_text("\n".join(["person_id,frame,x,y", *rows_of_two, "1,60,27,9.5"]))
    assert main(["view", str(table), "--scene", "plaza-v0", "--save", str(out)]) == 0
    classes = rows(out, "/world/simulation/people", "Points2D:class_ids")[0]
    assert classes.shape == (2,)
    assert classes[0] != UNKNOWN  # who left has a goal area


BAD = {
    "no screen": (["view", "{own}"], "`rerun crowd.rrd`"),
    "no table": (["view", "{tmp}/none.parquet", "--save", "{tmp}/x.rrd"], "no such file"),
    "no scene": (["view", "{csv}", "--save", "{tmp}/x.rrd"], "crowdbench view --scene"),
    "no recording": (
        ["view", "{csv}", "--scene", "eth-v0", "--against", "recording", "--save", "{tmp}/x.rrd"],
        "data fetch eth",
    ),
    "another scene": (
        ["view", "{own}", "--scene", "eth-v0", "--save", "{tmp}/x.rrd"], "scene plaza-v0",
    ),
    "rollouts that could not be shown": (
        ["evaluate", "plaza-v0", "--view", "--out", "{tmp}/out"], "no screen",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_a_users_error_is_a_message_and_exit_code_2(
    what: str,
    crowd: Trajectories,
    no_screen: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_parquet(crowd, tmp_path / "own.parquet")
    (tmp_path / "mine.csv").write_text("person_id,frame,x,y\n0,0,1.0,2.0\n0,1,1.5,2.0\n")
    before = sorted(tmp_path.iterdir())
    names = {"tmp": tmp_path, "own": tmp_path / "own.parquet", "csv": tmp_path / "mine.csv"}
    arguments, message = BAD[what]
    assert main([a.format(**names) for a in arguments]) == 2
    assert message in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before
    assert len(read_own(tmp_path / "own.parquet")) == len(crowd)


def test_a_crowd_of_one_frame(tmp_path: Path) -> None:
    one = from_rows(scene="plaza-v0", dt_s=0.4, person_id=np.array([7]), frame=np.array([0]),
                    xy=np.array([[3.0, 4.0]]), where="test")  # fmt: skip
    save(one, "plaza-v0", str(tmp_path / "one.rrd"), person=7)
    shown = rows(tmp_path / "one.rrd", "/world/simulation/people", "Points2D:positions")
    assert shown[0].tolist() == [[3.0, 4.0]]


def test_a_place_may_be_empty_for_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    forget_types(monkeypatch)
    late = from_rows(scene="plaza-v0", dt_s=0.4, person_id=np.array([7]), frame=np.array([900]),
                     xy=np.array([[3.0, 4.0]]), frames=1000, where="test")  # fmt: skip
    save(late, PLAZA, tmp_path / "late.rrd")
    ids = rows(tmp_path / "late.rrd", "/world/simulation/people", "person_id")
    assert {frame: there.tolist() for frame, there in ids.items() if len(there)} == {900: [7]}


PAGE = (Path(__file__).parents[2] / "docs" / "viewer.md").read_text()


@pytest.mark.long
def test_the_pages_commands_open_the_real_viewer(
    viewer: Any, opentraj: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["data", "import", "eth", "--source", str(opentraj)]) == 0
    for block in pages.blocks(PAGE, "sh"):
        for command in block.splitlines():
            arguments = shlex.split(command)[1:]
            if arguments[0] == "evaluate":
                arguments += ["--seeds", "1", "--workers", "1", "--view"]
            assert main(arguments) == 0, command
    assert "/world/recording/people" in entities(tmp_path / "crowd.rrd")
    # The pair, its policy under the recorded arrivals, and what `view` opened.
    assert len(arrived(viewer, 3)) == 3


def test_the_pages_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import rerun as rr

    monkeypatch.chdir(tmp_path)
    film, live, _ = pages.blocks(PAGE, "python")  # test_film.py runs the last one
    exec(compile(film, "viewer.md", "exec"), {})
    with Image.open("crowd.gif") as image:
        assert getattr(image, "n_frames", 1) > 50
    exec(compile(live, "viewer.md", "exec"), {})
    rr.disconnect()
    rr.set_global_data_recording(None)
    shown = rows(tmp_path / "training.rrd", "/world/simulation/people", "Points2D:positions")
    rewards = rows(tmp_path / "training.rrd", "/reward", "Scalars:scalars")
    assert len(set(rewards) & set(shown)) > 100


def test_the_pages_pictures_are_small() -> None:
    linked = re.findall(r"!\[[^]]+\]\(([^)]+)\)", PAGE)
    assert len(linked) == 2
    for name in linked:
        picture = Path(__file__).parents[2] / "docs" / name
        assert picture.stat().st_size < 400_000
        with Image.open(picture) as image:
            assert image.width >= 1200
