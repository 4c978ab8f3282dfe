"""The page's pictures: those of an evaluation, of all its rollouts, with captions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench.report.html.pictures import medians
from crowdbench.report.plots import PlotData, draw_figure
from crowdbench.report.plots.panels import MOST_PATHS, block_means, in_blocks, recorded_means
from crowdbench.report.text.words import plainly

SHOWN = 6
"""Rollouts of each crowd whose number of agents is drawn."""
POLICY = "social-force"
"""Where a picture is about who comes and goes, one policy walks them: lines would lie double."""


@dataclass(frozen=True)
class Picture:
    """A picture of the page."""

    file: str
    title: str
    caption: str


def draw_pictures(plot: PlotData, folder: Path) -> list[Picture]:
    """Draw all pictures of a protocol's rollouts into `folder`.

    Raises:
        OutputError: a picture cannot be written.
    """
    one = plot.narrowed(policy=POLICY)
    drawn = {
        "agents_over_time.png": one.narrowed(rollouts=SHOWN),
        "autocorrelation.png": plot,
        "inter_spawn.png": one,
        "spawns_per_10_frames.png": one,
        "dwell.png": plot,
        "paths.png": one,
    }
    for file, what in drawn.items():
        draw_figure(file, what, folder)
    scene = plot.scene
    curves = (
        "The curves show the share of values above x, all rollouts together; grey is what 95 % of "
        "the resamples of the recording’s time blocks lie between, so that within it the "
        "recording is too short to tell a crowd from it."
    )
    walkers = f"Walkers are {POLICY}."
    return [
        Picture(
            "agents_over_time.png",
            "Agents over time",
            f"{_present(one, walkers)}",
        ),
        Picture(
            "autocorrelation.png",
            "Autocorrelation of the number of agents",
            "Correlation of the number of people present with that a lag later, both in one time "
            "block; of the models the mean over all rollouts. Grey and whiskers: 95 % by "
            f"resampling time blocks. Dots: the lags that the metric compares. "
            f"{_at_lags(plot)}",
        ),
        Picture(
            "inter_spawn.png",
            "Inter-spawn times",
            f"Time from one arrival to the next anywhere in the scene. {curves} {walkers} "
            f"{_in_seconds(one, 'inter_spawn', scene.grid_s)}",
        ),
        Picture(
            "spawns_per_10_frames.png",
            "Spawns per 10 frames",
            f"People who enter in {10 * scene.dt_s:.3g} s. Curves and band as above. {walkers} "
            f"{medians(one, one.curves('spawns_per_10_frames'), 1.0)}",
        ),
        Picture(
            "dwell.png",
            "Dwell time",
            "Time from entering to leaving, by Kaplan and Meier where observation ends first. "
            f"Curves and band as above. {_in_seconds(plot, 'dwell', scene.dt_s)}",
        ),
        Picture(
            "paths.png",
            "Paths",
            f"Ways of the first {MOST_PATHS} people, or of all where there are fewer, of "
            f"{'the recording and of ' * (plot.recording is not None)}one rollout of each model, "
            f"in the colour of their goal area. Walls are grey, dashed ellipses spawn areas, solid "
            f"ones goal areas (two standard deviations). {walkers}",
        ),
    ]


def _in_seconds(plot: PlotData, name: str, unit_s: float) -> str:
    return medians(plot, plot.curves(name), unit_s).replace("Medians", "Medians in seconds")


def _at_lags(plot: PlotData) -> str:
    """The values at the dots."""
    compared = plot.compared_autocorrelation()
    each = plot.autocorrelations(compared.lag_s.tolist())
    found = []
    for k, lag_s in enumerate(compared.lag_s):
        models = ", ".join(
            f"{group.label} {plainly(values[k])}"
            for group, values in zip(plot.groups, each, strict=True)
        )
        found.append(f"At {lag_s:g} s: recorded {plainly(compared.value[k])}, {models}.")
    return " ".join(found)


def _present(plot: PlotData, walkers: str) -> str:
    """What the picture of agents over time shows."""
    drawn = f"Number of people present in {SHOWN} rollouts of each model, one of them drawn out"
    if not in_blocks(plot):
        return (
            f"{drawn}. Grey: what the recorded number lies between for 90 % of a time block, "
            f"black: its mean there. {walkers} "
            f"{medians(plot, plot.curves('agents_over_time'), 1.0)}"
        )
    spread = [f"recorded {plainly(float(recorded_means(plot).std()))}"]
    for group in plot.groups:
        each = [block_means(plot, crowd).std() for crowd in group.crowds]
        spread.append(f"{group.label} {plainly(float(np.mean(each)))}")
    return (
        f"{drawn}, by its mean over each time block; black: that of the recording. {walkers} "
        f"Standard deviation of these means over the blocks, of the models the mean over all "
        f"rollouts: {', '.join(spread)}."
    )
