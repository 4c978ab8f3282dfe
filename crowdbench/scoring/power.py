"""The power study: which metrics can distinguish a scene's anchor from its recording.

Synthetic recordings y′ are block resamples of the recording. A metric is scored if, in at least
80 % of them, the anchor's energy score exceeds the 95th percentile of the true process's energy
score. The true process is represented by further block resamples, which differ from y′ as another
recording of the same place would.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.data.blocks import TimeBlocks
from crowdbench.metrics import WALK, Metric, Statistics
from crowdbench.scoring.energy import Draws, Embedded

ENOUGH = 0.8
PERCENTILE = 95.0
SYNTHETIC = 500


@dataclass(frozen=True)
class Power:
    """Result of the power study for one metric."""

    metric: str
    floor: float
    """Mean energy score of the true process."""
    threshold: float
    """95th percentile of the energy score of the true process."""
    anchor: float
    """Mean energy score of the anchor."""
    power: float
    """Share of synthetic recordings in which the anchor's energy score exceeds the threshold."""

    @property
    def counts(self) -> bool:
        """Whether the metric is scored."""
        return self.power >= ENOUGH and self.floor > 0


def power(
    metric: Metric,
    recorded: Statistics,
    anchor: Sequence[Statistics],
    blocks: TimeBlocks,
    draws: Draws,
) -> Power | None:
    """The power of one metric; None if the metric is undefined.

    `anchor` holds the statistics of the anchor's rollouts: `poisson-gmm` with straight walkers,
    or, for motion and interaction, straight walkers under the recorded arrivals. The latter are
    resampled together with the recording.
    """
    from scipy.spatial.distance import cdist, pdist

    embedded = Embedded.of(metric, [recorded, *anchor], recorded, blocks)
    if embedded is None:
        return None
    recording = embedded.first(1)  # the vectors of all rollouts might not fit into memory
    y = recording(draws.blocks[:SYNTHETIC])[:, 0]
    truth = recording(draws.blocks[SYNTHETIC : 2 * SYNTHETIC])[:, 0]
    of_truth = cdist(y, truth, "cityblock").mean(axis=1) - pdist(truth, "cityblock").mean() / 2
    if metric.family in WALK:
        x = embedded(draws.blocks[:SYNTHETIC])[:, 1:]
        of_anchor = np.abs(x - y[:, None]).sum(axis=-1).mean(axis=1)
    else:
        x = embedded(embedded.once)[0, 1:]
        of_anchor = cdist(y, x, "cityblock").mean(axis=1) - pdist(x, "cityblock").mean() / 2
    threshold = float(np.percentile(of_truth, PERCENTILE))
    return Power(
        metric=metric.name,
        floor=float(of_truth.mean()),
        threshold=threshold,
        anchor=float(of_anchor.mean()),
        power=float((of_anchor > threshold).mean()),
    )
