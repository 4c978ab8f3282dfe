"""The pictures of the study: distributions of the number of agents, and those of results pages."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from crowdbench.colours import spawn_colours
from crowdbench.files import replacing
from crowdbench.report.plots.canvas import picture
from crowdbench.scene import Scene
from crowdbench.studies.paper.fits import RECORDED, Configuration
from crowdbench.studies.paper.presence import Presence
from crowdbench.studies.paper.study import SCHEMES, Sample

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AGENTS = "agents.png"
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def draw_agents(
    scene: Scene,
    recorded: Sequence[Presence],
    samples: Mapping[Configuration, Sequence[Sample]],
    folder: Path,
) -> None:
    """Draw the distribution of N(t) of the recording and each model, scheme by scheme.

    Raises:
        OutputError: the picture cannot be written.
    """
    simulated = {of: each for of, each in samples.items() if of != RECORDED}
    everyone = [*recorded, *(p for each in simulated.values() for s in each for p in s.present)]
    most = max(len(present.counts) for present in everyone)
    colours = spawn_colours([of.model for of in simulated])

    def draw(axes: "list[Axes]") -> None:
        for k, (axis, scheme) in enumerate(zip(axes, SCHEMES, strict=True)):
            rows = [("recorded", "black", _shares([recorded[k]]))]
            for of, each in simulated.items():
                shares = _shares([sample.present[k] for sample in each])
                rows.append((of.label, colours[of.model], shares))
            _panel(axis, rows)
            axis.set_title(f"{scheme} × {-(-scene.recording.frames // scheme):,} frames")
        axes[0].set_xlim(0, most)

    height = 0.36 * (1 + len(simulated)) + 1.0
    data = picture(draw, width=6.0, height=height, columns=len(SCHEMES), kind="small png")
    with replacing(folder / AGENTS) as temporary:
        temporary.write_bytes(data)


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
