"""Flow, density and speed: of crowds for which they are known exactly, and as pictures."""

from dataclasses import replace
from importlib.util import find_spec
from types import ModuleType

import numpy as np
import pytest
import shapely
from conftest import need
from matplotlib.figure import Figure

from crowdbench.data.table import Trajectories, from_rows
from crowdbench.errors import SettingError
from crowdbench.registry import recording_of
from crowdbench.report import flow
from crowdbench.report.flow import (
    flow_through,
    middle_area,
    middle_line,
    speed_density,
    trajectory_data,
    walkable_area,
)
from crowdbench.report.plots.flow import plot_n_t, plot_speed_density, weidmann
from crowdbench.report.plots.measured import RECORDED, Measured
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.scene import Bounds, Scene, Wall, load_scene
from crowdbench.scoring.reference import read_reference

ETH = load_scene("eth-v0")
ROOM = replace(ETH, bounds=Bounds(0.0, 10.0, 0.0, 8.0), walls=())
"""80 m² without walls."""
DOOR = np.array([[5.0, 3.0], [5.0, 5.0]])
DT_S = 0.4


@pytest.fixture
def pedpy() -> ModuleType:
    need(find_spec("pedpy"), "the extra pedpy")
    import pedpy

    return pedpy


def with_walls(scene: Scene, *rectangles: tuple[float, float, float, float]) -> Scene:
    corners = [shapely.box(*of).exterior.coords[:-1] for of in rectangles]
    return replace(scene, walls=tuple(Wall(f"wall {k}", tuple(c)) for k, c in enumerate(corners)))


def crowd_of(*paths: tuple[int, np.ndarray], frames: int = 40) -> Trajectories:
    """People with a first frame and their positions."""
    return from_rows(
        scene="eth-v0",
        dt_s=DT_S,
        person_id=np.concatenate([np.full(len(xy), k) for k, (_, xy) in enumerate(paths)]),
        frame=np.concatenate([first + np.arange(len(xy)) for first, xy in paths]),
        xy=np.concatenate([xy for _, xy in paths]).astype(float),
        frames=frames,
        where="a test",
    )


def walk(start: tuple[float, float], mps: tuple[float, float], rows: int) -> np.ndarray:
    return np.array(start) + DT_S * np.arange(rows)[:, None] * np.array(mps)


def through_the_door(first: int, back: bool = False) -> tuple[int, np.ndarray]:
    """Somebody who is beyond the door in the frame first + 3 for the first time."""
    x, speed = (5.9, -0.8) if back else (4.1, 0.8)
    return first, walk((x, 4.0), (speed, 0.0), 6)


def standing(xy: np.ndarray, frames: int = 3) -> Trajectories:
    return crowd_of(*((0, np.tile(at, (frames, 1))) for at in xy), frames=frames)


def lattice(step_m: float) -> np.ndarray:
    """Points in the middle of squares of this side that fill the room."""
    x, y = np.arange(step_m / 2, 10, step_m), np.arange(step_m / 2, 8, step_m)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


@pytest.mark.usefixtures("pedpy")
def test_a_converted_crowd_converts_back() -> None:
    crowd = crowd_of(through_the_door(3), through_the_door(0, back=True))
    there = trajectory_data(crowd)
    assert there.frame_rate == 2.5
    rows = there.data.sample(frac=1, random_state=0)
    back = from_rows(
        scene=crowd.scene,
        dt_s=1 / there.frame_rate,
        person_id=rows["id"].to_numpy(),
        frame=rows["frame"].to_numpy(),
        xy=rows[["x", "y"]].to_numpy(),
        frames=crowd.frames,
        where="a test",
    )
    for name in ("person_id", "first", "offsets", "xy"):
        np.testing.assert_array_equal(getattr(back, name), getattr(crowd, name))


@pytest.mark.usefixtures("pedpy")
def test_walls_are_cut_out_of_the_walkable_area() -> None:
    scene = with_walls(ROOM, (1, 1, 2, 3), (9, 0, 12, 1))
    assert walkable_area(scene).area == pytest.approx(80 - 2 - 1)
    divided = with_walls(ROOM, (3, -1, 4, 9))
    assert walkable_area(divided).bounds == (4, 0, 10, 8)


@pytest.mark.usefixtures("pedpy")
def test_the_flow_of_people_who_pass_one_by_one_is_known() -> None:
    """Every 0.8 s somebody passes a door of 2 m, in either direction: 0.625 people/(m·s)."""
    crowd = crowd_of(*(through_the_door(2 * k, back=k % 2 == 1) for k in range(10)))
    found = flow_through(crowd, DOOR)
    assert found.crossed_s == pytest.approx(DT_S * (3 + 2 * np.arange(10)))
    assert found.width_m == 2
    assert found.window_s == pytest.approx((1.2, 8.4))
    assert found.per_metre_s == pytest.approx(0.625)
    # Between 4 and 8 s, five people.
    assert flow_through(crowd, DOOR, (4.0, 8.0)).per_metre_s == pytest.approx(5 / (2 * 4))
    # The window's end belongs to it, its start does not.
    assert flow_through(crowd, DOOR, (1.2, 2.0)).per_metre_s == pytest.approx(1 / (2 * 0.8))


@pytest.mark.usefixtures("pedpy")
def test_nobody_counts_twice_and_only_who_is_observed_counts() -> None:
    _, there = through_the_door(0)
    to_and_fro = (0, np.concatenate([there, there[::-1], there]))
    beside = (0, there + np.array([0, 3]))
    crowd = crowd_of(to_and_fro, beside, through_the_door(20))
    assert flow_through(crowd, DOOR).crossed_s == pytest.approx([1.2, 9.2])
    seen = crowd.observed_in(np.array([[0, 10], [30, 40]]))
    alone = flow_through(seen, DOOR)
    assert alone.crossed_s == pytest.approx([1.2])
    assert np.isnan(alone.per_metre_s)  # the first crossing is the last
    # Of the frames 6 to 32, 6 to 9 and 30 to 32 are observed; the later crossing is not.
    assert flow_through(seen, DOOR, (2.0, 12.8)).observed_s == pytest.approx(7 * DT_S)
    assert flow_through(seen, DOOR, (0.4, 12.8)).per_metre_s == pytest.approx(1 / (2 * 11 * DT_S))


@pytest.mark.usefixtures("pedpy")
def test_where_nobody_passes_there_is_no_flow() -> None:
    crowd = standing(np.array([[1.0, 1.0]]))
    nobody = flow_through(crowd, DOOR)
    assert (len(nobody.crossed_s), nobody.per_metre_s) == (0, 0)
    assert nobody.window_s == pytest.approx((0, 1.2))


@pytest.mark.usefixtures("pedpy")
@pytest.mark.parametrize(
    ("line", "window"), [(DOOR[[0, 0]], None), (DOOR, (2.0, 2.0)), (DOOR, (3.0, 2.0))]
)
def test_lines_and_windows_have_a_length(
    line: np.ndarray, window: tuple[float, float] | None
) -> None:
    with pytest.raises(SettingError, match=r"flow: got .* expected (two different|start < end)"):
        flow_through(crowd_of(through_the_door(0)), line, window)


@pytest.mark.usefixtures("pedpy")
@pytest.mark.parametrize("step_m", [0.5, 1.0])
def test_the_density_of_a_lattice_of_standing_people_is_known(step_m: float) -> None:
    found = speed_density(standing(lattice(step_m)), ROOM)
    assert found.per_m2 == pytest.approx(np.full(3, step_m**-2))
    assert found.speed_mps.tolist() == [0, 0, 0]


@pytest.mark.usefixtures("pedpy")
def test_people_at_the_same_place_count_both() -> None:
    twice = np.repeat(lattice(0.5), 2, axis=0)
    assert speed_density(standing(twice), ROOM).per_m2 == pytest.approx(np.full(3, 8), rel=0.01)


@pytest.mark.usefixtures("pedpy")
def test_a_lone_walker_is_free() -> None:
    """Its cell is the whole room, wherever it is; outside of the room it has none."""
    walker = (0, walk((0.02, 1.0), (1.34, 0.0), 21))  # to x = 10.7 m
    found = speed_density(crowd_of(walker, frames=25), ROOM)
    inside = np.arange(25) < 19
    assert found.per_m2 == pytest.approx(np.where(inside, 1 / 80, 0))
    assert found.speed_mps[inside] == pytest.approx(np.full(19, 1.34), rel=1e-5)
    assert np.isnan(found.speed_mps[~inside]).all()
    assert found.mean_speed_mps(0.01, 0.1) == pytest.approx(1.34, rel=1e-5)
    assert np.isnan(found.mean_speed_mps(0.1, 1.0))


def test_the_speed_is_that_of_pedpy(pedpy: ModuleType) -> None:
    rng = np.random.default_rng(0)
    starts, speeds = rng.uniform(2, 6, (12, 2)), rng.uniform(-0.5, 0.5, (12, 2))
    crowd = crowd_of(
        *((0, walk(*of, 10)) for of in zip(starts, speeds, strict=True)),  # type: ignore[arg-type]
        frames=10,
    )
    data, area = trajectory_data(crowd), pedpy.MeasurementArea(middle_area(ROOM))
    cells = pedpy.compute_individual_voronoi_polygons(
        traj_data=data, walkable_area=walkable_area(ROOM)
    )
    _, parts = pedpy.compute_voronoi_density(individual_voronoi_data=cells, measurement_area=area)
    expected = pedpy.compute_voronoi_speed(
        traj_data=data,
        individual_speed=pedpy.compute_individual_speed(
            traj_data=data,
            frame_step=1,
            speed_calculation=pedpy.SpeedCalculation.BORDER_SINGLE_SIDED,
        ),
        individual_voronoi_intersection=parts,
        measurement_area=area,
    )
    found = speed_density(crowd, ROOM)
    assert found.speed_mps == pytest.approx(expected["speed"].to_numpy())
    # Of every third frame the same, although only the rows around them are converted.
    few = speed_density(crowd, ROOM, most_frames=4)
    assert (few.stride, few.frame.tolist()) == (3, [0, 3, 6, 9])
    assert few.speed_mps == pytest.approx(found.speed_mps[::3])
    assert few.per_m2 == pytest.approx(found.per_m2[::3])


@pytest.mark.usefixtures("pedpy")
def test_only_observed_frames_are_measured_and_single_rows_have_no_speed() -> None:
    at = np.array([[5.0, 4.0]])
    crowd = crowd_of((2, at), (8, at), frames=20).observed_in(np.array([[0, 4], [6, 8]]))
    found = speed_density(crowd, ROOM)
    assert found.frame.tolist() == [0, 1, 2, 3, 6, 7]
    assert found.per_m2 == pytest.approx([0, 0, 1 / 80, 0, 0, 0])
    assert np.isnan(found.speed_mps).all()


def test_density_is_measured_at_the_free_place_nearest_to_the_middle() -> None:
    assert middle_area(ROOM).bounds == (4, 3, 6, 5)
    assert middle_area(with_walls(ROOM, (4, -1, 11, 9))).bounds[2] == 4
    corridor = with_walls(ROOM, (0, 0, 10, 3.2), (0, 4.8, 10, 8))
    assert middle_area(corridor).bounds == (4.5, 3.5, 5.5, 4.5)
    with pytest.raises(SettingError, match="no place of 1 m"):
        middle_area(with_walls(ROOM, (0, 0, 10, 3.6), (0, 4.4, 10, 8)))


def test_flow_is_measured_across_the_narrower_way_from_wall_to_wall() -> None:
    corridor = with_walls(ROOM, (0, 0, 10, 3.2), (0, 4.8, 10, 8))
    np.testing.assert_allclose(middle_line(corridor), [[5, 3.2], [5, 4.8]])
    post = with_walls(ROOM, (0, 6, 10, 7), (2, 0, 3, 6))
    np.testing.assert_allclose(middle_line(post), [[5, 0], [5, 6]])


@pytest.mark.usefixtures("pedpy")
@pytest.mark.parametrize(
    ("area", "expected"),
    [
        (shapely.box(1, 1, 3, 3), "overlaps no wall"),
        (shapely.box(9, 4, 11, 6), "inside the bounds"),
        (shapely.Polygon([(4, 1), (8, 1), (5, 2), (4, 6)]), "a convex polygon"),
    ],
)
def test_areas_are_free_and_convex(area: shapely.Polygon, expected: str) -> None:
    scene = with_walls(ROOM, (2, 2, 3, 3))
    with pytest.raises(SettingError, match=f"measurement area in eth-v0: .*{expected}"):
        speed_density(standing(lattice(1.0)), scene, area)


def test_without_pedpy_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flow, "find_spec", lambda name: None)
    crowd = crowd_of(through_the_door(0))
    for measure in (
        lambda: flow_through(crowd, DOOR),
        lambda: speed_density(crowd, ROOM),
        lambda: walkable_area(ROOM),
    ):
        with pytest.raises(SettingError, match=r"got no pedpy; .*pip install .*pedpy\]"):
            measure()


def test_weidmanns_curve_falls_from_the_free_speed_to_zero() -> None:
    assert weidmann(np.array([0.0, 1.0, 2.0, 5.4, 9.0])) == pytest.approx(
        [1.34, 1.058, 0.607, 0, 0], abs=1e-3
    )


@pytest.mark.usefixtures("pedpy")
def test_pictures_show_what_was_measured() -> None:
    crowd = crowd_of(*(through_the_door(2 * k) for k in range(10)))
    axes = Figure().add_subplot()
    passed = flow_through(crowd, DOOR)
    plot_n_t(axes, {"theirs": passed, "ours": passed}, {"ours": {"color": "red"}})
    first, second = axes.get_lines()
    assert (first.get_label(), second.get_label(), second.get_color()) == ("theirs", "ours", "red")
    time_s, people = (np.asarray(of, float) for of in first.get_data())
    assert people.tolist() == [*range(11), 10]
    assert time_s[1:-1] == pytest.approx(passed.crossed_s)
    assert time_s[-1] == axes.get_xlim()[1] == crowd.duration_s

    axes, cloud = Figure().add_subplot(), speed_density(crowd, ROOM)
    plot_speed_density(axes, {"ours": cloud})
    dots, curve = axes.get_lines()
    np.testing.assert_array_equal(dots.get_data(), [cloud.per_m2, cloud.speed_mps])
    assert curve.get_label() == "Weidmann (1993)"
    assert axes.get_ylim() == pytest.approx((0, 1.05 * 1.34))


@pytest.mark.usefixtures("pedpy")
def test_an_imported_recording_is_measured_beside_the_crowds() -> None:
    """In the same frames, at the same place: the recording as a crowd is measured like itself."""
    plaza = load_scene("plaza-v0")
    everything = recording_of(plaza).observed_in(np.array([[0, plaza.recording.frames]]))
    reference = read_reference(plaza)
    plot = PlotData.of(plaza, reference, {("mine", "straight", 0): everything}, "heldout")
    assert len(plot.reference.blocks) < len(reference.blocks)
    measured = Measured.of(plot)
    (label,) = (group.label for group in plot.groups)
    assert list(measured.clouds) == list(measured.flows) == [RECORDED, label]
    recorded, mine = measured.clouds.values()
    np.testing.assert_array_equal(recorded.frame, mine.frame)
    np.testing.assert_array_equal(recorded.per_m2, mine.per_m2)
    frames = plot.reference.blocks.frames
    assert all(((f >= frames[:, 0]) & (f < frames[:, 1])).any() for f in recorded.frame.tolist())
    assert measured.flows[RECORDED].crossed_s.tolist() == measured.flows[label].crossed_s.tolist()
    assert len(measured.flows[label].crossed_s) > 50
