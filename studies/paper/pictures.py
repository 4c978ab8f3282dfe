"""The pictures of the study that results pages do not have."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from crowdbench.colours import spawn_colours
from crowdbench.files import replacing
from crowdbench.report.plots.canvas import picture
from studies.paper.evidence import Evidence
from studies.paper.fits import COMPARED, RECORDED
from studies.paper.presence import Presence
from studies.paper.study import DRAWS, SCHEMES
from studies.results.pictures import Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AGENTS = "agents.png"
BURSTS = "bursts.png"
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def draw_bursts(of: Evidence, folder: Path) -> Picture:
    """Draw variance / mean and correlation between areas of the arrivals of each model.

    Raises:
        OutputError: the picture cannot be written.
    """
    length = f"{of.bursts.interval_s:.3g} s"
    panels = {"fano": f"variance / mean in {length}", "correlation": "correlation between areas"}

    def draw(axes: "list[Axes]") -> None:
        colours = spawn_colours([model.model for model in COMPARED])
        for axis, (name, label) in zip(axes, panels.items(), strict=True):
            axis.axvline(getattr(of.bursts, name), color="black", linewidth=1.0)
            for at, model in enumerate(COMPARED):
                colour = colours[model.model]
                middle = float(np.median([getattr(bursts, name) for bursts in of.draws(model)]))
                axis.plot(of.spread(model, name), [at, at], color=colour, linewidth=3.0)
                axis.plot(middle, at, "o", color="white", markeredgecolor=colour, zorder=3)
            axis.set_yticks(range(len(COMPARED)), [model.model for model in COMPARED])
            axis.set(ylim=(len(COMPARED) - 0.4, -0.6), xlabel=label)
            axis.tick_params(axis="y", length=0)
            if axis is not axes[0]:
                axis.tick_params(labelleft=False)

    data = picture(draw, width=7.0, height=2.2, columns=2, kind="small png", shared=False)
    with replacing(folder / BURSTS) as temporary:
        temporary.write_bytes(data)
    return Picture(
        BURSTS,
        "Bursts",
        "Black lines: the recording. Dots and bars: median and 95 % of "
        f"{DRAWS * len(of.samples[COMPARED[0]])} samples of the arrivals of each model, counted in "
        f"intervals of {length}. The variance divided by the mean is 1 for Poisson arrivals; the "
        "correlation is 0 for independent areas.",
    )


def draw_agents(of: Evidence, folder: Path) -> Picture:
    """Draw the distribution of N(t) of the recording and each model, scheme by scheme.

    Raises:
        OutputError: the picture cannot be written.
    """
    scene, recorded = of.scene, of.present
    simulated = {model: each for model, each in of.samples.items() if model != RECORDED}
    everyone = [*recorded, *(p for each in simulated.values() for s in each for p in s.present)]
    most = max(len(present.counts) for present in everyone)
    colours = spawn_colours([model.model for model in simulated])

    def draw(axes: "list[Axes]") -> None:
        for k, (axis, scheme) in enumerate(zip(axes, SCHEMES, strict=True)):
            rows = [("recorded", "black", _shares([recorded[k]]))]
            for model, each in simulated.items():
                shares = _shares([sample.present[k] for sample in each])
                rows.append((model.label, colours[model.model], shares))
            _panel(axis, rows)
            axis.set_title(f"{scheme} × {-(-scene.recording.frames // scheme):,} frames")
        axes[0].set_xlim(0, most)

    height = 0.36 * (1 + len(simulated)) + 1.0
    data = picture(draw, width=6.0, height=height, columns=len(SCHEMES), kind="small png")
    with replacing(folder / AGENTS) as temporary:
        temporary.write_bytes(data)
    return Picture(
        AGENTS,
        "Number of agents",
        "Distribution of the number of people present, all samples pooled. Dots are medians, thick "
        "bars contain 50 % of the frames, thin bars 90 %. The grey band contains the central 50 % "
        "of the recording. *w/o*: windows of w frames with a stride of o frames.",
    )


def _panel(axis: "Axes", rows: Sequence[tuple[str, str, Float[np.ndarray, " _"]]]) -> None:
    """Draw a violin per row, the first on top, with 5–95 % and 25–75 % ranges and the median."""
    _, first, _, third, _ = np.searchsorted(np.cumsum(rows[0][2]), _QUANTILES)
    axis.axvspan(first, third, color="0.9", linewidth=0)
    most = max(len(shares) for _, _, shares in rows)
    for at, (_, colour, shares) in enumerate(rows):
        n, violin = _smooth(shares, most / 100)
        axis.fill_between(n, at - violin, at + violin, color=colour, alpha=0.35, linewidth=0)
        low, first, median, third, high = np.searchsorted(np.cumsum(shares), _QUANTILES)
        axis.plot([low, high], [at, at], color=colour, linewidth=1.0)
        axis.plot([first, third], [at, at], color=colour, linewidth=4.0, solid_capstyle="butt")
        axis.plot(median, at, "o", color="white", markeredgecolor=colour, markersize=4.5, zorder=3)
    axis.set_yticks(range(len(rows)), [label for label, _, _ in rows])
    axis.set(ylim=(len(rows) - 0.4, -0.6), xlabel="agents present (persons)")
    axis.tick_params(axis="y", length=0)


def _shares(samples: Sequence[Presence]) -> Float[np.ndarray, " V"]:
    """Share of the frames with each number of persons, all samples pooled."""
    total = np.zeros(max(len(sample.counts) for sample in samples))
    for sample in samples:
        total[: len(sample.counts)] += sample.counts
    return total / total.sum()


def _smooth(
    shares: Float[np.ndarray, " V"], width: float
) -> tuple[Float[np.ndarray, " X"], Float[np.ndarray, " X"]]:
    """Kernel density with maximum 0.4; the Gaussian kernel is at least half a person wide."""
    width = max(0.5, width)
    n = np.linspace(0, len(shares) - 1 + 2 * width, 400)
    kernel = np.exp(-0.5 * ((n[:, None] - np.arange(len(shares))) / width) ** 2)
    density = kernel @ shares
    return n, 0.4 * density / density.max()
