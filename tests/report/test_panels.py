"""What is drawn, looked at before it is a picture."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from crowdbench.colours import COLOURS, SPAWN_COLOURS, spawn_colours
from crowdbench.data.blocks import TimeBlocks
from crowdbench.metrics import Place
from crowdbench.metrics.presence import AgentsOverTime
from crowdbench.registry import policy, spawn_model
from crowdbench.report.plots import panels
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.scoring.reference import Reference, read_reference
from studies.results.pictures import draw_pictures

ETH = load_scene("eth-v0")


@pytest.fixture(scope="module")
def plot() -> PlotData:
    """One rollout on ETH, whose time blocks do not all touch."""
    crowd = rollout(ETH, spawn_model("poisson-gmm", ETH), policy("straight", ETH), seed=0)
    crowds = {("poisson-gmm", name, 0): crowd for name in ("straight", "social-force")}
    return PlotData.of(ETH, read_reference(ETH), crowds, "full")


def test_a_compared_model_has_one_colour_in_every_picture() -> None:
    alone, beside = spawn_colours(["ntpp-gmm"]), spawn_colours(["mine:A", "ntpp-gmm", "mine:B"])
    assert alone["ntpp-gmm"] == beside["ntpp-gmm"]
    assert len({beside[name] for name in ("mine:A", "mine:B", *SPAWN_COLOURS)}) == 5
    many = spawn_colours([f"mine:{k}" for k in range(9)])
    assert set(many.values()) == set(COLOURS)


def drawn(plot: PlotData) -> tuple[Axes, np.ndarray, np.ndarray]:
    """Agents over time, and the line of the first rollout."""
    axes = Figure().add_subplot()
    panels.agents_over_time(axes, plot, plot.groups[0])
    x, y = axes.get_lines()[-1].get_data()
    return axes, np.asarray(x, dtype=float), np.asarray(y, dtype=float)


def test_agents_over_time_are_drawn_frame_by_frame(plot: PlotData) -> None:
    axes, x, y = drawn(plot)
    present = plot.groups[0].crowds[0].present()
    assert y.tolist() == present[: len(y)].tolist()
    assert x[1] == ETH.dt_s
    assert len(axes.collections) == len(plot.reference.blocks)  # the bands


def test_of_a_long_recording_the_means_of_blocks_are_drawn(
    plot: PlotData, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(panels, "MOST_FRAMES", 100)
    axes, x, y = drawn(plot)
    assert not axes.collections
    present, blocks = plot.groups[0].crowds[0].present(), plot.reference.blocks
    for start, stop in blocks.frames.tolist():
        inside = (x >= start * ETH.dt_s) & (x <= stop * ETH.dt_s) & np.isfinite(y)
        assert present[start:stop].mean() in y[inside]
    # The line breaks where blocks do not touch, and nowhere else.
    gaps = int((blocks.frames[1:, 0] != blocks.frames[:-1, 1]).sum())
    assert gaps > 0
    assert np.isnan(y[:-1]).sum() == gaps
    recorded = plot.reference.statistics["agents_over_time"]["counts"]
    persons = recorded.sum(axis=0) @ np.arange(recorded.shape[1])
    mean = np.average(panels.recorded_means(plot), weights=recorded.sum(axis=1))
    assert mean == pytest.approx(persons / recorded.sum())
    everyone = [crowd.present().max() for group in plot.groups for crowd in group.crowds]
    everyone.append(np.flatnonzero(recorded.any(axis=0)).max())
    assert panels.most_agents(plot) < max(everyone)


def test_the_caption_says_how_much_the_means_of_blocks_vary(
    plot: PlotData, monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    plain = draw_pictures(plot, tmp_path)[0].caption
    assert "90 % of a time block" in plain
    monkeypatch.setattr(panels, "MOST_FRAMES", 100)
    caption = draw_pictures(plot, tmp_path)[0].caption
    assert "Mean number of people present in each time block" in caption
    assert f"recorded {panels.recorded_means(plot).std():.2f}" in caption


def test_means_of_blocks_know_what_the_statistics_know(plot: PlotData) -> None:
    crowd, blocks, place = plot.groups[0].crowds[0], *_seen(plot)
    counts = AgentsOverTime().summarise(crowd, blocks, place)
    of_crowd = replace(plot, reference=Reference(blocks, place, {"agents_over_time": counts}))
    assert panels.recorded_means(of_crowd) == pytest.approx(panels.block_means(plot, crowd))


def _seen(plot: PlotData) -> tuple[TimeBlocks, Place]:
    return plot.reference.blocks, plot.reference.place
