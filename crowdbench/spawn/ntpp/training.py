"""Training of `ntpp-gmm` with torch; no other spawn model imports torch.

The areas have independent networks, which are trained together as one batch. Training windows of
100 frames with a stride of 50 lie within observed stretches, and their last gap is censored. The
loss is the negative log-probability of the counts, including survival terms, summed over an area's
windows and divided by one constant per area (not by the length of each sequence). Each Adam step
uses all windows of an area. If these hold more than 1,024 groups, the windows are divided at random
into 2, 4, … parts of at least eight windows each, which are used in turn. Strongly overlapping
windows therefore lead to more parts, not to slower steps.

The number of training steps is chosen by cross-validation. The time blocks of the training data are
dealt at random into five sets, and five networks per area are trained, each without one of the
sets. The step with the best held-out likelihood is the number of steps for which the final network
is trained on all data; it is chosen separately for each area. Finally, the scale of each area is
shifted so that samples have the recorded number of persons.

Areas whose best step is 0, and areas with fewer than 30 groups, have no network: they keep the
constant rate of groups that training starts from (`NtppGMM.trained`).

docs/spawn-models.md has the effects of the settings on held-out likelihoods.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Bool, Int
from scipy.optimize import brentq
from torch import Tensor

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.ntpp.kernels import draw
from crowdbench.spawn.ntpp.likelihood import Packed, nats, pack
from crowdbench.spawn.ntpp.model import HIDDEN, SHAPES, NtppGMM
from crowdbench.spawn.ntpp.sequences import Sequence, joined, pieces_of, sequences, windows, within
from crowdbench.spawn.times.groups import group_size, spells_of

_JUDGED_EVERY = 8
"""Maximum number of steps between evaluations of the held-out likelihood. If it were evaluated only
after all parts have been used, training on strongly overlapping windows would end at the first
evaluation."""
_PART_WINDOWS = 8
"""Minimum number of windows of an area per step. Without it, long windows with many groups would be
used one or two at a time, or a part could be empty."""
_FURTHEST = 1.0  # maximum shift of a log scale
_FIXED = ("base", "scaling")
_ZERO = ("initial", "out_weight", "out_bias")  # the output of the head starts at `base`
_TRAINED = tuple(name for name in SHAPES if name not in _FIXED)


@dataclass(frozen=True)
class NtppSettings:
    """Settings of training."""

    window_frames: int = 100
    stride_frames: int = 50
    reset_frames: int = 100
    """Length of the silence after which the state of the network is reset to the initial one."""
    learning_rate: float = 5e-3
    initial_rate: float = 10.0
    """Factor of the learning rate of the initial state. Within the few epochs of training it must
    become different from the states that follow groups."""
    epochs: int = 500
    """Maximum number of steps; a step is an epoch if all windows of an area are used at once."""
    patience: int = 50
    """Number of steps without improvement in any area after which training ends."""
    sets: int = 5
    """Number of sets for cross-validation."""
    least_groups: int = 30
    """Minimum number of groups; areas with fewer keep a constant rate of groups."""
    step_groups: int = 1024
    """Approximate maximum number of groups of an area per step."""
    calibration_points: int = 400_000
    """Number of grid points sampled per area and calibration step."""
    shared: bool = False
    """Whether all areas have the same network, and only rates and scales of their own."""


DEFAULT = NtppSettings()


@contextmanager
def deterministic() -> Iterator[None]:
    """Use deterministic algorithms and one thread.

    With several threads the order of summation is not fixed, and networks of this size are not
    faster.
    """
    threads, strict = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(strict)


@deterministic()
def fit(
    arrivals: Arrivals, areas: Areas, scene: Scene, *, seed: int, settings: NtppSettings = DEFAULT
) -> NtppGMM:
    """Train the networks of a scene's areas; the same seed gives the same weights."""
    training = _Training.of(arrivals, scene, settings, seed)
    weights = start_weights(arrivals, seed)
    steps = np.zeros(arrivals.areas, dtype=np.int64)
    for chosen, parts in training.together():
        steps[chosen] = training.best_steps(chosen, parts)
        training.train_chosen(weights, steps, chosen, parts)
    model = NtppGMM(areas, _rounded(weights), arrivals.grid_s, training.reset, asdict(settings))
    return _calibrated(model, arrivals, steps > 0, seed=seed, points=settings.calibration_points)


@dataclass(frozen=True, eq=False)
class _Training:
    """What the networks of all areas are trained with; lengths are in grid points."""

    arrivals: Arrivals
    settings: NtppSettings
    seed: int
    width: int
    """Length of a training window."""
    stride: int
    """Distance from one training window to the next."""
    reset: int
    """Length of the silence after which the state is reset."""
    block: int
    """Length of the pieces that are dealt to the sets of the cross-validation."""

    @classmethod
    def of(cls, arrivals: Arrivals, scene: Scene, settings: NtppSettings, seed: int) -> "_Training":
        frames = settings.window_frames, settings.stride_frames, settings.reset_frames
        lengths = [n * (scene.dt_s / scene.grid_s) for n in frames]
        lengths.append(scene.protocol.block_s / scene.grid_s)
        return cls(arrivals, settings, seed, *(max(1, round(length)) for length in lengths))

    def together(self) -> Iterator[tuple[Int[np.ndarray, " k"], int]]:
        """Areas that are trained together, and the number of parts of their windows.

        They are of similar size, because their sequences are padded to the same size. Areas that
        share a network are trained all together.
        """
        spells = spells_of(self.arrivals)
        groups = np.bincount(spells.area[spells.of_group], minlength=self.arrivals.areas)
        if self.settings.shared:
            yield np.arange(len(groups)), 1
            return
        trained = np.flatnonzero(groups >= self.settings.least_groups)
        rows = groups[trained] * max(1.0, self.width / self.stride)
        size = np.floor(np.log(rows) / np.log(4.0))
        for each in np.unique(size):
            parts = np.ceil(np.log2(rows[size == each].max() / self.settings.step_groups))
            yield trained[size == each], int(2 ** max(0.0, parts))

    def train_chosen(
        self,
        weights: dict[str, np.ndarray],
        steps: Int[np.ndarray, " K"],
        chosen: Int[np.ndarray, " k"],
        parts: int,
    ) -> None:
        """Train the networks of these areas, each for its number of steps; updates `weights`."""
        some = {name: array[chosen] for name, array in weights.items()}
        found = windows(self.arrivals.windows, self.width, self.stride)
        dealt = _Parts.of(
            sequences(self.arrivals, found, chosen), some["scaling"], parts, self.seed
        )
        last = steps[chosen].max()

        def keep(step: int, now: dict[str, Tensor]) -> bool:
            for i in np.flatnonzero(steps[chosen] == step):
                for name in _TRAINED:
                    weights[name][chosen[i]] = now[name][i].detach().numpy()
            return bool(step >= last)

        self._take_steps(some, dealt, keep, len(chosen))

    def best_steps(self, chosen: Int[np.ndarray, " k"], parts: int) -> Int[np.ndarray, " k"]:
        """The step with the best held-out likelihood for each of these areas."""
        pieces = pieces_of(self.arrivals.windows, self.block)
        sets = min(self.settings.sets, len(pieces))
        if sets < 2:
            return np.zeros(len(chosen), dtype=np.int64)
        set_of = np.random.default_rng([self.seed, 1]).permutation(len(pieces)) % sets
        starts: list[dict[str, np.ndarray]] = []
        training: list[list[Sequence]] = []
        held_out: list[list[Sequence]] = []
        for number in range(sets):
            inside = joined(pieces[set_of != number])
            # The initial weights must not depend on the held-out blocks either.
            starts.append(start_weights(within(self.arrivals, inside), self.seed))
            found = windows(inside, self.width, self.stride)
            training += sequences(self.arrivals, found, chosen)
            outside = joined(pieces[set_of == number])
            held_out += sequences(self.arrivals, outside, chosen, memory=self.reset)
        weights = {n: np.concatenate([start[n][chosen] for start in starts]) for n in SHAPES}
        validation = pack(held_out, weights["scaling"])
        dealt = _Parts.of(training, weights["scaling"], parts, self.seed)
        every = min(max(dealt.parts), _JUDGED_EVERY)
        loss: list[np.ndarray] = []

        def judge(step: int, now: dict[str, Tensor]) -> bool:
            if step % every:
                return False
            with torch.no_grad():
                each = nats(now, validation).double().numpy()
            loss.append(each.reshape(sets, -1).sum(axis=0))
            if self.settings.shared:
                loss[-1][:] = loss[-1].sum()
            best = np.argmin(loss, axis=0).max() * every
            return bool(step - best >= self.settings.patience) or step >= self.settings.epochs

        self._take_steps(weights, dealt, judge, len(chosen))
        return np.argmin(loss, axis=0) * every

    def _take_steps(
        self,
        weights: dict[str, np.ndarray],
        dealt: "_Parts",
        seen: Callable[[int, dict[str, Tensor]], bool],
        areas: int,
    ) -> None:
        """Take steps until `seen(step, weights)`, called before the first one too, returns True.

        If networks are shared, the `areas` of each set of the cross-validation have that of the
        first.
        """
        now = {name: torch.tensor(array, dtype=torch.float32) for name, array in weights.items()}
        count, each = len(weights["base"]), areas if self.settings.shared else 1
        owner = torch.arange(count) // each
        own = {name: now[name][::each].clone().requires_grad_() for name in _TRAINED}
        now |= {name: own[name][owner] for name in _TRAINED}
        rate = self.settings.learning_rate
        rates = {"initial": rate * self.settings.initial_rate}
        optimizer = torch.optim.Adam(
            [{"params": [own[name]], "lr": rates.get(name, rate)} for name in _TRAINED]
        )
        step = 0
        while not seen(step, now):
            packed = dealt.at(step)
            optimizer.zero_grad()
            persons = packed.persons.reshape(-1, each).sum(dim=1)
            loss = nats(now, packed).reshape(-1, each).sum(dim=1) / persons
            loss.sum().backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            now |= {name: own[name][owner] for name in _TRAINED}
            step += 1


@dataclass(frozen=True, eq=False)
class _Parts:
    """The sequences of each network, dealt into parts, of which each step uses one."""

    networks: list[list[Sequence]]
    scaling: np.ndarray
    dealt: list[np.ndarray]
    """Index of the part of each sequence, for each network."""
    parts: list[int]
    """Number of parts for each network, a power of 2; networks with fewer parts repeat them."""
    _packed: dict[int, Packed] = field(default_factory=dict)

    @classmethod
    def of(
        cls, networks: list[list[Sequence]], scaling: np.ndarray, parts: int, seed: int
    ) -> "_Parts":
        """Deal the sequences of each network at random into `parts` parts, or fewer if needed."""
        enough = [max(1, len(each) // _PART_WINDOWS) for each in networks]
        several = [min(parts, 2 ** (count.bit_length() - 1)) for count in enough]
        rng = np.random.default_rng([seed, 3])
        dealt = [
            rng.permutation(len(each)) % of if of > 1 else np.zeros(len(each), dtype=np.int64)
            for each, of in zip(networks, several, strict=True)
        ]
        return cls(networks, scaling, dealt, several)

    def at(self, step: int) -> Packed:
        """The packed part for a step; packed when first used, because many parts never are."""
        turn = step % max(self.parts)
        if turn not in self._packed:
            chosen = [
                [each[i] for i in np.flatnonzero(dealt == turn % parts)]
                for each, dealt, parts in zip(self.networks, self.dealt, self.parts, strict=True)
            ]
            self._packed[turn] = pack(chosen, self.scaling)
        return self._packed[turn]


def start_weights(arrivals: Arrivals, seed: int) -> dict[str, np.ndarray]:
    """Initial weights: random, but the head's output is a Poisson process of groups."""
    rng = np.random.default_rng([seed, 0])
    k, bound = arrivals.areas, HIDDEN**-0.5  # as torch starts its GRU
    weights = {
        name: np.zeros((k, *shape)) if name in _ZERO else rng.uniform(-bound, bound, (k, *shape))
        for name, shape in SHAPES.items()
    }
    more, groups = group_size(arrivals)
    log_scale = -np.log(-np.log1p(-groups))
    weights["base"] = np.stack([np.zeros(k), log_scale, np.log(more / (1 - more))], axis=1)
    spells = spells_of(arrivals)
    at = spells.area[spells.of_group]
    weights["scaling"] = np.tile([0.0, 1.0, 0.0, 1.0], (k, 1))
    for area in np.unique(at).tolist():
        for column, values in ((0, spells.gap), (2, spells.size)):
            logs = np.log(values[at == area])
            spread = logs.std()
            weights["scaling"][area, column] = logs.mean()
            weights["scaling"][area, column + 1] = spread if spread > 1e-6 else 1.0
    return _rounded(weights)


def _rounded(weights: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: array.astype(np.float32) for name, array in weights.items()}


def _calibrated(
    model: NtppGMM, arrivals: Arrivals, chosen: Bool[np.ndarray, " K"], *, seed: int, points: int
) -> NtppGMM:
    """The model with log scales of the chosen areas shifted; `points` grid points are sampled.

    Samples get the recorded number of persons. Those of a self-exciting process can have another
    rate than its training data, even though its compensator has the same rate. Areas in which
    nobody enters stay as they are: no shift makes a rate 0.
    """
    persons = np.bincount(arrivals.area, minlength=arrivals.areas)
    recorded = persons / np.diff(arrivals.windows, axis=1).sum()
    base = model.weights["base"].copy()
    for k in np.flatnonzero(chosen & (persons > 0)).tolist():
        of_area = model.of_area(k)
        base[k, 1] += _shift(of_area, model.memory, float(recorded[k]), seed, points)
    return replace(model, weights={**model.weights, "base": base})


def _shift(
    weights: tuple[np.ndarray, ...], memory: int, recorded: float, seed: int, points: int
) -> float:
    """The shift of an area's log scale for which samples have `recorded` persons per grid point.

    It is found between −1 and 1 by root finding. In a self-exciting process the log rate can change
    by four times the shift, so a fixed-point iteration would not converge.
    """
    length = 2_000  # about that of ETH's recording, so that the start has a similar weight
    samples = max(1, points // length)

    def excess(shift: float) -> float:
        base = weights[-2].copy()
        base[1] += shift
        rng = np.random.default_rng([seed, 2])
        now = (*weights[:-2], base, weights[-1])
        sampled = sum(int(draw(length, memory, now, rng)[1].sum()) for _ in range(samples))
        return float(np.log(max(1, sampled) / (samples * length * recorded)))

    low, high = -_FURTHEST, _FURTHEST
    if excess(low) <= 0.0:
        return low
    if excess(high) >= 0.0:
        return high
    return float(brentq(excess, low, high, xtol=0.002, rtol=1e-9))
