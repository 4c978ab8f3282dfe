"""`ntpp-gmm`: neural temporal point processes, one per area, with the scene's Gaussian areas.

Based on the ICRA 2025 paper "Whenever, Wherever", Sec. III-B: a recurrent network (GRU) reads an
area's groups, and a small head maps its state to a Weibull distribution of the time to the next
group. The differences to the paper, and their reasons:

- People who enter an area at the same grid point are one event with a size. The size has a
  geometric distribution, which is the head's third output. If each person were an event, there
  would be gaps of 0, at which a Weibull density is 0 or infinite.
- Gaps are on the annotation grid: with S the Weibull survival function in grid steps, a gap lasts
  g ≥ 1 steps with probability S(g − 1) − S(g).
- An observed stretch starts at any time, not at a group. The wait to the first group is predicted
  by the same head from a learned initial state, which thereby learns the forward recurrence time.
  Samples start stationary instead of with a group in every area.
- After a silence as long as a training window, the state is reset to the initial state, because no
  training window contains what follows a longer silence.
- Areas with few groups, and areas where cross-validation selects no training step, keep the model
  from before training: a constant rate of groups, as in `poisson-groups` (see `trained`).
- Training and sampling compute state updates in the same way, without clamping. The outputs of the
  head are bounded around the Poisson solution (`crowdbench.spawn.ntpp.kernels`).

Training needs torch (`crowdbench.spawn.ntpp.training`); sampling and likelihood do not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Float16, Float32, Int
from msgspec import Meta, structs
from numpy.random import Generator

from crowdbench.errors import WeightsError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.arrays import Fit, Rule, dtype_of
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.fits import FitFile, Fitted
from crowdbench.spawn.times.groups import HasHazards, Hazards, check_grid, spells_of

NAME = "ntpp-gmm"
NEVER_FORGETS = 2**31 - 1
HIDDEN = 32


class NetworkFit(Fit, frozen=True):
    """What the fits of `ntpp-gmm` and `ntpp-paper` have in common.

    Matrices, which are almost all of a file, are float16: the difference is far below that of two
    fits. Biases and initial states are float32, because they take little space, and so are `base`
    and `scaling`, for which float16 is not precise enough: it would round a log scale of 9 by up to
    0.004.
    """

    grid_s: float
    memory: Annotated[int, Meta(ge=1)]
    settings: dict[str, int | float | bool]

    @classmethod
    def arrays(cls) -> dict[str, Any]:
        """The annotation of each array of weights, by name."""
        return {f.name: f.type for f in structs.fields(cls) if hasattr(f.type, "dim_str")}

    @classmethod
    def dims(cls) -> dict[str, list[str]]:
        """The letters and sizes of each array of weights, by name."""
        return {name: of.dim_str.split() for name, of in cls.arrays().items()}

    @classmethod
    def shapes(cls) -> dict[str, tuple[int, ...]]:
        """Shapes of the weights of one area, by name, in the order that the kernels expect."""
        return {name: tuple(map(int, each[1:])) for name, each in cls.dims().items()}

    @classmethod
    def of_networks(cls) -> list[str]:
        """Weights that only areas with a trained network use: of others, they are read as 0."""
        return [name for name, each in cls.dims().items() if each[0] == "N"]

    def rules(self, scene: Scene) -> list[Rule]:
        """The networks are made for the scene's time grid."""
        same = np.isclose(self.grid_s, scene.grid_s)
        return [("grid_s", same, f"{scene.grid_s:g} s, the step of the scene's grid")]


class NtppFit(NetworkFit, frozen=True):
    """Weights of the `N` areas with a trained network, and what the others need as well.

    The gates of the GRU are in the order reset, update, candidate, as in torch. `base` is added to
    the head's outputs: log shape, log scale (grid steps) and log odds of one more member. `scaling`
    holds mean and standard deviation of log gap (grid steps), then of log size.
    """

    input_weight: Float16[np.ndarray, "N 96 2"]
    input_bias: Float32[np.ndarray, "N 96"]
    state_weight: Float16[np.ndarray, "N 96 32"]
    state_bias: Float32[np.ndarray, "N 96"]
    initial: Float32[np.ndarray, "N 32"]
    hidden_weight: Float16[np.ndarray, "N 32 32"]
    hidden_bias: Float32[np.ndarray, "N 32"]
    out_weight: Float16[np.ndarray, "K 3 32"]
    out_bias: Float32[np.ndarray, "K 3"]
    base: Float32[np.ndarray, "K 3"]
    scaling: Float32[np.ndarray, "K 4"]

    def rules(self, scene: Scene) -> list[Rule]:
        """There is a network for each area that has one, and all standard deviations are > 0."""
        trained = has_network(self.out_weight)
        return [
            *super().rules(scene),
            ("initial", len(self.initial) == trained.sum(), f"{trained.sum()} networks"),
            ("scaling", (self.scaling[:, 1::2] > 0).all(), "standard deviations > 0"),
        ]


SHAPES = NtppFit.shapes()
"""Shapes of the weights of one area, in the order that the kernels expect."""


def has_network(out_weight: Float[np.ndarray, "K out 32"]) -> Bool[np.ndarray, " K"]:
    """Whether each area has a trained network, whose output depends on the past."""
    return np.asarray(out_weight.any(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class NetworkModel(Fitted):
    """A network for each area: what `ntpp-gmm` and `ntpp-paper` have in common."""

    weights: Mapping[str, Float[np.ndarray, "K ..."]]
    """Arrays by name as in the model's `NetworkFit`, with all areas as first axis; float32.

    They are rounded as in a file, so that a model that was just trained is the one that is read.
    """

    def __post_init__(self) -> None:
        """Round the weights.

        Raises:
            WeightsError: a weight is not finite, or too large for its kind of number in files.
        """
        weights = {name: array.astype(np.float32) for name, array in self._in_file().items()}
        object.__setattr__(self, "weights", weights)

    def of_area(self, k: int) -> tuple[np.ndarray, ...]:
        """The weights of one area in the form that the kernels expect."""
        names = self.file.kind.shapes()
        return tuple(np.ascontiguousarray(self.weights[n][k], dtype=np.float64) for n in names)

    def trained(self) -> Bool[np.ndarray, " K"]:
        """Whether each area has a trained network.

        In areas with few groups, and where cross-validation selected no training step, the output
        weights are 0: groups enter at a constant rate, as in `poisson-groups`.
        """
        return has_network(self.weights["out_weight"])

    def _in_file(self) -> dict[str, np.ndarray]:
        """The weights with their kind of number in files."""
        found = {}
        for name, of in self.file.kind.arrays().items():
            dtype, array = dtype_of(of), self.weights[name]
            with np.errstate(over="ignore"):
                found[name] = array.astype(dtype)
            wrong = ~np.isfinite(found[name])
            if wrong.any():
                area = wrong.nonzero()[0][0]
                raise WeightsError(
                    f"{self.file.model} of {self.areas.scene}, {name} of area {area}",
                    got=f"a weight of {array[wrong][0]:g}",
                    expected=f"{dtype}, a number within ±{np.finfo(dtype).max:g}",
                    hint="Train with a lower learning rate.",
                )
        return found

    def _fit(self) -> NetworkFit:
        weights, kind = self._in_file(), self.file.kind
        weights |= {name: weights[name][self.trained()] for name in kind.of_networks()}
        own: Any = self
        return kind(
            grid_s=own.grid_s,
            memory=getattr(self, "memory", NEVER_FORGETS),
            settings=dict(sorted(own.settings.items())),
            **weights,
        )

    @classmethod
    def _of_fit(cls, fit: Any, areas: Areas, scene: Scene, **more: Any) -> Any:
        weights = {name: getattr(fit, name) for name in fit.shapes()}
        for name in fit.of_networks():
            of_all = np.zeros((len(areas.spawn), *weights[name].shape[1:]), dtype=np.float32)
            of_all[has_network(fit.out_weight)] = weights[name]
            weights[name] = of_all
        return super()._of_fit(fit, areas, scene, weights=weights)


@dataclass(frozen=True, eq=False)
class NtppGMM(HasHazards, NetworkModel):
    """Neural temporal point process of groups per area, with the scene's Gaussian areas."""

    grid_s: float
    """Step of the time grid on which groups enter, seconds."""
    memory: int = NEVER_FORGETS
    """Number of grid steps without a group after which the state is reset to the initial one."""
    settings: Mapping[str, int | float] = field(default_factory=dict)
    """Settings of training; fit k of a file has the seed k."""
    name: str = NAME
    file: ClassVar[FitFile[NtppFit]] = FitFile(NAME, 4, NtppFit, ".safetensors")

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds; times are on the grid."""
        from crowdbench.spawn.ntpp.kernels import draw

        points = int(np.ceil(horizon_s / self.grid_s - 1e-6))
        tick, area = [np.empty(0)], [np.empty(0, dtype=np.int64)]
        for k in range(len(self.areas.spawn)):
            groups, size = draw(points, self.memory, self.of_area(k), rng)
            tick.append(np.repeat(groups, size))
            area.append(np.full(len(tick[-1]), k))
        return self.areas.draw(np.concatenate(tick) * self.grid_s, np.concatenate(area), scene, rng)

    def hazards(self, arrivals: Arrivals) -> Hazards:
        """Cumulative hazards of the groups.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        from crowdbench.spawn.ntpp.kernels import expect

        check_grid(arrivals, self.grid_s, NAME)
        spells, found = spells_of(arrivals), []
        for k in range(len(self.areas.spawn)):
            own = spells.of_area(k)
            n, of_area = len(own.gap), (own.gap, own.size, own.offsets, own.rest)
            filled = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(len(own.rest))
            expect(*of_area, self.memory, self.of_area(k), *filled)
            found.append(filled)
        return Hazards(*(np.concatenate(each) for each in zip(*found, strict=True)))


def networks(scene: Scene, areas: Areas, splits: Sequence[str]) -> Int[np.ndarray, "F K"]:
    """Number of trained networks for each fit and area, over the given splits.

    Raises:
        WeightsError: the scene's file is missing or broken, or belongs to another scene.
    """
    fits = range(scene.protocol.fits)
    each = [[NtppGMM.read(scene, areas, p, fit).trained() for p in splits] for fit in fits]
    return np.sum(each, axis=1)
