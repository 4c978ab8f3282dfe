"""Walkers that anticipate: they see where others are going, and pass them at a distance.

    python -m baselines.anticipate --scene eth-v0

writes `results/anticipate-eth-v0/full.onnx`, which `crowdbench evaluate eth-v0 --policy
results/anticipate-eth-v0/full.onnx` rolls out. The file contains all of the following.

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
own velocity with random noise (`--jitter-mps`), and learns to walk the recorded one.

**Guide.** In a rollout, twelve velocities are drawn from the mixture. One of them is drawn with
weights exp(−cost), where the cost anticipates close passes of strangers, overlaps, walls, and a
near target that would be missed. There are too few near collisions in recordings for a network to
learn this from them. The weights of the costs and the width of the mixture are chosen on the
training blocks, by the walk score that `validate` measures there.

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
from collections.abc import Iterator, Mapping
from dataclasses import astuple, dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from baselines.packages import needs
from crowdbench import Demonstrations, Scene, demonstrations
from crowdbench.errors import CrowdbenchError
from crowdbench.evaluation.validation import validate
from crowdbench.simulation import social
from crowdbench.simulation.free_space import REACH_M

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
SOON_S, LATE_S = 5.0, 30.0
"""Time scales of waits that end soon, and of being early or late."""
HORIZON_S = 3.0
"""The guide anticipates this time."""
STRANGERS_M = 1.5
"""Passing strangers at this distance or more costs nothing."""
LOOK_S, WALLS_M = 1.5, 1.5
"""Walls count where the person is after this time; at this distance or more they cost nothing."""
KERNEL_M = 0.4
"""Width of the kernel that interpolates between probes."""


@dataclass(frozen=True)
class Settings:
    """Settings of the training; those in `SETTABLE` are described there."""

    hidden: int = 64
    samples: int = 1_000_000
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    batch_size: int = 256
    smoothing_s: float = 2.4
    jitter_mps: float = 0.1
    rounds: int = 0
    recovery_s: float = 1.5
    candidates: int = 3
    rollouts: int = 2
    held_out: float = 0.1
    """Share of the persons held out, whose likelihood is printed."""
    seed: int = 0


SETTABLE = {
    "hidden": "width of the two hidden layers",
    "samples": "number of decisions that the network is trained on before the closed loop",
    "learning_rate": "maximum learning rate of AdamW",
    "weight_decay": "weight decay of AdamW",
    "batch_size": "number of decisions in a batch",
    "smoothing_s": "window in which recorded paths are smoothed, seconds; 0: none",
    "jitter_mps": "standard deviation of the noise on a person's own velocity in training, m/s; "
    "0: none",
    "recovery_s": "time constant with which labels in closed loop return to the recorded paths",
    "rounds": "rounds of training in closed loop, each on half as many decisions as before them",
    "candidates": "number of candidates per decision in closed loop",
    "rollouts": "number of rollouts of each choice of the guide on the training blocks",
}
"""Settings with a command line option, and the help texts of the options."""


@dataclass(frozen=True)
class Guide:
    """Weights of the costs of a candidate, and the width of the mixture."""

    avoid: float = 8.0
    """Weight of close passes: the sum of max(0, 1 − d / `STRANGERS_M`) over strangers, where d is
    the smallest distance within `HORIZON_S`."""
    wall: float = 4.0
    """Weight of walls: max(0, 1 − d / `WALLS_M`), where d is the distance to walls and bounds from
    where the person is after `LOOK_S`."""
    touch: float = 0.0
    """Weight of overlaps: the depth of the deepest one within `HORIZON_S`, from 0 to 1."""
    home: float = 5.0
    """Weight of the distance in metres at which a target nearer than `NEAR_M` is passed."""
    width: float = 0.85
    """Factor of the standard deviations of the mixture."""

    def tensor(self) -> Tensor:
        """The five numbers."""
        return torch.tensor(astuple(self), dtype=torch.float32)


PLAIN = Guide(avoid=0.0, wall=0.0, home=0.0, width=1.0)
"""No guide."""
GRID: Mapping[str, tuple[float, ...]] = {
    "width": (1.0, 0.85, 0.7, 0.5),
    "avoid": (2.0, 4.0, 8.0, 16.0, 32.0),
    "wall": (0.0, 4.0, 12.0, 36.0),
    "touch": (0.0, 8.0),
}
"""Values that are tried, one setting after the other, in this order."""


class Perception(nn.Module):
    """Features of the observation `social-1`, scaled to about −1 to 1."""

    OWN, OTHER, CODE = 45, 10, 32

    def __init__(self, max_speed_mps: float) -> None:
        super().__init__()
        self.max_speed_mps = max_speed_mps
        self.others = nn.Sequential(
            nn.Linear(self.OTHER, self.CODE), nn.SiLU(), nn.Linear(self.CODE, self.CODE), nn.SiLU()
        )
        self.size = self.OWN + 2 * self.CODE

    def forward(self, seen: Tensor) -> Tensor:
        """Features (A, size) of observations (A, 102)."""
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
            1 - seen[:, social.PROBES],
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

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Means, standard deviations (A, K, 2) and log weights (A, K) of the components."""
        p = self.layers(self.perception(seen)).unflatten(1, (COMPONENTS, 5))
        mean = seen[:, None, social.VELOCITY] + self.unit * p[..., :2]
        std = self.unit * (p[..., 2:4] - 2.0).clamp(self.narrowest, 1.0).exp()
        return mean, std, torch.log_softmax(p[..., 4], dim=1)

    def log_prob(self, seen: Tensor, did: Tensor) -> Tensor:
        """Log-densities (A,) of actions (A, 2), in units of the walking speed."""
        mean, std, log_weight = self(seen)
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


class Sampler(nn.Module):
    """Draws actions (A, 2) with observations (A, 102) and normal numbers (A, 37).

    Of 12 candidates, one is drawn by the costs of the guide.
    """

    probes: Tensor
    weights: Tensor

    def __init__(self, walker: Walker, guide: Guide, radius_m: float) -> None:
        super().__init__()
        self.walker, self.radius_m = walker, radius_m
        self.register_buffer("probes", torch.tensor(social.PROBE_POINTS, dtype=torch.float32))
        self.register_buffer("weights", guide.tensor())

    def forward(self, seen: Tensor, noise: Tensor, weights: Tensor | None = None) -> Tensor:
        """Sampled actions (A, 2). `weights` (5,) replace those of the guide."""
        avoid, wall, touch, home, width = (self.weights if weights is None else weights).unbind()
        mean, std, log_weight = self.walker(seen)
        drawn = noise[:, :-1].unflatten(1, (CANDIDATES, 3))
        at = _chosen(log_weight.exp(), drawn[..., 0])
        actions = _taken(mean, at) + width * _taken(std, at) * drawn[..., 1:]
        actions = actions / actions.norm(dim=2, keepdim=True).clamp(min=1)
        close, overlap = self.passes(seen, actions)
        cost = avoid * close + touch * overlap + wall * self.walls(seen, actions)
        cost = cost + home * self.misses(seen, actions)
        chosen = _chosen(torch.softmax(-cost, dim=1), noise[:, -1:])
        return _taken(actions, chosen)[:, 0]

    @property
    def max_speed_mps(self) -> float:
        """The unit of velocities."""
        return self.walker.perception.max_speed_mps

    def passes(self, seen: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Close passes of strangers, and overlaps, (A, n) each, of candidates (A, n, 2)."""
        other = social.neighbours_of(seen)[:, None]  # (A, 1, 8, 8)
        here, companion = other[..., social.PRESENT][..., 0], other[..., social.COMPANION][..., 0]
        offset = other[..., social.OFFSET] * social.RANGE_M
        theirs = other[..., social.APPROACH] + seen[:, None, None, social.VELOCITY]
        approach = self.max_speed_mps * (theirs - actions[:, :, None])
        closing = -(offset * approach).sum(dim=3)
        time_s = closing / (approach * approach).sum(dim=3).clamp(min=1e-6)
        time_s = time_s.clamp(min=0).clamp(max=HORIZON_S)
        passed_m = (offset + time_s[..., None] * approach).norm(dim=3)
        overlap = here * (1 - passed_m / (2 * self.radius_m)).clamp(min=0)
        close = here * (1 - companion) * (1 - passed_m / STRANGERS_M).clamp(min=0)
        return close.sum(dim=2), overlap.amax(dim=2)

    def walls(self, seen: Tensor, actions: Tensor) -> Tensor:
        """Nearness of walls (A, n), from 0 to 1, interpolated between the probes."""
        after = LOOK_S * self.max_speed_mps * actions
        off = (after[:, :, None] - self.probes).square().sum(dim=3)
        kernel = torch.exp(-0.5 * off / KERNEL_M**2) + 1e-6
        free_m = (kernel * seen[:, None, social.PROBES]).sum(dim=2) / kernel.sum(dim=2) * REACH_M
        return (1 - free_m / WALLS_M).clamp(min=0)

    def misses(self, seen: Tensor, actions: Tensor) -> Tensor:
        """Distance (A, n) in metres at which a near target is passed straight on."""
        length_m = seen[:, social.ROUTE_LENGTH] * social.ROUTE_RANGE_M
        target = (length_m * seen[:, social.ROUTE_DIRECTION])[:, None]
        velocity = self.max_speed_mps * actions
        ahead = (target * velocity).sum(dim=2) / velocity.square().sum(dim=2).clamp(min=1e-2)
        missed_m = (target - ahead.clamp(min=0)[..., None] * velocity).norm(dim=2)
        return missed_m * (length_m < NEAR_M).float()


class InProcess:
    """A sampler as a policy whose guide can be changed, for training."""

    name = "anticipate"
    sees: ClassVar[Literal["observation"]] = "observation"
    observation = OBSERVATION

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
        """Begin an episode whose noise is drawn from `rng`."""
        self.rng = rng

    def act(self, seen: np.ndarray) -> np.ndarray:
        """Actions (A, 2) of observations (A, 102)."""
        noise = self.rng.standard_normal((len(seen), NOISE), dtype=np.float32)
        fed = {"seen": seen, "noise": noise, "weights": self.weights}
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

    def batches(self, count: int, size: int) -> Iterator[tuple[Tensor, Tensor]]:
        """`count` batches; all samples are used before any is used again."""
        rows = torch.cat([
            torch.randperm(len(self.seen)) for _ in range(1 + count * size // len(self.seen))
        ])  # fmt: skip
        for some in rows[: count * size].split(size):
            yield self.seen[some], self.did[some]


def fit(
    walker: Walker, samples: Samples, count: int, rate: float, settings: Settings, command: Command
) -> None:
    """Train a network by maximum likelihood on `count` decisions, with a one-cycle rate."""
    steps = max(1, count // settings.batch_size)
    jitter = settings.jitter_mps / walker.perception.max_speed_mps
    optimizer = torch.optim.AdamW(
        walker.parameters(), lr=rate, weight_decay=settings.weight_decay, fused=True
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, max_lr=rate, total_steps=steps)
    with command.progress("cloning", steps, "steps", "decisions") as progress:
        for k, (seen, did) in enumerate(samples.batches(steps, settings.batch_size), 1):
            seen[:, social.VELOCITY] += jitter * torch.randn(len(seen), 2)
            loss = -walker.log_prob(seen, did).mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(walker.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            progress(k, len(seen), {"nats per decision": -float(loss.detach())})


def train(command: Command, split: str, settings: Settings, interval: int) -> Walker:
    """Clone a network, then improve it in closed loop."""
    torch.manual_seed(settings.seed)
    scene = command.scene
    where: dict[str, Any] = {
        "split": split,
        "observation": OBSERVATION,
        "interval": interval,
        "smoothing_s": settings.smoothing_s,
    }
    shown, held_out = demonstrations(scene, **where).split(settings.held_out, settings.seed)
    tested = Samples.of(held_out)
    samples = Samples.of(shown)
    walker = Walker(scene.motion.max_speed_mps, settings.hidden)
    fit(walker, samples, settings.samples, settings.learning_rate, settings, command)
    for k in range(1 + settings.rounds):
        with torch.no_grad():
            nats = float(walker.log_prob(tested.seen, tested.did).mean())
        print(f"{split}: round {k}, held out {nats:.3f} nats per decision", flush=True)
        if k == settings.rounds:
            break
        plain = Sampler(walker, PLAIN, scene.motion.person_radius_m)
        walked = demonstrations(
            scene,
            policy=InProcess(plain, interval),
            candidates=settings.candidates,
            recovery_s=settings.recovery_s,
            seed=settings.seed + k,
            **where,
        )
        trained_on = np.isin(walked.person, shown.person)
        samples = samples + Samples.of(walked.take(np.flatnonzero(trained_on)), NEAR_M)
        fit(walker, samples, settings.samples // 2, settings.learning_rate / 2, settings, command)
    return walker


def guided(sampler: Sampler, scene: Scene, split: str, interval: int, rollouts: int) -> Guide:
    """Choose the guide by the walk score on the training blocks, one setting after the other."""
    guide, tried = Guide(), {}
    policy = InProcess(sampler, interval)
    for name, values in GRID.items():
        for one in (replace(guide, **{name: value}) for value in values):
            if one in tried:
                continue
            policy.weights = one.tensor().numpy()
            found = tried[one] = validate(scene, policy, split, rollouts=rollouts)
            parts = ", ".join(f"{family} {x:.2f}" for family, x in found.families.items())
            print(f"{split}: {one}: walk {found.walk:.3f} ({parts})", flush=True)
        guide = max(tried, key=lambda g: tried[g].walk)
    return guide


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = new_parser("anticipate", __doc__)
    add_settings(parser, Settings(), SETTABLE)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Train and write a policy for each split; return the exit code."""
    asked = command_line().parse_args(arguments)
    use_one_thread()
    settings = Settings(**{name: getattr(asked, name) for name in (*SETTABLE, "seed")})
    try:
        zero = ("rounds", "smoothing_s", "jitter_mps", "recovery_s", "weight_decay", "seed")
        check_numbers(settings, or_zero=zero)
        check_onnx()  # needed for the choice of the guide, after the training
        command = Command.of("anticipate", asked.scene, asked.splits, asked.out, arguments)
        scene = command.scene
        interval = max(1, round(scene.grid_s / scene.dt_s))  # people decide on the annotation grid
        for split in asked.splits:
            walker = train(command, split, settings, interval)
            sampler = Sampler(walker, Guide(), scene.motion.person_radius_m)
            guide = guided(sampler, scene, split, interval, settings.rollouts)
            print(f"{split}: chosen: {guide}", flush=True)
            sampler.weights.copy_(guide.tensor())
            path = command.write(
                split, sampler, observation=OBSERVATION, noise=NOISE, interval=interval
            )
            print(f"{path}: {command.walk(path, 'ntpp-gmm')}", flush=True)
    except CrowdbenchError as error:
        print(f"baselines.anticipate: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
