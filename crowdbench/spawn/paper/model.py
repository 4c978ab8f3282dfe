"""`ntpp-paper`: the neural temporal point process of the founding paper, to the letter.

The ICRA 2025 paper "Whenever, Wherever", Sec. III-B: in each area a GRU with 32 units reads the
gaps between persons, and an MLP with 32 hidden units maps its state to a Weibull distribution of
the next gap, in continuous time (eq. 5). Each person is one event. What the paper leaves open is
as in its published code (github.com/thkreutz/crowdorchestrationsim, `code/src/tpp`): the inputs are
τ and log τ in frames, outputs go through softplus, and P(gap > τ) = exp(−b τᵏ). The random initial
state is drawn once per area and fit and is not trained, so that the model has a density.

The published code differs from the paper. With the setting `published_code` the model does what
the code does:

- The head is linear, and the initial state is zero.
- An event is a frame in which at least one person enters, so the others in it are lost.
- A training window begins at its first event, and always lasts for the full number of frames.
- The sampler clamps the state of the GRU at 1e-8, training does not. So samples do not follow the
  density that was trained.

Recorded times are known up to the annotation grid. A density of continuous times would be infinite
where several persons enter at one grid point, so each person is placed at random within its grid
step. Training needs torch (`crowdbench.spawn.paper.training`); sampling does not. For
crowdbench's own model, which treats groups, short recordings and the start of observation
differently, see `crowdbench.spawn.ntpp.model`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Float16, Float32
from numpy.random import Generator

from crowdbench.data.table import Numbers
from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.fits import FitFile
from crowdbench.spawn.ntpp.model import NetworkFit, NetworkModel
from crowdbench.spawn.times.groups import check_grid

NAME = "ntpp-paper"
PLACEMENTS = 10
"""Number of random placements within the grid steps over which the likelihood is averaged."""
MOST_PER_FRAME = 50
"""Samples with more events per frame and area are refused."""


class PaperFit(NetworkFit, frozen=True):
    """Weights of each area; gates in the order of torch.

    A linear head has no hidden layer; then `hidden_weight` and `hidden_bias` are 0 and not used.
    """

    input_weight: Float16[np.ndarray, "K 96 2"]
    input_bias: Float32[np.ndarray, "K 96"]
    state_weight: Float16[np.ndarray, "K 96 32"]
    state_bias: Float32[np.ndarray, "K 96"]
    initial: Float32[np.ndarray, "K 32"]
    hidden_weight: Float16[np.ndarray, "K 32 32"]
    hidden_bias: Float32[np.ndarray, "K 32"]
    out_weight: Float16[np.ndarray, "K 2 32"]
    out_bias: Float32[np.ndarray, "K 2"]


SHAPES = PaperFit.shapes()
"""Shapes of the weights of one area, in the order that the kernels expect."""


@dataclass(frozen=True, eq=False)
class NtppPaper(NetworkModel):
    """The paper's temporal point process per area, with the scene's Gaussian areas."""

    frame_s: float
    """Unit of time of the networks: a frame of the scene, seconds."""
    grid_s: float
    """Step of the annotation grid, seconds."""
    settings: Mapping[str, int | float | bool] = field(default_factory=dict)
    """Training settings (`crowdbench.spawn.paper.training`); fit k of a file has the seed k."""
    name: str = NAME
    file: ClassVar[FitFile[PaperFit]] = FitFile(NAME, 2, PaperFit, ".safetensors")

    @property
    def published_code(self) -> bool:
        """Whether this is the model of the published code."""
        return bool(self.settings.get("published_code", False))

    def times(self, horizon_s: float, rng: Generator) -> list[Float[np.ndarray, " _"]]:
        """Sample the times of the events of each area in [0, `horizon_s`), in frames.

        Raises:
            SettingError: a network produces more than 50 events per frame.
        """
        from crowdbench.spawn.paper.kernels import draw

        end, code = horizon_s / self.frame_s, self.published_code
        most = round(MOST_PER_FRAME * end) + 1
        found = []
        for k in range(len(self.areas.spawn)):
            times = draw(end, most, self.of_area(k), code, code, rng)
            if len(times) == most:
                raise SettingError(
                    f"{NAME} of {self.areas.scene}",
                    got=f"a network of area {k} with more than {MOST_PER_FRAME} events per frame",
                    expected="networks whose samples do not explode",
                    hint="Train longer, or with another learning rate.",
                )
            found.append(times)
        return found

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds.

        Raises:
            SettingError: a network produces more than 50 events per frame.
        """
        times = self.times(horizon_s, rng)
        area = np.repeat(np.arange(len(times)), [len(each) for each in times])
        frames = np.concatenate([np.empty(0), *times])
        if self.published_code:
            frames = np.floor(frames)
        return self.areas.draw(frames * self.frame_s, area, scene, rng)

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """A lower bound of the log-probability of the arrivals, nats per person.

        The probability of n persons at a grid point is an integral of the density over their n
        ordered times within the grid step Δ. By Jensen's inequality its logarithm is at least
        E[log f] + n log Δ − log n!, over uniform times (Theis et al. 2016, A note on the evaluation
        of generative models, Sec. 3.1). The mean is over ten random placements.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        from scipy.special import gammaln

        check_grid(arrivals, self.grid_s, NAME)
        rng = np.random.default_rng(0)
        counts = arrivals.counts()
        volume = counts.sum() * np.log(self.grid_s / self.frame_s) - gammaln(counts + 1).sum()
        logs = [self._log_density(arrivals, rng) for _ in range(PLACEMENTS)]
        return float((np.mean(logs) + volume) / max(1, len(arrivals.tick)))

    def _log_density(self, arrivals: Arrivals, rng: Generator) -> float:
        from crowdbench.spawn.paper.kernels import density

        total, step = 0.0, self.grid_s / self.frame_s
        times = (arrivals.tick + rng.random(len(arrivals.tick))) * step
        for k in range(len(self.areas.spawn)):
            mine = np.sort(times[arrivals.area == k])
            for start, stop in (arrivals.windows * step).tolist():
                total += density(
                    gaps_within(mine, start, stop), self.of_area(k), self.published_code
                )[0].sum()
        return float(total)


def between(times: Float[np.ndarray, " n"], start: float, stop: float) -> Float[np.ndarray, " m"]:
    """The times, which are ascending, in [`start`, `stop`)."""
    return times[np.searchsorted(times, start) : np.searchsorted(times, stop)]


def gaps_within(times: Numbers, start: float, stop: float) -> Float[np.ndarray, " m"]:
    """The gaps from `start` to `stop`, at and between the times within, which are ascending."""
    return np.diff(np.concatenate([[start], between(times, start, stop), [stop]]))
