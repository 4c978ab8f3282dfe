"""The policy that `anticipate.py` trains: what it sees, its network and its guide."""

import logging
import math
import warnings
from dataclasses import astuple, dataclass, fields
from typing import ClassVar, Literal

import numpy as np

from crowdbench import Scene
from crowdbench.policies.memory import Memory
from crowdbench.policies.onnx_runtime import runtime
from crowdbench.simulation import social
from crowdbench.simulation.free_space import REACH_M
from crowdbench.spawn.recorded_plans import VISIT_M

from .packages import needs

with needs("fit", __name__):
    import torch
    from torch import Tensor, nn

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
LOOK_S = 1.5
"""Companions count where they and the person are after this time."""
LOOKS_S = (0.5, 1.0, 1.5)
"""Walls count where the person is after these times."""
KNOTS_M = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.25, 1.5, 1.75, REACH_M)
"""Distances to walls at which their cost is set; it is linear between them, and 0 at the last."""
ABREAST_M = 1.2
"""Companions at this distance or less, down to `TOO_NEAR_M`, cost nothing."""
TOO_NEAR_M = 0.7
"""Companions at this distance or more, up to `ABREAST_M`, cost nothing."""
KERNEL_M = 0.4
"""Width of the kernel that interpolates between probes."""


def sloping(height: float) -> tuple[float, ...]:
    """A cost of walls at `KNOTS_M` that decreases linearly from `height` at a wall to 0."""
    return tuple(round(height * (1 - d / REACH_M), 2) for d in KNOTS_M[:-1])


@dataclass(frozen=True)
class Guide:
    """Settings of the sampling.

    `wall` is learned on the training blocks; `width`, `room` and those in `GRID` of
    `crowdbench.baselines.anticipate` are chosen there. The others are the same everywhere.
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
    room: float = 0.0
    """Weight of the distance in metres by which companions are nearer than `TOO_NEAR_M` after
    `LOOK_S`, their mean."""
    wall: tuple[float, ...] = sloping(16.0)
    """Cost of walls and bounds at the distances `KNOTS_M`, without the last one. It is the mean
    over where the person is after `LOOKS_S`, and decreases to 0 from `NEAR_M` to the target,
    because many stops and goals are at walls."""

    def tensor(self) -> Tensor:
        """All numbers: the `SCALARS`, then the cost of walls."""
        *scalars, wall = astuple(self)
        return torch.tensor([*scalars, *wall], dtype=torch.float32)


SCALARS = len(fields(Guide)) - 1
"""Number of the settings before the cost of walls."""
PLAIN = Guide(jitter=0.0, avoid=0.0, delay=0.0, home=0.0, keep=0.0, resume=1e3, wall=sloping(0.0))
"""No guide."""


class Perception(nn.Module):
    """Features of the observation `social-1`, scaled to about −1 to 1."""

    OWN, OTHER, CODE = 46, 10, 32

    def __init__(self, max_speed_mps: float) -> None:
        super().__init__()
        self.max_speed_mps = max_speed_mps
        self.others = nn.ModuleList([
            nn.Linear(self.OTHER, self.CODE), nn.Linear(self.CODE, self.CODE)
        ])  # fmt: skip
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
        other = _neighbours(seen.T)
        offset_m = other[:, social.OFFSET] * social.RANGE_M
        distance_m = _length(offset_m, 1)[:, None]
        here = other[:, social.PRESENT]
        features = torch.cat([
            offset_m / NEAR_M, scale * other[:, social.APPROACH],
            torch.exp(-distance_m / CLOSE_M), other[:, social.PASS_TIME],
            other[:, social.PASS_DISTANCE],
            (1 - other[:, social.PASS_DISTANCE]) * (1 - other[:, social.PASS_TIME]),
            other[:, social.COMPANION], here,
        ], dim=1)  # fmt: skip
        for layer in self.others:
            assert isinstance(layer, nn.Linear)
            features = nn.functional.silu(layer.weight @ features + layer.bias[:, None])
        code = here * features
        return torch.cat([*own, code.sum(dim=0).T, code.amax(dim=0).T], dim=1)


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
    """Indices (n, A) drawn with weights (K, A) that sum to 1, by normal numbers (n, A)."""
    uniform = 0.5 * (1 + torch.erf(normal / math.sqrt(2)))
    below = torch.cumsum(weight, dim=0) < uniform[:, None]
    return below.sum(dim=1).clamp(max=weight.shape[0] - 1)


def _taken(of: Tensor, at: Tensor) -> Tensor:
    """Vectors (2, n, A) of (2, K, A) at indices (n, A)."""
    return of.gather(1, at.expand(2, -1, -1))


def _length(vectors: Tensor, dim: int = 0) -> Tensor:
    """Lengths of vectors; `dim` is the axis of their two coordinates."""
    x, y = vectors.select(dim, 0), vectors.select(dim, 1)
    return (x * x + y * y).sqrt()


def _neighbours(seen: Tensor) -> Tensor:
    """The neighbours (8, 8, A) in observations (102, A): those of each person, their features."""
    return seen[social.NEIGHBOURS].unflatten(0, (social.NEAREST, social.FEATURES))


def _length_m(seen: Tensor) -> Tensor:
    """Remaining lengths (1, A) of the ways to the targets, metres, in observations (102, A)."""
    return seen[social.ROUTE_LENGTH] * social.ROUTE_RANGE_M


def _at_stop(seen: Tensor) -> Tensor:
    """1 for people who are at the stop they walk to, else 0 (1, A), in observations (102, A)."""
    return seen[social.STOP] * (_length_m(seen) < VISIT_M).float()


class Sampler(nn.Module):
    """Draws actions (A, 2) with observations (A, 102) and normal numbers (A, 37).

    One of 13 candidates is drawn by the costs of the guide: 12 of the network, and `planned`. For
    the costs, people are along the last axis: ONNX Runtime is faster if the last axis is long.
    """

    probes: Tensor
    knots: Tensor
    weights: Tensor

    def __init__(self, walker: Walker, guide: Guide) -> None:
        super().__init__()
        self.walker = walker
        self.register_buffer("probes", torch.tensor(social.PROBE_POINTS, dtype=torch.float32))
        self.register_buffer("knots", torch.tensor(KNOTS_M, dtype=torch.float32))
        self.register_buffer("weights", guide.tensor())

    def forward(self, seen: Tensor, noise: Tensor, weights: Tensor | None = None) -> Tensor:
        """Sampled actions (A, 2). `weights` (18,) replace those of the guide."""
        chosen = self.weights if weights is None else weights
        jitter, width, avoid, apart, delay, home, keep, resume, room = chosen[:SCALARS].unbind()
        mean, std, log_weight = self.walker(seen, jitter * torch.ones_like(seen[:, :1]))
        mean, std = (each.permute(2, 1, 0) for each in (mean, std))  # (2, K, A)
        seen, noise = seen.T, noise.T
        drawn = noise[:-1].unflatten(0, (CANDIDATES, 3))
        at = _chosen(log_weight.exp().T, drawn[:, 0])
        actions = _taken(mean, at) + width * _taken(std, at) * drawn[:, 1:].transpose(0, 1)
        actions = actions / _length(actions).clamp(min=1)
        actions = torch.cat([actions, self.planned(seen)], dim=1)
        cost = avoid * self.passes(seen, actions, apart)
        cost = cost + self.walls(seen, actions, chosen[SCALARS:])
        cost = cost + delay * self.delays(seen, actions) + home * self.misses(seen, actions)
        cost = cost + self.together(seen, actions, keep, room)
        cost = cost + torch.cat([torch.zeros_like(drawn[:, 0]), resume * torch.ones_like(seen[:1])])
        return _taken(actions, _chosen(torch.softmax(-cost, dim=0), noise[-1:]))[:, 0].T

    @property
    def max_speed_mps(self) -> float:
        """The unit of velocities."""
        return self.walker.perception.max_speed_mps

    def planned(self, seen: Tensor) -> Tensor:
        """Velocities (2, 1, A) along the way at the preferred speed; none at a stop."""
        speed = seen[social.PREFERRED_SPEED] * (1 - _at_stop(seen))
        return (speed * seen[social.ROUTE_DIRECTION])[:, None]

    def passes(self, seen: Tensor, actions: Tensor, apart: Tensor) -> Tensor:
        """Sum of the nearness of strangers who are passed (n, A), of candidates (2, n, A)."""
        other = _neighbours(seen)
        offset = (other[:, social.OFFSET] * social.RANGE_M)[:, :, None]
        theirs = (other[:, social.APPROACH] + seen[social.VELOCITY])[:, :, None]
        approach = self.max_speed_mps * (theirs - actions)  # (8, 2, n, A)
        x, y, u, v = offset[:, 0], offset[:, 1], approach[:, 0], approach[:, 1]
        time_s = -(x * u + y * v) / (u * u + v * v).clamp(min=1e-6)
        time_s = time_s.clamp(min=0.0, max=HORIZON_S)
        x, y = x + time_s * u, y + time_s * v
        counted = other[:, social.PRESENT] * (1 - other[:, social.COMPANION])  # (8, 1, A)
        return (counted * (1 - (x * x + y * y).sqrt() / apart).clamp(min=0)).sum(dim=0)

    def together(self, seen: Tensor, actions: Tensor, keep: Tensor, room: Tensor) -> Tensor:
        """Mean cost (n, A) of companions who are too far or too near."""
        other = _neighbours(seen)
        companion = other[:, social.COMPANION]  # (8, 1, A)
        theirs = (other[:, social.APPROACH] + seen[social.VELOCITY])[:, :, None] - actions
        offset = (other[:, social.OFFSET] * social.RANGE_M)[:, :, None]
        distance_m = _length(offset + LOOK_S * self.max_speed_mps * theirs, 1)  # (8, n, A)
        too_far = (distance_m - ABREAST_M).clamp(min=0)
        too_near = (TOO_NEAR_M - distance_m).clamp(min=0)
        number = companion.sum(dim=0).clamp(min=1)
        return (companion * (keep * too_far + room * too_near)).sum(dim=0) / number

    def walls(self, seen: Tensor, actions: Tensor, wall: Tensor) -> Tensor:
        """Cost of walls (n, A), interpolated between the probes. It decreases near the target.

        `wall` (9,) contains its values at `KNOTS_M`.
        """
        height = torch.cat([wall, torch.zeros_like(wall[:1])])
        gap = self.knots.diff()
        rise = (REACH_M * seen[social.PROBES, None] - self.knots[:-1, None]).clamp(min=0)
        rise = torch.minimum(rise, gap[:, None])  # (25, 9, A)
        cost = height[0] + ((height.diff() / gap)[:, None] * rise).sum(dim=1)
        after = torch.cat([look * self.max_speed_mps * actions for look in LOOKS_S], dim=1)
        after, probes = after / KERNEL_M, self.probes / KERNEL_M
        along = (probes @ after.flatten(1)).unflatten(1, after.shape[1:])  # (25, 3 n, A)
        half = 0.5 * (probes * probes).sum(dim=1)[:, None, None]
        kernel = torch.exp(along - half - 0.5 * (after * after).sum(dim=0)) + 1e-6
        there = (kernel * cost[:, None]).sum(dim=0) / kernel.sum(dim=0)
        near = (_length_m(seen) / NEAR_M).clamp(max=1)
        return near * there.unflatten(0, (len(LOOKS_S), actions.shape[1])).mean(dim=0)

    def delays(self, seen: Tensor, actions: Tensor) -> Tensor:
        """Lack of speed (n, A) along the way, relative to the preferred speed, from 0 to 1."""
        x, y = seen[social.ROUTE_DIRECTION]
        along = x * actions[0] + y * actions[1]
        slower = 1 - along / seen[social.PREFERRED_SPEED].clamp(min=0.1 / self.max_speed_mps)
        return slower.clamp(0, 1) * (1 - _at_stop(seen))

    def misses(self, seen: Tensor, actions: Tensor) -> Tensor:
        """Distance (n, A) in metres at which a near target is passed straight on."""
        length_m = _length_m(seen)
        x, y = length_m * seen[social.ROUTE_DIRECTION]
        u, v = self.max_speed_mps * actions
        ahead = ((x * u + y * v) / (u * u + v * v).clamp(min=1e-2)).clamp(min=0)
        missed_m = _length(torch.stack([x - ahead * u, y - ahead * v]))
        return missed_m * (length_m < NEAR_M).float()


class InProcess:
    """A sampler as a policy whose guide can be changed, for training."""

    name = "anticipate"
    sees: ClassVar[Literal["observation"]] = "observation"
    many_worlds: ClassVar[bool] = True
    observation = OBSERVATION
    noise = NOISE

    def __init__(self, sampler: Sampler, interval: int) -> None:
        onnxruntime = runtime()
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
