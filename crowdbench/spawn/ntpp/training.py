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

The settings were chosen by held-out likelihood in nats per person, on ETH's folds (2 or 3 seeds,
± 0.003) and on ten hours of new plaza arrivals after half an hour of training (4 recordings,
± 0.006). On these data poisson-gmm has −4.073 and −4.33, renewal-gmm −3.441 and −3.254, and the
true process of the plaza −3.225; poisson-groups, which does not model times, has −3.465 on ETH's
folds. The values were recorded with the code at the time of the choice, when the plaza had neither
waves nor late members, and no command reproduces them. The table has the likelihoods without the
initial state's higher learning rate and without calibration. The first row is the chosen
configuration; each other row changes one setting.

    learning rate 5e-3 (the paper's code; in full batches), windows of 100, stride 50,
    an MLP head, a learned initial state                              −3.420   −3.270
    the paper's learning rate, 1e-4                                   −3.424   −3.281
    a linear head (the paper's code)                                  −3.422   −3.270
    an initial state of zeros (the paper's code)                      −3.420   −3.270
    a stride of 100                                                   −3.423   −3.280
    windows of 50, stride 25                                          −3.418   −3.284
    windows of 200, learning rate 2e-3                                −3.419   −3.270
    areas with fewer than 30 groups trained too                       −3.531   −3.270
    started from renewal-gmm, not from Poisson                        −3.438   −3.267
    one network for all areas of a scene                              −3.427   −3.268

The head and the initial state hardly affect the likelihood, but the initial state affects samples:
if it learns ten times faster, the plaza's first 25 frames have 1.11 instead of 1.26 times the mean
number of persons. The calibration costs 0.002 to 0.004 nats; without it samples have 0.83 to 1.04
times the recorded number of persons. With both, the values are −3.428 and −3.262. After 5 or 10
hours of training on the plaza they are −3.247 and −3.246: half of the difference to the true
process is estimation error, and half is due to the limited model (a Weibull distribution that
depends on a few groups).

Two later changes were made for Grand Central, where trains bring people to an area every ten
minutes. After a silence of 100 frames, the state of the network is reset. And the calibration uses
root finding, because samples had up to 1.4 times the recorded number of persons, and this ratio can
change by four times the shift. On the first and third fold of Grand Central, renewal-gmm has −1.997
and −1.854 nats per person. With these changes, and resets after a silence as long as a window,
windows of 100, 200 and 500 frames have −1.900, −1.896, −1.896 on the first and −1.789, −1.788,
−1.792 on the third fold. On ETH's folds windows of 100 and 500 frames have −3.430 and −3.434.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.ntpp.calibration import calibrated
from crowdbench.spawn.ntpp.likelihood import Batch, nats, pack
from crowdbench.spawn.ntpp.model import HIDDEN, SHAPES, NtppGMM
from crowdbench.spawn.ntpp.sequences import (
    Sequence,
    joined,
    pieces_of,
    sequences,
    windows,
    within,
)
from crowdbench.spawn.times.groups import group_size, spells_of

_JUDGED_EVERY = 8
"""Maximum number of steps between evaluations of the held-out likelihood. If it were evaluated only
after all parts have been used, training on strongly overlapping windows would end at the first
evaluation."""
_PART_WINDOWS = 8
"""Minimum number of windows of an area per step. Without it, long windows with many groups would be
used one or two at a time, or a part could be empty."""
_FIXED = ("base", "scaling")
_ZERO = ("initial", "out_weight", "out_bias")  # the output of the head starts at `base`
_TRAINED = tuple(name for name in SHAPES if name not in _FIXED)


@dataclass(frozen=True)
class Settings:
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


SETTINGS = Settings()


def fit(
    arrivals: Arrivals, areas: Areas, scene: Scene, *, seed: int, settings: Settings = SETTINGS
) -> NtppGMM:
    """Train the networks of a scene's areas; the same seed gives the same weights."""
    with deterministic():
        return _fit(arrivals, areas, scene, seed, settings)


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


def _fit(arrivals: Arrivals, areas: Areas, scene: Scene, seed: int, settings: Settings) -> NtppGMM:
    points_per_frame = scene.dt_s / scene.grid_s
    cutting = _Cutting(
        width=max(1, round(settings.window_frames * points_per_frame)),
        reset=max(1, round(settings.reset_frames * points_per_frame)),
        stride=max(1, round(settings.stride_frames * points_per_frame)),
        block=max(1, round(scene.protocol.block_s / scene.grid_s)),
    )
    spells = spells_of(arrivals)
    groups = np.bincount(spells.area[spells.of_group], minlength=arrivals.areas)
    weights = start_weights(arrivals, seed)
    steps = np.zeros(arrivals.areas, dtype=np.int64)
    for chosen, parts in _batched(groups, cutting, settings):
        steps[chosen] = _best_steps(arrivals, chosen, parts, seed, cutting, settings)
        _train_chosen(weights, steps, arrivals, chosen, parts, seed, cutting, settings)
    model = NtppGMM(areas, _rounded(weights), arrivals.grid_s, cutting.reset, asdict(settings))
    return calibrated(model, arrivals, steps > 0, seed=seed, points=settings.calibration_points)


@dataclass(frozen=True)
class _Cutting:
    """Lengths into which a recording is cut, in grid points."""

    width: int
    """Length of a training window."""
    reset: int
    """Length of the silence after which the state is reset."""
    stride: int
    """Distance from one training window to the next."""
    block: int
    """Length of the pieces that are dealt to the sets of the cross-validation."""


def _batched(
    groups: Int[np.ndarray, " K"], cutting: _Cutting, settings: Settings
) -> Iterator[tuple[Int[np.ndarray, " k"], int]]:
    """Batches of areas that are trained together, and the number of parts of their windows.

    A batch consists of areas of similar size, because their sequences are padded to the same size.
    Areas that share a network are one batch.
    """
    if settings.shared:
        yield np.arange(len(groups)), 1
        return
    trained = np.flatnonzero(groups >= settings.least_groups)
    rows = groups[trained] * max(1.0, cutting.width / cutting.stride)
    size = np.floor(np.log(rows) / np.log(4.0))
    for each in np.unique(size):
        parts = np.ceil(np.log2(rows[size == each].max() / settings.step_groups))
        yield trained[size == each], int(2 ** max(0.0, parts))


def _train_chosen(
    weights: dict[str, np.ndarray],
    steps: Int[np.ndarray, " K"],
    arrivals: Arrivals,
    chosen: Int[np.ndarray, " k"],
    parts: int,
    seed: int,
    cutting: _Cutting,
    settings: Settings,
) -> None:
    """Train the networks of the chosen areas, each for its number of steps; updates `weights`."""
    some = {name: array[chosen] for name, array in weights.items()}
    found = windows(arrivals.windows, cutting.width, cutting.stride)
    batches = _Batches.of(sequences(arrivals, found, chosen), some["scaling"], parts, seed)
    last = steps[chosen].max()

    def keep(step: int, now: dict[str, Tensor]) -> bool:
        for i in np.flatnonzero(steps[chosen] == step):
            for name in _TRAINED:
                weights[name][chosen[i]] = now[name][i].detach().numpy()
        return bool(step >= last)

    _train(some, batches, settings, keep, len(chosen))


def _best_steps(
    arrivals: Arrivals,
    chosen: Int[np.ndarray, " k"],
    parts: int,
    seed: int,
    cutting: _Cutting,
    settings: Settings,
) -> Int[np.ndarray, " k"]:
    """The step with the best held-out likelihood for each of the chosen areas."""
    pieces = pieces_of(arrivals.windows, cutting.block)
    sets = min(settings.sets, len(pieces))
    if sets < 2:
        return np.zeros(len(chosen), dtype=np.int64)
    dealt = np.random.default_rng([seed, 1]).permutation(len(pieces)) % sets
    starts: list[dict[str, np.ndarray]] = []
    training: list[list[Sequence]] = []
    held_out: list[list[Sequence]] = []
    for number in range(sets):
        inside = joined(pieces[dealt != number])
        # The initial weights must not depend on the held-out blocks either.
        start = start_weights(within(arrivals, inside), seed)
        starts.append({name: array[chosen] for name, array in start.items()})
        found = windows(inside, cutting.width, cutting.stride)
        training += sequences(arrivals, found, chosen)
        together = joined(pieces[dealt == number])
        held_out += sequences(arrivals, together, chosen, memory=cutting.reset)
    weights = {name: np.concatenate([start[name] for start in starts]) for name in SHAPES}
    validation = pack(held_out, weights["scaling"])
    batches = _Batches.of(training, weights["scaling"], parts, seed)
    every = min(max(batches.parts), _JUDGED_EVERY)
    loss: list[np.ndarray] = []

    def judge(step: int, now: dict[str, Tensor]) -> bool:
        if step % every:
            return False
        with torch.no_grad():
            each = nats(now, validation).double().numpy()
        loss.append(each.reshape(sets, -1).sum(axis=0))
        if settings.shared:
            loss[-1][:] = loss[-1].sum()
        best = np.argmin(loss, axis=0).max() * every
        return bool(step - best >= settings.patience) or step >= settings.epochs

    _train(weights, batches, settings, judge, len(chosen))
    return np.argmin(loss, axis=0) * every


@dataclass(frozen=True, eq=False)
class _Batches:
    """The sequences of each network, dealt into parts, of which each step uses one."""

    networks: list[list[Sequence]]
    scaling: np.ndarray
    dealt: list[np.ndarray]
    """Index of the part of each sequence, for each network."""
    parts: list[int]
    """Number of parts for each network, a power of 2; networks with fewer parts repeat them."""
    _packed: dict[int, "Batch"] = field(default_factory=dict)

    @classmethod
    def of(
        cls, networks: list[list[Sequence]], scaling: np.ndarray, parts: int, seed: int
    ) -> "_Batches":
        """Deal the sequences of each network at random into `parts` parts, or fewer if needed."""
        enough = [max(1, len(each) // _PART_WINDOWS) for each in networks]
        several = [min(parts, 2 ** (count.bit_length() - 1)) for count in enough]
        rng = np.random.default_rng([seed, 3])
        dealt = [
            rng.permutation(len(each)) % of if of > 1 else np.zeros(len(each), dtype=np.int64)
            for each, of in zip(networks, several, strict=True)
        ]
        return cls(networks, scaling, dealt, several)

    def at(self, step: int) -> "Batch":
        """The packed part for a step; packed when first used, because many parts never are."""
        turn = step % max(self.parts)
        if turn not in self._packed:
            chosen = [
                [each[i] for i in np.flatnonzero(dealt == turn % parts)]
                for each, dealt, parts in zip(self.networks, self.dealt, self.parts, strict=True)
            ]
            self._packed[turn] = pack(chosen, self.scaling)
        return self._packed[turn]


def _train(
    weights: dict[str, np.ndarray],
    batches: _Batches,
    settings: Settings,
    seen: Callable[[int, dict[str, Tensor]], bool],
    areas: int,
) -> None:
    """Take steps until `seen(step, weights)`, called before the first step too, returns True.

    If networks are shared, the `areas` of each set of the cross-validation have that of the first.
    """
    now = {name: torch.tensor(array, dtype=torch.float32) for name, array in weights.items()}
    count, each = len(weights["base"]), areas if settings.shared else 1
    owner = torch.arange(count) // each
    own = {name: now[name][::each].clone().requires_grad_() for name in _TRAINED}
    now |= {name: own[name][owner] for name in _TRAINED}
    rates = {"initial": settings.initial_rate}
    groups = [
        {"params": [own[name]], "lr": settings.learning_rate * rates.get(name, 1.0)}
        for name in _TRAINED
    ]
    optimizer = torch.optim.Adam(groups)
    step = 0
    while not seen(step, now):
        batch = batches.at(step)
        optimizer.zero_grad()
        persons = batch.persons.reshape(-1, each).sum(dim=1)
        loss = nats(now, batch).reshape(-1, each).sum(dim=1) / persons
        loss.sum().backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        now |= {name: own[name][owner] for name in _TRAINED}
        step += 1


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
    """Weights rounded to float32, as in their file."""
    return {name: array.astype(np.float32) for name, array in weights.items()}
