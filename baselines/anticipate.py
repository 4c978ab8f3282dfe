"""Walkers that anticipate: they see where others are going, and pass them at a distance.

    python -m crowdbench.baselines.anticipate --scene eth-v0

writes `results/anticipate-eth-v0/full.onnx`, which `crowdbench evaluate eth-v0 --policy
results/anticipate-eth-v0/full.onnx` rolls out. The file contains all of the following.

    python -m crowdbench.baselines.anticipate --scenes eth-v0 hotel-v0 zara1-v0 --leave-out zara1-v0

trains one network on several scenes, and validates it on another one.

**Perception.** The observation `social-1`, in a person's own frame: its velocity, the way to its
target, its preferred speed and stop, what it remembers (age, distance walked, time stood), the free
space around it, and the eight nearest people with their velocities. `Perception` scales it. All
neighbours pass through the same small network; their sum and maximum are seen (Qi et al. 2017,
PointNet, CVPR).

**Network.** `Walker` predicts a mixture of Gaussians around the present velocity (Bishop 1994,
mixture density networks, eqs. 22-27), cloned from recorded people by maximum likelihood.

**Decisions.** The network learns the mean velocity until the next annotation (0.4 s; 0.8 s on Grand
Central), and people decide again when that time is over. A network for several scenes learns the
mean velocity over 0.8 s, and people decide anew in each frame of about 0.4 s, as in
receding-horizon control: in a place that it was not trained on, walking is then steadier.

**Smoothing.** The positions of a recording contain the noise of annotations. A network that is
cloned on them trembles when it is sampled. Therefore it is cloned on smoothed paths
(`--smoothing-s`).

**Jitter.** Recorded people hardly ever leave the speed and heading that they prefer. A clone does
not learn how to return to them, and drifts. In training, the network therefore sees the person's
own velocity with random noise, and how strong it is (up to `--jitter-mps`), and learns to walk the
recorded one (as in conditioning augmentation; Ho et al. 2022, Cascaded diffusion models, JMLR 23).
In a rollout there is no noise. The strength that the network is then told is a setting: the greater
it is, the faster people return to velocities that are usual in the recording.

**Guide.** In a rollout, there are thirteen candidates for the next velocity. Twelve are drawn
from the mixture. The last one is what the plan asks for: to walk along the way at the preferred
speed, or to stand at a stop. One of them is drawn with weights exp(−cost). The cost anticipates
close passes of strangers, companions who are left, walls, delay, and a near target that would be
missed: recordings have too few near collisions for a network to learn this from them. The last
candidate costs more (`resume`). It is for people whom a wall or a crowd has stopped, because a
cloned network that sees a standing person predicts that it stays.

The guide is adapted to the training blocks. The cost of walls is learned. It rises at distances
from walls where simulated people are found more often than recorded ones, and falls at the others
(`corrected`).
The weights of passes and of delay, the width of the mixture and the strength of the jitter are
chosen by the scores of walking that `validate` measures there.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from crowdbench import Demonstrations, Scene, demonstrations, registry
from crowdbench.errors import CrowdbenchError, RecordingError
from crowdbench.metrics.interaction import WALL_RANGE_M
from crowdbench.policies import OnnxPolicy
from crowdbench.run.validation import Validation, Validator
from crowdbench.simulation import social

from .packages import needs

with needs("fit", __name__):
    import torch
    from torch import Tensor, nn

    from crowdbench.policies.network import check_onnx

    from .anticipation import (
        KNOTS_M,
        NOISE,
        OBSERVATION,
        Guide,
        InProcess,
        Sampler,
        Walker,
    )
    from .command import (
        Command,
        add_settings,
        check_numbers,
        new_parser,
        train_each,
    )


@dataclass(frozen=True)
class AnticipateSettings:
    """Settings of the training; those in `SETTABLE` are described there."""

    hidden: int = 128
    steps: int = 4_000
    batch_size: int = 256
    passes: int = 8
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    smoothing_s: float = 2.4
    jitter_mps: float = 0.2
    people: int = 10_000
    held_out: float = 0.1
    """Share of the persons held out, whose likelihood is printed."""
    seed: int = 0


SETTABLE = {
    "hidden": "width of the two hidden layers",
    "steps": "number of training steps",
    "batch_size": "number of decisions in a batch, at least",
    "passes": "how often all decisions are learned from, at least; batches are as large as needed",
    "learning_rate": "maximum learning rate of AdamW",
    "weight_decay": "weight decay of AdamW",
    "smoothing_s": "window in which recorded paths are smoothed, seconds; 0: none",
    "jitter_mps": "maximum standard deviation of the noise on a person's own velocity in training, "
    "m/s; 0: none",
    "people": "number of people, at least, who are simulated for each choice of the guide; the "
    "recording is walked as often as needed",
}
"""Settings with a command line option, and the help texts of the options."""


WIDTHS = (1.0, 0.7)
"""Values of `width`. The other settings are chosen for each of them, because they depend on it: the
narrower the mixture, the more walls and delay must cost."""
GRID: Mapping[str, tuple[float, ...]] = {
    "avoid": (8.0, 16.0, 32.0),
    "delay": (0.0, 1.0, 2.0),
    "jitter": (0.1, 0.2),
}
"""Values of the other settings that are chosen, in this order."""
MARGIN = 0.02
"""A setting changes only if the score rises by more than this. Small recordings have few
encounters, and the scores of two equally good guides differ by about as much by chance."""
CORRECTIONS, AFTER_CHANGE = 10, 2
"""Number of times that the cost of walls is corrected at the beginning, and after each change of
another setting."""
FEWER = 3
"""Corrections, and the choice of `room`, need fewer people than other choices, by this factor:
there are many positions, but few encounters."""
GAIN, FEWEST = 2.0, 0.001
"""A cost is corrected by `GAIN` times the logarithm of the ratio of two shares. `FEWEST` is added
to both, because few people are close to walls."""
ROOM = (0.0, 4.0, 8.0, 16.0)
"""Values of `room`, which is chosen last: by the mean distance of companions, which *walk* does not
measure."""
TRIED_ON_SEVERAL = ("avoid",)
"""The settings that are chosen if there are several scenes, on which each choice takes longer."""
SEVERAL_WIDTH = 0.85
"""`width` if there are several scenes.

The mixture of a network for several scenes is also wide because it does not know which kind of
place it is in; sampled in full, this becomes noise of each person. Five networks were trained, each
without one of five scenes, and walked in the training blocks of that scene: the worst walk of the
five was 0.35 with a width of 1, 0.45 with 0.85 and 0.43 with 0.7."""
BOTH = 0.1
"""Weight of the mean of motion and interaction in the choice, beside *walk*."""
AHEAD_S = 0.8
"""A network for several scenes learns the mean velocity over this time."""


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
    def of(cls, shown: Demonstrations) -> "Samples":
        """Pairs of demonstrations, and their mirror images."""
        seen, did = shown.pairs()
        both = (seen, mirrored(seen)), (did, did * np.array([1, -1], np.float32))
        return cls(*(torch.from_numpy(np.concatenate(pair)) for pair in both))

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
    walker: Walker,
    samples: Samples,
    steps: int,
    rate: float,
    settings: AnticipateSettings,
    command: Command,
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


def frames_ahead(*scenes: Scene) -> int:
    """Number of frames over which the network learns the mean velocity of recorded people.

    It is one step of the annotation grid, at least one frame; on several scenes, as many frames as
    make about `AHEAD_S`.
    """
    ahead_s = scenes[0].grid_s if len(scenes) == 1 else AHEAD_S
    return max(1, round(ahead_s / scenes[0].dt_s))


def decision_frames(*scenes: Scene) -> int:
    """Number of frames between two decisions.

    On one scene, people decide when the time of `frames_ahead` is over; on several scenes, in each
    frame.
    """
    return frames_ahead(*scenes) if len(scenes) == 1 else 1


def pooled(each: Sequence[Samples]) -> Samples:
    """Samples of several scenes, as many as all have together.

    The share of a scene is proportional to the square root of its number of samples, so that a
    large recording does not outweigh all others.
    """
    roots = [math.sqrt(len(samples)) for samples in each]
    total = sum(map(len, each))
    lots = [
        samples.shared(round(total * root / sum(roots))) if len(samples) else samples
        for samples, root in zip(each, roots, strict=True)
    ]
    return Samples(torch.cat([lot.seen for lot in lots]), torch.cat([lot.did for lot in lots]))


def train(
    command: Command, split: str, settings: AnticipateSettings, ahead: int, walker: Walker
) -> Walker:
    """Clone a network; returns it."""
    where: dict[str, Any] = {
        "split": split,
        "observation": OBSERVATION,
        "interval": ahead,
        "smoothing_s": settings.smoothing_s,
    }
    people = [
        demonstrations(scene, **where).split(settings.held_out, settings.seed)
        for scene in command.scenes
    ]
    tested = pooled([Samples.of(held_out) for _, held_out in people])
    samples = pooled([Samples.of(shown) for shown, _ in people])
    if len(samples) == 0:
        raise RecordingError(
            "+".join(scene.id for scene in command.scenes),
            got="nobody to learn from",
            expected="two or more people in the training blocks",
        )
    fit(walker, samples, settings.steps, settings.learning_rate, settings, command)
    if len(tested):
        with torch.no_grad():
            none = torch.zeros(len(tested), 1)
            nats = float(walker.log_prob(tested.seen, none, tested.did).mean())
        print(f"{split}: held out {nats:.3f} nats per decision", flush=True)
    return walker


def corrected(guide: Guide, found: Sequence[Validation]) -> Guide:
    """The guide with a cost of walls that is higher where people walk too often.

    This is a step of iterative Boltzmann inversion (Reith et al. 2003, J. Comput. Chem. 24, 1624,
    eq. 3): the cost at a distance changes by the logarithm of the simulated over the recorded
    share of positions there. Of several scenes, the mean counts.
    """
    change = np.zeros(len(KNOTS_M))
    for each in found:
        distances_m = np.linspace(0, WALL_RANGE_M, len(each.clearance[0]))
        near = np.stack([np.interp(distances_m, KNOTS_M, row) for row in np.eye(len(KNOTS_M))])
        recorded, simulated = (near @ np.array(shares) + FEWEST for shares in each.clearance)
        change += GAIN * np.log(simulated / recorded) / len(found)
    wall = np.round(guide.wall + (change - change[-1])[:-1], 2)
    return replace(guide, wall=tuple(wall.tolist()))


def best(scores: Sequence[tuple[Guide, float]]) -> tuple[Guide, float]:
    """The guide with the highest score, if it scores more by `MARGIN` than the first one."""
    highest = max(scores, key=lambda pair: pair[1])
    return highest if highest[1] > scores[0][1] + MARGIN else scores[0]


def guided(
    sampler: Sampler,
    validators: Sequence[Validator],
    interval: int,
    settings: AnticipateSettings,
    fixed: Mapping[str, float] = MappingProxyType({}),
) -> Guide:
    """Choose the guide on the training blocks of the validators, one for each scene.

    For each of `WIDTHS`, the cost of walls is `corrected` so that people are as often near walls as
    recorded ones. Then the settings in `GRID` are chosen by the walk score, one after the other: a
    setting changes if another value scores more by `MARGIN`, with a cost of walls that has been
    corrected for it. Of several scenes, the mean score counts. Since *walk* is the lesser of two
    families, it is blind to the other one; therefore `BOTH` times the mean of both is added. `room`
    is chosen last, by the mean distance of companions. `fixed` settings keep their values.
    """
    known = {"jitter": min(Guide.jitter, settings.jitter_mps), **fixed}
    first = replace(Guide(), **dict[str, Any](known))
    policy = InProcess(sampler, interval)
    scenes, split = [v.scene for v in validators], validators[0].split
    sizes = [len(scenes) * max(1, len(registry.recording_of(scene))) for scene in scenes]

    def validated(one: Guide, people: float = settings.people) -> list[Validation]:
        policy.weights = one.tensor().numpy()
        numbers = [math.ceil(people / size) for size in sizes]
        return [v.validate(policy, rollouts=n) for v, n in zip(validators, numbers, strict=True)]

    def scored(one: Guide) -> float:
        found = validated(one)
        walk = float(np.mean([each.walk for each in found]))
        families = [float(np.mean(list(each.families.values()))) for each in found]
        print(f"{split}: {one}: walk {walk:.3f} ({_parts(scenes, found)})", flush=True)
        return walk + BOTH * float(np.mean(families))

    def learned(one: Guide, times: int) -> Guide:
        for _ in range(times):
            one = corrected(one, validated(one, settings.people / FEWER))
        return one

    tried = GRID if len(scenes) == 1 else TRIED_ON_SEVERAL

    def chosen(guide: Guide) -> tuple[Guide, float]:
        guide = learned(guide, CORRECTIONS)
        score = scored(guide)
        for name in (name for name in tried if name not in fixed):
            others = [
                learned(replace(guide, **dict[str, Any]({name: value})), AFTER_CHANGE)
                for value in GRID[name]
                if value != getattr(guide, name)
                and (name != "jitter" or value <= settings.jitter_mps)  # trained with as much
            ]
            guide, score = best([(guide, score), *((other, scored(other)) for other in others)])
        return guide, score

    widths = WIDTHS if len(scenes) == 1 else (SEVERAL_WIDTH,)
    if "width" in fixed:
        widths = (first.width,)
    guide, _ = best([chosen(replace(first, width=width)) for width in widths])
    off: dict[Guide, float] = {}
    for one in (replace(guide, room=value) for value in ROOM if "room" not in fixed):
        found = validated(one, settings.people / FEWER)
        apart = [v.companion_distance for v in found if not math.isnan(v.companion_distance)]
        if apart:
            off[one] = float(np.mean([abs(math.log(distance)) for distance in apart]))
        print(f"{split}: {one}: companion distance {_apart(scenes, found)}", flush=True)
    return min(off, key=lambda g: off[g], default=guide)


def _apart(scenes: Sequence[Scene], found: Sequence[Validation]) -> str:
    """The mean distance of companions in each scene, divided by the recorded one."""
    return ", ".join(
        f"{s.id} {v.companion_distance:.2f}" for s, v in zip(scenes, found, strict=True)
    )


def _parts(scenes: Sequence[Scene], found: Sequence[Validation]) -> str:
    """What a score is made of: the families of one scene, or the scores of several scenes."""
    if len(scenes) > 1:
        return ", ".join(f"{s.id} {v.walk:.2f}" for s, v in zip(scenes, found, strict=True))
    return ", ".join(f"{family} {x:.2f}" for family, x in found[0].families.items())


def learn(command: Command, split: str, settings: AnticipateSettings) -> Path:
    """Train a network, choose its guide, and write both; return the file."""
    interval = decision_frames(*command.scenes)
    # First, because it fails if a scene has no reference statistics.
    validators = [Validator(scene, split) for scene in command.scenes]
    torch.manual_seed(settings.seed)
    walker = Walker(command.scene.motion.max_speed_mps, settings.hidden)
    train(command, split, settings, frames_ahead(*command.scenes), walker)
    sampler = Sampler(walker, Guide())
    guide = guided(sampler, validators, interval, settings)
    print(f"{split}: chosen: {guide}", flush=True)
    sampler.weights.copy_(guide.tensor())
    return command.write(split, sampler, observation=OBSERVATION, noise=NOISE, interval=interval)


def learn_and_walk(
    split: str, command: Command, settings: AnticipateSettings, left_out: str | None
) -> str:
    """The same; return lines about how the policy walks, also in the scene that was left out."""
    other = None if left_out is None else Validator(left_out)
    path = learn(command, split, settings)
    lines = [str(command.walk(path, "ntpp-gmm"))]
    if other is not None:
        lines.append(f"walk {other.validate(OnnxPolicy(path)).walk:.3f} on {left_out}")
    return "\n".join(lines)


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = new_parser("anticipate", __doc__, several=True)
    add_settings(parser, AnticipateSettings(), SETTABLE)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Train and write a policy for each split; return the exit code."""
    asked = command_line().parse_args(arguments)
    settings = AnticipateSettings(**{name: getattr(asked, name) for name in (*SETTABLE, "seed")})
    try:
        zero = ("passes", "smoothing_s", "jitter_mps", "weight_decay", "seed")
        check_numbers(settings, or_zero=zero)
        check_onnx()  # needed for the choice of the guide, after the training
        command = Command.of_asked("anticipate", asked, arguments)
        registry.spawn_model("ntpp-gmm", command.scene)  # for the rollout at the end
        train_each(learn_and_walk, command, asked, settings, asked.leave_out)
    except CrowdbenchError as error:
        print(f"crowdbench.baselines.anticipate: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    # Worker processes find functions in modules that they can import, which `__main__` is not.
    from .anticipate import main as imported_main

    sys.exit(imported_main())
