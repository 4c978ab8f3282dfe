"""The pictures of the results page, of rollouts of an evaluation, with captions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench.report.html.pictures import medians
from crowdbench.report.plots.panels import MOST_PATHS, block_means, in_blocks, recorded_means
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.report.text.words import plainly
from studies.results.drawing import draw_figure, narrowed, recording_in

SHOWN = 6
"""Number of rollouts per crowd in the picture of agents over time."""
POLICY = "social-force"
"""The policy in pictures about arrivals, where the lines of several policies would coincide."""


@dataclass(frozen=True)
class Picture:
    """A picture of the page, with its file name, title and caption."""

    file: str
    title: str
    caption: str


def draw_pictures(plot: PlotData, folder: Path, policy: str = POLICY) -> list[Picture]:
    """Draw all pictures into `folder` and return them in the order of the page.

    Pictures about arrivals show the rollouts of `policy` only.

    Raises:
        OutputError: a picture cannot be written.
    """
    one = narrowed(plot, policy=policy)
    drawn = {
        "agents_over_time.png": narrowed(one, rollouts=SHOWN),
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
        "Curves: share of values above x, all rollouts pooled. Grey band: 95 % of resamples of the "
        "recording’s time blocks; within it, the recording is too short to distinguish a crowd "
        "from it."
    )
    walkers = f"Walkers are {policy}."
    recorded = "the recording and of " if recording_in(plot) is not None else ""
    return [
        Picture(
            "agents_over_time.png",
            "Agents over time",
            f"{_present(one, walkers)}",
        ),
        Picture(
            "autocorrelation.png",
            "Autocorrelation of the number of agents",
            "Correlation of the number of people present with the number one lag later, in the "
            "same time block; for models, the mean over all rollouts. Grey band and whiskers: 95 % "
            "of resamples of the recording’s time blocks. Dots: the lags that the metric compares. "
            f"{_at_lags(plot)}",
        ),
        Picture(
            "inter_spawn.png",
            "Inter-spawn times",
            f"Time between consecutive arrivals in the whole scene. {curves} {walkers} "
            f"{_in_seconds(one, 'inter_spawn', scene.grid_s)}",
        ),
        Picture(
            "spawns_per_10_frames.png",
            "Spawns per 10 frames",
            f"Number of people who enter in {10 * scene.dt_s:.3g} s. Curves and band as above. "
            f"{walkers} {medians(one, one.curves('spawns_per_10_frames'), 1.0)}",
        ),
        Picture(
            "dwell.png",
            "Dwell time",
            "Time from entering to leaving; a Kaplan–Meier estimate, as observation may end "
            f"earlier. Curves and band as above. {_in_seconds(plot, 'dwell', scene.dt_s)}",
        ),
        Picture(
            "paths.png",
            "Paths",
            f"Paths of the first {MOST_PATHS} people (or of all, if there are fewer) of "
            f"{recorded}one rollout of each model, "
            "in the colours of their goal areas. Grey: walls; dashed ellipses: spawn areas; solid "
            f"ellipses: goal areas (two standard deviations). {walkers}",
        ),
    ]


def _in_seconds(plot: PlotData, name: str, unit_s: float) -> str:
    return medians(plot, plot.curves(name), unit_s).replace("Medians", "Medians in seconds")


def _at_lags(plot: PlotData) -> str:
    """Sentences with the values at the lags that the metric compares."""
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
    """Caption of the picture of agents over time."""
    shown = min(SHOWN, max(len(group.crowds) for group in plot.groups))
    rollouts = f"{shown} rollouts of each model, one of them highlighted"
    if not in_blocks(plot):
        return (
            f"Number of people present in {rollouts}. Black: mean of the recording in each time "
            f"block; grey: its range in 90 % of a time block. {walkers} "
            f"{medians(plot, plot.curves('agents_over_time'), 1.0)}"
        )
    spread = [f"recorded {plainly(float(recorded_means(plot).std()))}"]
    for group in plot.groups:
        each = [block_means(plot, crowd).std() for crowd in group.crowds]
        spread.append(f"{group.label} {plainly(float(np.mean(each)))}")
    return (
        f"Mean number of people present in each time block, in {rollouts}. Black: the recording. "
        f"{walkers} Standard deviation of these means over the blocks (for models, the mean over "
        f"all rollouts): {', '.join(spread)}."
    )
