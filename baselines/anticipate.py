"""Walkers that anticipate: they see where others are going, and pass them at a distance.

    python -m baselines.anticipate --scene eth-v0

writes `results/anticipate-eth-v0/full.onnx`, which `crowdbench evaluate eth-v0 --policy
results/anticipate-eth-v0/full.onnx` rolls out. The file contains all of the following.

    python -m baselines.anticipate --scenes eth-v0 hotel-v0 zara1-v0 --leave-out zara1-v0

trains one network on several scenes, and validates it on another one.

**Perception.** The observation `social-1`, in a person's own frame: its velocity, the way to its
target, its preferred speed and stop, what it remembers (age, distance walked, time stood), the free
space around it, and the eight nearest people with their velocities. `Perception` scales it. All
neighbours pass through the same small network; their sum and maximum are seen (Qi et al. 2017,
PointNet, CVPR).

**Network.** `Walker` predicts a mixture of Gaussians around the present velocity (Bishop 1994,
mixture density networks, eqs. 22-27), cloned from recorded people by maximum likelihood.

**Smoothing.** The positions of a recording contain the noise of annotations. A network that is
cloned on them trembles when it is sampled. Therefore it is cloned on smoothed paths
(`--smoothing-s`).

**Jitter.** Recorded people hardly ever leave the speed and heading that they prefer. A clone does
not learn how to return to them, and drifts. In training, the network therefore sees the person's
own velocity with random noise, and how strong it is (up to `--jitter-mps`), and learns to walk the
recorded one (as in conditioning augmentation; Ho et al. 2022, Cascaded diffusion models, JMLR 23).
In a rollout there is no noise. The strength that the network is then told is a setting: the greater
it is, the faster people return to velocities that are usual in the recording.

**Guide.** In a rollout, twelve velocities are drawn from the mixture. A thirteenth one is what the
plan asks for: to walk along the way at the preferred speed, or to stand at a stop. One of them is
drawn with weights exp(−cost), where the cost anticipates close passes of strangers, companions who
are left, walls, delay, and a near target that would be missed. There are too few near collisions in
recordings for a network to learn this from them. The thirteenth velocity costs more (`resume`). It
is for people whom a wall or a crowd has stopped: a clone who stands goes on standing. Most weights,
the width of the mixture and the strength of the jitter are chosen on the training blocks, by the
walk score that `validate` measures there.

**Closed loop.** Optionally (`--rounds`) the policy draws three candidates in each decision of a
recorded person, who walks the one nearest to its recorded next position; the states near targets
that it comes to are labelled with the way to the recorded end, and are learned too (after Zhang et
al. 2025, CAT-K, CVPR, arXiv:2412.05334). By default there are no rounds: on ETH more people arrived
with them, but they walked less steadily.
"""

import argparse
import logging
import math
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from baselines.packages import needs
from crowdbench import Demonstrations, Scene, demonstrations, registry
from crowdbench.errors import CrowdbenchError
from crowdbench.evaluation.validation import Validation, Validator
from crowdbench.policies import OnnxPolicy
from crowdbench.policies.memory import Memory
from crowdbench.simulation import social
from crowdbench.simulation.free_space import REACH_M
from crowdbench.spawn.plans import VISIT_M

with needs("fit", __name__):
    import torch
    from torch import Tensor, nn

    from baselines.command import Command, add_settings, check_numbers, new_parser, use_one_thread
    from crowdbench.policies.network import check_onnx

OBSERVATION = "social-1"
COMPONENTS = 10
CANDIDATES = 12
NOISE = 3 * CANDIDATES + 1
"""Normal numbers per decision: of each candidate, one chooses the component and two the deviation;
the last one chooses the candidate."""
WALKING_MPS = 1.3
"""Speed that velocities are divided by."""
NARROWEST_MPS = 0.01
"""Lower limit of standard deviations. With a smaller one, people who keep their velocity exactly,
as between two annotations, would dominate the likelihood."""
NEAR_M, CLOSE_M = 3.0, 1.0
"""Length scales of near targets and of near people."""
JITTER_MPS = 0.1
"""Scale of jitter."""
SOON_S, LATE_S = 5.0, 30.0
"""Time scales of waits that end soon, and of being early or late."""
HORIZON_S = 8.0
"""The guide anticipates this time."""
LOOK_S, WALLS_M = 1.5, 1.5
"""Walls count where the person is after this time; at this distance or more they cost nothing."""
ABREAST_M = 1.2
"""Companions at this distance or less cost nothing."""
KERNEL_M = 0.4
"""Width of the kernel that interpolates between probes."""


@dataclass(frozen=True)
class Settings:
    """Settings of the training; those in `SETTABLE` are described there."""

    hidden: int = 128
    steps: int = 4_000
    batch_size: int = 256
    passes: int = 8
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    smoothing_s: float = 2.4
    jitter_mps: float = 0.2
    rounds: int = 0
    recovery_s: float = 1.5
    candidates: int = 3
    people: int = 2_000
    held_out: float = 0.1
    """Share of the persons held out, whose likelihood is printed."""
    seed: int = 0


SETTABLE = {
    "hidden": "width of the two hidden layers",
    "steps": "number of steps of the training before the closed loop",
    "batch_size": "number of decisions in a batch, at least",
    "passes": "how often all decisions are learned from, at least; batches are as large as needed",
    "learning_rate": "maximum learning rate of AdamW",
    "weight_decay": "weight decay of AdamW",
    "smoothing_s": "window in which recorded paths are smoothed, seconds; 0: none",
    "jitter_mps": "maximum standard deviation of the noise on a person's own velocity in training, "
    "m/s; 0: none",
    "recovery_s": "time constant with which labels in closed loop return to the recorded paths",
    "rounds": "rounds of training in closed loop, each of half as many steps as before them",
    "candidates": "number of candidates per decision in closed loop",
    "people": "number of people, at least, who are simulated for each choice of the guide; the "
    "recording is walked as often as needed",
}
"""Settings with a command line option, and the help texts of the options."""


@dataclass(frozen=True)
class Guide:
    """Settings of the sampling.

    Those in `GRID` are chosen on the training blocks, the others are the same everywhere.
    """

    jitter: float = 0.1
    """Standard deviation of the jitter that the network is told of, m/s."""
    width: float = 1.0
    """Factor of the standard deviations of the mixture."""
    avoid: float = 16.0
    """Weight of close passes: the sum of max(0, 1 − d / `apart`) over strangers, where d is the
    smallest distance within `HORIZON_S`."""
    apart: float = 1.0
    """Passing strangers at this distance in metres or more costs nothing."""
    wall: float = 6.0
    """Weight of walls: max(0, 1 − d / `WALLS_M`), where d is the distance to walls and bounds from
    where the person is after `LOOK_S`. It decreases to 0 from `NEAR_M` to the target, because many
    stops and goals are at walls."""
    delay: float = 1.0
    """Weight of delay: max(0, 1 − v / v*), where v is the speed along the way and v* the preferred
    speed; at most 1, and 0 at a stop."""
    home: float = 5.0
    """Weight of the distance in metres at which a target nearer than `NEAR_M` is passed."""
    keep: float = 4.0
    """Weight of the distance in metres beyond `ABREAST_M` at which companions are after `LOOK_S`,
    their mean."""
    resume: float = 4.0
    """Cost of the velocity that the plan asks for, besides all other costs."""

    def tensor(self) -> Tensor:
        """The nine numbers."""
        return torch.tensor(astuple(self), dtype=torch.float32)


PLAIN = Guide(
    jitter=0.0, avoid=0.0, wall=0.0, delay=0.0, home=0.0, keep=0.0, resume=1e3
)  # fmt: skip
"""No guide."""
GRID: Mapping[str, tuple[float, ...]] = {
    "avoid": (8.0, 16.0, 32.0),
    "wall": (2.0, 6.0, 12.0, 24.0),
    "width": (1.0, 0.85),
    "delay": (0.0, 1.0, 2.0),
    "jitter": (0.1, 0.2),
    "resume": (2.0, 4.0),
}
"""Values that are tried, one setting after the other, in this order, twice: how close people may
pass walls depends on how straight they walk."""
TRIED_ON_SEVERAL = ("avoid", "wall")
"""The settings that are chosen if there are several scenes, on which each choice takes longer."""
BOTH = 0.1
"""Weight of the mean of motion and interaction in the choice, beside *walk*."""
DECISION_S = 0.8
"""Time between decisions of a policy for several scenes."""


class Perception(nn.Module):
    """Features of the observation `social-1`, scaled to about −1 to 1."""

    OWN, OTHER, CODE = 46, 10, 32

    def __init__(self, max_speed_mps: float) -> None:
        super().__init__()
        self.max_speed_mps = max_speed_mps
        self.others = nn.Sequential(
            nn.Linear(self.OTHER, self.CODE), nn.SiLU(), nn.Linear(self.CODE, self.CODE), nn.SiLU()
        )
        self.size = self.OWN + 2 * self.CODE

    def forward(self, seen: Tensor, jitter: Tensor) -> Tensor:
        """Features (A, size) of observations (A, 102) with jitter (A, 1), m/s."""
        scale = self.max_speed_mps / WALKING_MPS
        velocity, speed = scale * seen[:, social.VELOCITY], scale * seen[:, social.PREFERRED_SPEED]
        way, length = seen[:, social.ROUTE_DIRECTION], seen[:, social.ROUTE_LENGTH]
        length_m = length * social.ROUTE_RANGE_M
        near = (length_m / NEAR_M).clamp(max=1)
        stop, wait = seen[:, social.STOP], seen[:, social.WAIT_LEFT]
        age, walked = seen[:, social.AGE], seen[:, social.WALKED]
        # Whether somebody is early or late: the time that the whole way takes, less the age.
        whole_s = (walked * social.WALKED_M + length_m) / (WALKING_MPS * speed.clamp(min=0.1))
        late = ((whole_s - age * social.AGE_S) / LATE_S).clamp(-1, 1)
        own = [
            velocity, way * speed - velocity, way, near * way, near, length, speed, stop,
            stop * (1 - near), wait, (wait * social.WAIT_S / SOON_S).clamp(max=1), age,
            walked, seen[:, social.STOOD], late, velocity.norm(dim=1, keepdim=True),
            1 - seen[:, social.PROBES], jitter / JITTER_MPS,
        ]  # fmt: skip
        other = social.neighbours_of(seen)
        offset_m = other[..., social.OFFSET] * social.RANGE_M
        distance_m = offset_m.norm(dim=-1, keepdim=True)
        here = other[..., social.PRESENT]
        code = here * self.others(torch.cat([
            offset_m / NEAR_M, scale * other[..., social.APPROACH],
            torch.exp(-distance_m / CLOSE_M), other[..., social.PASS_TIME],
            other[..., social.PASS_DISTANCE],
            (1 - other[..., social.PASS_DISTANCE]) * (1 - other[..., social.PASS_TIME]),
            other[..., social.COMPANION], here,
        ], dim=-1))  # fmt: skip
        return torch.cat([*own, code.sum(dim=1), code.amax(dim=1)], dim=1)


class Walker(nn.Module):
    """Mixture of Gaussians of the next velocity, in units of the maximum speed."""

    def __init__(self, max_speed_mps: float, hidden: int) -> None:
        super().__init__()
        self.perception = Perception(max_speed_mps)
        self.layers = nn.Sequential(
            nn.Linear(self.perception.size, hidden), nn.SiLU(), nn.Linear(hidden, hidden),
            nn.SiLU(), nn.Linear(hidden, 5 * COMPONENTS),
        )  # fmt: skip
        self.unit = WALKING_MPS / max_speed_mps
        self.narrowest = math.log(NARROWEST_MPS / WALKING_MPS)

    def forward(self, seen: Tensor, jitter: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Means, standard deviations (A, K, 2) and log weights (A, K) of the components."""
        p = self.layers(self.perception(seen, jitter)).unflatten(1, (COMPONENTS, 5))
        mean = seen[:, None, social.VELOCITY] + self.unit * p[..., :2]
        std = self.unit * (p[..., 2:4] - 2.0).clamp(self.narrowest, 1.0).exp()
        return mean, std, torch.log_softmax(p[..., 4], dim=1)

    def log_prob(self, seen: Tensor, jitter: Tensor, did: Tensor) -> Tensor:
        """Log-densities (A,) of actions (A, 2), in units of the walking speed."""
        mean, std, log_weight = self(seen, jitter)
        z = (did[:, None] - mean) / std
        each = -(0.5 * z * z + (std / self.unit).log()).sum(dim=2) - math.log(2 * math.pi)
        return torch.logsumexp(each + log_weight, dim=1)


def _chosen(weight: Tensor, normal: Tensor) -> Tensor:
    """Indices (A, n) drawn with weights (A, K) that sum to 1, by normal numbers (A, n)."""
    uniform = 0.5 * (1 + torch.erf(normal / math.sqrt(2)))
    below = torch.cumsum(weight, dim=1)[:, None] < uniform[..., None]
    return below.sum(dim=2).clamp(max=weight.shape[1] - 1)


def _taken(of: Tensor, at: Tensor) -> Tensor:
    """Vectors (A, n, 2) of (A, K, 2) at indices (A, n)."""
    return of.gather(1, at[..., None].expand(-1, -1, 2))


def _length_m(seen: Tensor) -> Tensor:
    """Remaining lengths (A, 1) of the ways to the targets, metres."""
    return seen[:, social.ROUTE_LENGTH] * social.ROUTE_RANGE_M


def _at_stop(seen: Tensor) -> Tensor:
    """1 for people who are at the stop they walk to, else 0 (A, 1)."""
    return seen[:, social.STOP] * (_length_m(seen) < VISIT_M).float()


class Sampler(nn.Module):
    """Draws actions (A, 2) with observations (A, 102) and normal numbers (A, 37).

    One of 13 candidates is drawn by the costs of the guide: 12 of the network, and `planned`.
    """

    probes: Tensor
    weights: Tensor

    def __init__(self, walker: Walker, guide: Guide) -> None:
        super().__init__()
        self.walker = walker
        self.register_buffer("probes", torch.tensor(social.PROBE_POINTS, dtype=torch.float32))
        self.register_buffer("weights", guide.tensor())

    def forward(self, seen: Tensor, noise: Tensor, weights: Tensor | None = None) -> Tensor:
        """Sampled actions (A, 2). `weights` (9,) replace those of the guide."""
        chosen = self.weights if weights is None else weights
        jitter, width, avoid, apart, wall, delay, home, keep, resume = chosen.unbind()
        one = torch.ones_like(seen[:, :1])
        mean, std, log_weight = self.walker(seen, jitter * one)
        drawn = noise[:, :-1].unflatten(1, (CANDIDATES, 3))
        at = _chosen(log_weight.exp(), drawn[..., 0])
        actions = _taken(mean, at) + width * _taken(std, at) * drawn[..., 1:]
        actions = actions / actions.norm(dim=2, keepdim=True).clamp(min=1)
        actions = torch.cat([actions, self.planned(seen)], dim=1)
        cost = avoid * self.passes(seen, actions, apart) + wall * self.walls(seen, actions)
        cost = cost + delay * self.delays(seen, actions) + home * self.misses(seen, actions)
        cost = cost + keep * self.partings(seen, actions)
        cost = cost + torch.cat([torch.zeros_like(drawn[..., 0]), resume * one], dim=1)
        return _taken(actions, _chosen(torch.softmax(-cost, dim=1), noise[:, -1:]))[:, 0]

    @property
    def max_speed_mps(self) -> float:
        """The unit of velocities."""
        return self.walker.perception.max_speed_mps

    def planned(self, seen: Tensor) -> Tensor:
        """Velocities (A, 1, 2) along the way at the preferred speed; none at a stop."""
        speed = seen[:, social.PREFERRED_SPEED] * (1 - _at_stop(seen))
        return (speed * seen[:, social.ROUTE_DIRECTION])[:, None]

    def passes(self, seen: Tensor, actions: Tensor, apart: Tensor) -> Tensor:
        """Sum of the nearness of strangers who are passed (A, n), of candidates (A, n, 2).

        Squares are expanded, so that the vectors to 8 people for 12 candidates are never written.
        """
        other = social.neighbours_of(seen)  # (A, 8, 8)
        here, companion = other[..., social.PRESENT], other[..., social.COMPANION]
        offset = other[..., social.OFFSET] * social.RANGE_M
        theirs = other[..., social.APPROACH] + seen[:, None, social.VELOCITY]
        theirs, own = self.max_speed_mps * theirs, self.max_speed_mps * actions
        along = own @ torch.cat([offset, theirs], dim=1).transpose(1, 2)  # (A, n, 16)
        squared = torch.cat([offset * theirs, offset * offset, theirs * theirs], dim=1).sum(dim=2)[
            :, None
        ]  # (A, 1, 24)
        strangers = offset.shape[1]
        with_offset, with_theirs = along.split(strangers, dim=2)
        approaching, far, fast = squared.split(strangers, dim=2)
        closing = with_offset - approaching  # −offset · approach
        speed = fast - 2 * with_theirs + own.square().sum(dim=2, keepdim=True)
        time_s = (closing / speed.clamp(min=1e-6)).clamp(min=0).clamp(max=HORIZON_S)
        passed_m = (far + time_s * (time_s * speed - 2 * closing)).clamp(min=0).sqrt()
        counted = (here * (1 - companion)).transpose(1, 2)
        return (counted * (1 - passed_m / apart).clamp(min=0)).sum(dim=2)

    def partings(self, seen: Tensor, actions: Tensor) -> Tensor:
        """Mean distance (A, n) in metres by which companions are farther than `ABREAST_M`."""
        other = social.neighbours_of(seen)
        companion = other[..., social.COMPANION]  # (A, 8, 1)
        theirs = other[..., social.APPROACH] + seen[:, None, social.VELOCITY]
        after = other[..., social.OFFSET] * social.RANGE_M + LOOK_S * self.max_speed_mps * theirs
        own = LOOK_S * self.max_speed_mps * actions
        squared = own.square().sum(dim=2, keepdim=True) - 2 * own @ after.transpose(1, 2)
        squared = squared + after.square().sum(dim=2)[:, None]  # (A, n, 8)
        beyond = (squared.clamp(min=0).sqrt() - ABREAST_M).clamp(min=0)
        number = companion.sum(dim=1).clamp(min=1)  # (A, 1)
        return (beyond @ companion)[..., 0] / number

    def walls(self, seen: Tensor, actions: Tensor) -> Tensor:
        """Nearness of walls (A, n), from 0 to 1, interpolated between the probes.

        It counts less near the target.
        """
        after = LOOK_S * self.max_speed_mps * actions
        off = after.square().sum(dim=2, keepdim=True) - 2 * after @ self.probes.T
        kernel = torch.exp((off + self.probes.square().sum(dim=1)) * (-0.5 / KERNEL_M**2)) + 1e-6
        free = seen[:, social.PROBES, None]
        weighed = kernel @ torch.cat([free, torch.ones_like(free)], dim=2)  # (A, n, 2)
        free_m = weighed[..., 0] / weighed[..., 1] * REACH_M
        near = (_length_m(seen) / NEAR_M).clamp(max=1)
        return near * (1 - free_m / WALLS_M).clamp(min=0)

    def delays(self, seen: Tensor, actions: Tensor) -> Tensor:
        """Lack of speed (A, n) along the way, relative to the preferred speed, from 0 to 1."""
        along = (seen[:, None, social.ROUTE_DIRECTION] * actions).sum(dim=2)
        slower = 1 - along / seen[:, social.PREFERRED_SPEED].clamp(min=0.1 / self.max_speed_mps)
        return slower.clamp(0, 1) * (1 - _at_stop(seen))

    def misses(self, seen: Tensor, actions: Tensor) -> Tensor:
        """Distance (A, n) in metres at which a near target is passed straight on."""
        length_m = _length_m(seen)
        target = (length_m * seen[:, social.ROUTE_DIRECTION])[:, None]
        velocity = self.max_speed_mps * actions
        ahead = (target * velocity).sum(dim=2) / velocity.square().sum(dim=2).clamp(min=1e-2)
        missed_m = (target - ahead.clamp(min=0)[..., None] * velocity).norm(dim=2)
        return missed_m * (length_m < NEAR_M).float()


class InProcess:
    """A sampler as a policy whose guide can be changed, for training."""

    name = "anticipate"
    sees: ClassVar[Literal["observation"]] = "observation"
    many_worlds: ClassVar[bool] = True
    observation = OBSERVATION
    noise = NOISE

    def __init__(self, sampler: Sampler, interval: int) -> None:
        import onnxruntime

        self.interval, self.weights = interval, sampler.weights.numpy()
        fed = (torch.rand(7, social.SIZE), torch.randn(7, NOISE), sampler.weights)
        persons = torch.export.Dim("A", min=1)
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns of unused packages
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch warns of its own deprecations
            program = torch.onnx.export(
                sampler.eval(), fed, dynamo=True, verbose=False,
                input_names=["seen", "noise", "weights"],
                dynamic_shapes=({0: persons}, {0: persons}, None),
            )  # fmt: skip
        assert program is not None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(
            program.model_proto.SerializeToString(), options, providers=["CPUExecutionProvider"]
        )

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        """Begin an episode; the noise is drawn by the rollout."""

    def act(self, seen: np.ndarray, memory: Memory) -> np.ndarray:
        """Actions (A, 2) of observations (A, 102)."""
        fed = {"seen": seen, "noise": memory.noise, "weights": self.weights}
        acted: np.ndarray = self.session.run(None, fed)[0]
        return acted


def mirrored(seen: np.ndarray) -> np.ndarray:
    """Observations (S, 102) of the same people in a world that is mirrored at their headings."""
    left = [part.stop - 1 for part in (social.VELOCITY, social.HEADING, social.ROUTE_DIRECTION)]
    for part in (social.OFFSET, social.APPROACH):
        first = social.NEIGHBOURS.start + part.stop - 1
        left += range(first, social.NEIGHBOURS.stop, social.FEATURES)
    found = seen.copy()
    found[:, left] *= -1
    turned = np.linalg.norm(social.PROBE_POINTS[:, None] - social.PROBE_POINTS * [1, -1], axis=2)
    found[:, social.PROBES] = seen[:, social.PROBES.start + turned.argmin(axis=1)]
    return found


@dataclass(frozen=True)
class Samples:
    """Observations (S, 102) and actions (S, 2) to learn from."""

    seen: Tensor
    did: Tensor

    @classmethod
    def of(cls, shown: Demonstrations, from_target_m: float = math.inf) -> "Samples":
        """Pairs of demonstrations within a distance of the target, and their mirror images."""
        seen, did = shown.pairs()
        near = seen[:, social.ROUTE_LENGTH.start] * social.ROUTE_RANGE_M <= from_target_m
        seen, did = seen[near], did[near]
        both = (seen, mirrored(seen)), (did, did * np.array([1, -1], np.float32))
        return cls(*(torch.from_numpy(np.concatenate(pair)) for pair in both))

    def __add__(self, other: "Samples") -> "Samples":
        return Samples(torch.cat([self.seen, other.seen]), torch.cat([self.did, other.did]))

    def __len__(self) -> int:
        return len(self.seen)

    def batches(self, count: int, size: int) -> Iterator[tuple[Tensor, Tensor]]:
        """`count` batches; all samples are used before any is used again."""
        rows = torch.cat([
            torch.randperm(len(self)) for _ in range(1 + count * size // len(self))
        ])  # fmt: skip
        for some in rows[: count * size].split(size):
            yield self.seen[some], self.did[some]

    def shared(self, number: int) -> "Samples":
        """As many of these samples as asked, each about equally often."""
        rows = torch.cat([torch.randperm(len(self)) for _ in range(1 + number // len(self))])
        return Samples(self.seen[rows[:number]], self.did[rows[:number]])


def fit(
    walker: Walker, samples: Samples, steps: int, rate: float, settings: Settings, command: Command
) -> None:
    """Train a network by maximum likelihood, with a one-cycle learning rate."""
    size = max(settings.batch_size, math.ceil(settings.passes * len(samples) / settings.steps))
    optimizer = torch.optim.AdamW(
        walker.parameters(), lr=rate, weight_decay=settings.weight_decay, fused=True
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, max_lr=rate, total_steps=steps)
    with command.progress("cloning", steps, "steps", "decisions") as progress:
        for k, (seen, did) in enumerate(samples.batches(steps, size), 1):
            jitter = settings.jitter_mps * torch.rand(len(seen), 1)
            noise = jitter * torch.randn(len(seen), 2)
            seen[:, social.VELOCITY] += noise / walker.perception.max_speed_mps
            loss = -walker.log_prob(seen, jitter, did).mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(walker.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            progress(k, len(seen), {"nats per decision": -float(loss.detach())})


def decision_frames(*scenes: Scene) -> int:
    """Number of frames between two decisions: one step of the annotation grid.

    On several scenes, as many as make about `DECISION_S`.
    """
    every_s = scenes[0].grid_s if len(scenes) == 1 else DECISION_S
    return max(1, round(every_s / scenes[0].dt_s))


def pooled(each: Sequence[Samples]) -> Samples:
    """Samples of several scenes, as many as all have together.

    The share of a scene is proportional to the square root of its number of samples, so that a
    large recording does not outweigh all others.
    """
    roots = [math.sqrt(len(samples)) for samples in each]
    total = sum(map(len, each))
    lots = [
        samples.shared(round(total * root / sum(roots)))
        for samples, root in zip(each, roots, strict=True)
    ]
    return Samples(torch.cat([lot.seen for lot in lots]), torch.cat([lot.did for lot in lots]))


def train(
    command: Command, split: str, settings: Settings, interval: int, walker: Walker
) -> Walker:
    """Clone a network, then improve it in closed loop; returns it."""
    where: dict[str, Any] = {
        "split": split,
        "observation": OBSERVATION,
        "interval": interval,
        "smoothing_s": settings.smoothing_s,
    }
    people = [
        demonstrations(scene, **where).split(settings.held_out, settings.seed)
        for scene in command.scenes
    ]
    tested = pooled([Samples.of(held_out) for _, held_out in people])
    each = [Samples.of(shown) for shown, _ in people]
    samples = pooled(each)
    fit(walker, samples, settings.steps, settings.learning_rate, settings, command)
    for k in range(1 + settings.rounds):
        with torch.no_grad():
            none = torch.zeros(len(tested.seen), 1)
            nats = float(walker.log_prob(tested.seen, none, tested.did).mean())
        print(f"{split}: round {k}, held out {nats:.3f} nats per decision", flush=True)
        if k == settings.rounds:
            break
        plain = InProcess(Sampler(walker, PLAIN), interval)
        for j, scene in enumerate(command.scenes):
            walked = demonstrations(
                scene,
                policy=plain,
                candidates=settings.candidates,
                recovery_s=settings.recovery_s,
                seed=settings.seed + k,
                **where,
            )
            trained_on = np.isin(walked.person, people[j][0].person)
            each[j] += Samples.of(walked.take(np.flatnonzero(trained_on)), NEAR_M)
        samples = pooled(each)
        steps = max(1, settings.steps // 2)
        fit(walker, samples, steps, settings.learning_rate / 2, settings, command)
    return walker


def guided(
    sampler: Sampler, scenes: Sequence[Scene], split: str, interval: int, settings: Settings
) -> Guide:
    """Choose the guide by the walk score on the training blocks, one setting after the other.

    Of several scenes, the mean score counts. Since *walk* is the lesser of two families, it is
    blind to the other one; therefore `BOTH` of the mean of the families is added.
    """
    guide = replace(Guide(), jitter=min(Guide.jitter, settings.jitter_mps))
    tried: dict[Guide, float] = {}
    policy = InProcess(sampler, interval)
    validators = [Validator(scene, split) for scene in scenes]
    people = settings.people / len(scenes)
    rollouts = [math.ceil(people / max(1, len(registry.recording_of(scene)))) for scene in scenes]
    settable = [s for s in GRID.items() if len(scenes) == 1 or s[0] in TRIED_ON_SEVERAL]
    for name, values in 2 * settable:
        for one in (replace(guide, **{name: value}) for value in values):
            if one in tried or one.jitter > settings.jitter_mps:  # not trained with as much
                continue
            policy.weights = one.tensor().numpy()
            found = [
                v.validate(policy, rollouts=n) for v, n in zip(validators, rollouts, strict=True)
            ]
            walk = float(np.mean([each.walk for each in found]))
            families = [float(np.mean(list(each.families.values()))) for each in found]
            tried[one] = walk + BOTH * float(np.mean(families))
            print(f"{split}: {one}: walk {walk:.3f} ({_parts(scenes, found)})", flush=True)
        guide = max(tried, key=lambda g: tried[g])
    return guide


def _parts(scenes: Sequence[Scene], found: Sequence[Validation]) -> str:
    """What a score is made of: the families of one scene, or the scores of several scenes."""
    if len(scenes) > 1:
        return ", ".join(f"{s.id} {v.walk:.2f}" for s, v in zip(scenes, found, strict=True))
    return ", ".join(f"{family} {x:.2f}" for family, x in found[0].families.items())


def learn(command: Command, split: str, settings: Settings) -> Path:
    """Train a network, choose its guide, and write both; return the file."""
    use_one_thread()
    interval = decision_frames(*command.scenes)
    torch.manual_seed(settings.seed)
    walker = Walker(command.scene.motion.max_speed_mps, settings.hidden)
    train(command, split, settings, interval, walker)
    sampler = Sampler(walker, Guide())
    guide = guided(sampler, command.scenes, split, interval, settings)
    print(f"{split}: chosen: {guide}", flush=True)
    sampler.weights.copy_(guide.tensor())
    return command.write(split, sampler, observation=OBSERVATION, noise=NOISE, interval=interval)


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = new_parser("anticipate", __doc__, several=True)
    add_settings(parser, Settings(), SETTABLE)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Train and write a policy for each split; return the exit code."""
    asked = command_line().parse_args(arguments)
    settings = Settings(**{name: getattr(asked, name) for name in (*SETTABLE, "seed")})
    try:
        zero = (
            "passes", "rounds", "smoothing_s", "jitter_mps", "recovery_s", "weight_decay", "seed"
        )  # fmt: skip
        check_numbers(settings, or_zero=zero)
        check_onnx()  # needed for the choice of the guide, after the training
        command = Command.of_asked("anticipate", asked, arguments)
        for split in asked.splits:
            path = learn(command, split, settings)
            print(f"{path}: {command.walk(path, 'ntpp-gmm')}", flush=True)
            if asked.leave_out is not None:
                other = Validator(asked.leave_out).validate(OnnxPolicy(path))
                print(f"{path}: walk {other.walk:.3f} on {asked.leave_out}", flush=True)
    except CrowdbenchError as error:
        print(f"baselines.anticipate: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
