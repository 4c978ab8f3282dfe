"""Training of `joint-gmm` with torch.

First the network learns from other places, if there are any: `pretrained` maximises the
log-likelihood of their arrivals in nats per person, for a fixed number of steps. Then `fit` goes on
with the scene's own training blocks. The number of steps there is chosen by cross-validation, as
for `ntpp-gmm`: the blocks are dealt into sets, each set is predicted by a network that has not seen
it, and the step with the best likelihood of all sets is the number of steps for which the final
network is trained. Where the own recording has too little to say, that is none, and the network
stays as other places taught it.

Windows are cut at random into pieces, because the network must know young traces as well.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.joint.model import SHARED, WEIGHTS, JointGMM
from crowdbench.spawn.joint.places import LEVELS, Place, tensor
from crowdbench.spawn.joint.traces import (
    BINS,
    FEATURES,
    RATE_BOUND,
    SIZE_BOUND,
)
from crowdbench.spawn.joint.trunks import Trunk, read_trunk
from crowdbench.spawn.ntpp.sequences import joined, pieces_of, within
from crowdbench.spawn.ntpp.training import deterministic

_MOST_FOLLOWERS = 0.9
_EVERY = 10
_ROUNDS, _LONG_S, _MANY, _FURTHEST = 12, 20_000.0, 2_000, 2.0
"""Calibration: number of rounds, least length of a sample and number of people in it, and the
largest change of a log rate."""


@dataclass(frozen=True)
class JointSettings:
    """Settings of training."""

    hidden: int = 32
    pretraining: int = 40
    """Number of training steps on other places."""
    learning_rate: float = 3e-3
    follower_rate: float = 3e-2
    """Learning rate of the followers, which are few and start near 0."""
    weight_decay: float = 1e-2
    own_in_decay: float = 10.0
    own_out_decay: float = 1.0
    """Weights of the squares of what is different in each area in the loss, in nats: normal priors
    with standard deviations of 0.22 and 0.71."""
    steps: int = 400
    """Maximum number of training steps on the scene's own recording."""
    patience: int = 60
    """Number of steps without improvement after which cross-validation ends."""
    sets: int = 4
    """Number of sets for cross-validation."""
    steepest: float = 0.9
    """How steeply the log rate of arrivals may rise with the log of a constant level of them."""
    steepness: float = 1.0
    """Weight of the squares of what is steeper in the loss, nats per person."""


DEFAULT = JointSettings()


def _too_steep(
    now: Mapping[str, Tensor], own: Mapping[str, Tensor], place: Place, steepest: float
) -> Tensor:
    """Mean square of how much too steeply the rate rises with a constant level of arrivals.

    A process that reacts to its own past has a second level, or none, where a higher level of
    arrivals makes them more frequent by as much or more. One-step likelihood does not see that.
    """
    out = _outputs(now, own, place.levels)
    people = place.log_rate + out[0] + torch.nn.functional.softplus(place.log_odds + out[1])
    slope = torch.logsumexp(people, dim=1).diff() / np.diff(LEVELS)[0]
    return (slope - steepest).clamp(min=0.0).square().mean()


def _outputs(
    now: Mapping[str, Tensor], own: Mapping[str, Tensor], features: Tensor
) -> tuple[Tensor, Tensor]:
    """Logarithms of the factors of the rate of groups and of the odds, for all areas."""
    x = torch.tanh(features @ now["in_weight"].T + now["in_bias"] + own["own_in"])
    x = torch.tanh(x @ now["weight"].T + now["bias"])
    out = x @ now["out_weight"].T + now["out_bias"] + own["own_out"]
    faster = RATE_BOUND * torch.tanh(out[..., 0] / RATE_BOUND)
    return faster, SIZE_BOUND * torch.tanh(out[..., 1] / SIZE_BOUND)


def _log_probability(now: Mapping[str, Tensor], own: Mapping[str, Tensor], place: Place) -> Tensor:
    """Log-probability of the numbers of people at all grid points and areas."""
    faster, larger = _outputs(now, own, place.features)
    base = (place.log_rate + faster).exp()
    following, alone = followers_of(now["followers"]), torch.sigmoid(-place.log_odds)
    nobody = -(place.points @ base).sum() - alone @ (place.recent @ following)
    at = place.step, place.area
    rate = base[at] + alone[place.area] * (place.before @ following)
    odds = place.log_odds[place.area] + larger[at]
    log_sigmoid = torch.nn.functional.logsigmoid
    some = (-torch.expm1(-rate.clamp(min=1e-9))).log() + rate + log_sigmoid(-odds)
    return nobody + (some + (place.number - 1) * log_sigmoid(odds)).sum()


def followers_of(raw: Tensor) -> Tensor:
    """Numbers of followers > 0 whose sum is below `_MOST_FOLLOWERS`, of any numbers (5,)."""
    return _MOST_FOLLOWERS * torch.softmax(torch.cat([raw, torch.zeros(1)]), dim=0)[:-1]


def untaught(seed: int, settings: JointSettings = DEFAULT) -> Trunk:
    """A network that has learned nothing: with it, `joint-gmm` is `poisson-groups`."""
    rng, size = np.random.default_rng([seed, 0]), settings.hidden
    shapes = ((size, FEATURES), (size,), (size, size), (size,), (2, size), (2,))
    found = {}
    for name, shape in zip(SHARED, shapes, strict=True):
        bound = (FEATURES if name.startswith("in") else size) ** -0.5
        zero = name.startswith("out")  # at first the model is `poisson-groups` with followers
        found[name] = np.zeros(shape) if zero else rng.uniform(-bound, bound, shape)
    found["followers"] = np.full(BINS, -4.0)
    return {name: array.astype(np.float32) for name, array in found.items()}


class _Learner:
    """Weights that are trained on places, each with an `own` of its areas."""

    def __init__(self, trunk: Trunk, places: Sequence[Place], settings: JointSettings) -> None:
        self.now = {name: tensor(array).requires_grad_() for name, array in trunk.items()}
        sizes = {"own_in": len(trunk["in_bias"]), "own_out": 2}
        self.own = [
            {n: torch.zeros(len(p.log_rate), size, requires_grad=True) for n, size in sizes.items()}
            for p in places
        ]
        self.places, self.settings = places, settings
        weights = [self.now[name] for name in SHARED]
        own = [each for of_place in self.own for each in of_place.values()]
        rate = settings.learning_rate
        self.optimizer = torch.optim.AdamW([
            {"params": weights, "weight_decay": settings.weight_decay, "lr": rate},
            {"params": own, "weight_decay": 0.0, "lr": rate},
            {"params": [self.now["followers"]], "weight_decay": 0.0, "lr": settings.follower_rate},
        ])  # fmt: skip

    def step(self) -> None:
        """One step by the mean over the places of their nats per person."""
        self.optimizer.zero_grad()
        for place, own in zip(self.places, self.own, strict=True):
            loss = -_log_probability(self.now, own, place)
            loss = loss + self.settings.own_in_decay * (own["own_in"] ** 2).sum()
            loss = loss + self.settings.own_out_decay * (own["own_out"] ** 2).sum()
            loss = loss / place.persons
            steepest, weight = self.settings.steepest, self.settings.steepness
            loss = loss + weight * _too_steep(self.now, own, place, steepest)
            (loss / len(self.places)).backward()  # type: ignore[no-untyped-call]
        self.optimizer.step()

    def trunk(self) -> Trunk:
        """The weights now."""
        return {name: of.detach().numpy() for name, of in self.now.items()}


@deterministic()
def pretrained(
    places: Sequence[Arrivals], *, seed: int, settings: JointSettings = DEFAULT
) -> Trunk:
    """A network that has learned from the arrivals of several places."""
    rng, start = np.random.default_rng([seed, 1]), untaught(seed, settings)
    learner = _Learner(start, [Place.of(each, each, rng) for each in places], settings)
    for _ in range(settings.pretraining):
        learner.step()
    return learner.trunk()


@deterministic()
def fit(
    arrivals: Arrivals,
    areas: Areas,
    scene: Scene,
    *,
    seed: int,
    trunk: Trunk | None = None,
    settings: JointSettings = DEFAULT,
) -> JointGMM:
    """Train a network on a scene's arrivals; the same seed gives the same one.

    It begins with `trunk`, by default the one that comes for this place (`trunks`).
    """
    begin = read_trunk(scene.id, seed) if trunk is None else trunk
    steps = _best_step(arrivals, scene, begin, seed, settings)
    place = Place.of(arrivals, arrivals, np.random.default_rng([seed, 2]))
    learner = _Learner(begin, [place], settings)
    for _ in range(steps):
        learner.step()
    now = learner.now | learner.own[0] | {"followers": followers_of(learner.now["followers"])}
    learned = {name: of.detach().numpy().astype(np.float32) for name, of in now.items()}
    model = JointGMM(
        areas,
        {name: learned[name] for name in WEIGHTS},
        learned["followers"],
        rate_per_s=place.rate_per_s.astype(np.float32),
        grid_s=arrivals.grid_s,
        steps=steps,
        log_rate=place.log_rate.numpy(),
        log_odds=place.log_odds.numpy(),
    )
    return _calibrated(model, arrivals, seed)


def _calibrated(model: JointGMM, arrivals: Arrivals, seed: int) -> JointGMM:
    """The model with rates for which long samples have the recorded number of people in each area.

    A process that reacts to its own past can have another mean rate than its training data, even if
    each step is predicted well. This is a stochastic approximation (Robbins and Monro 1951): each
    round draws a new sample, and later rounds move less.
    """
    wanted = model.rate_per_s.astype(np.float64)
    horizon_s = max(_LONG_S, _MANY / wanted.sum())
    rng, shift = np.random.default_rng([seed, 5]), np.zeros(len(wanted))
    late = []
    for k in range(_ROUNDS):
        shifted = replace(model, log_rate=(model.log_rate + shift).astype(np.float32))
        counts = shifted.counts(round(horizon_s / model.grid_s), rng)
        found = (counts.sum(axis=0) + 0.5) / horizon_s
        shift = shift + np.clip(np.log(wanted / found), -1, 1) / max(1.0, k / 2)
        shift = np.clip(shift, -_FURTHEST, _FURTHEST)
        late.append(shift)
    shift = np.mean(late[_ROUNDS // 2 :], axis=0)
    return replace(model, log_rate=(model.log_rate + shift).astype(np.float32))


def _best_step(
    arrivals: Arrivals, scene: Scene, trunk: Trunk, seed: int, settings: JointSettings
) -> int:
    """The number of steps with the best likelihood of arrivals that were not trained on."""
    block = max(1, round(scene.protocol.block_s / scene.grid_s))
    pieces = pieces_of(arrivals.windows, block)
    sets = min(settings.sets, len(pieces))
    if sets < 2:
        return 0
    set_of = np.random.default_rng([seed, 3]).permutation(len(pieces)) % sets
    learners, held_out = [], []
    for number in range(sets):
        inside = within(arrivals, joined(pieces[set_of != number]))
        outside = within(arrivals, joined(pieces[set_of == number]))
        rng = np.random.default_rng([seed, 4, number])
        learners.append(_Learner(trunk, [Place.of(inside, inside, rng)], settings))
        held_out.append(Place.of(outside, inside, None))
    found: list[float] = []
    for step in range(settings.steps + 1):
        if step % _EVERY == 0:
            with torch.no_grad():
                found.append(sum(
                    float(_log_probability(learner.now, learner.own[0], of))
                    for learner, of in zip(learners, held_out, strict=True)
                ))  # fmt: skip
            best = int(np.argmax(found)) * _EVERY
            if step - best >= settings.patience:
                break
        for learner in learners:
            learner.step()
    return best
