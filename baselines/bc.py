"""Behaviour cloning of recorded people with `imitation`.

    python -m crowdbench.baselines.bc --scene eth-v0

writes `results/bc-eth-v0/full.onnx`, which `crowdbench evaluate eth-v0 --policy
results/bc-eth-v0/full.onnx` rolls out. Compared with the cloned policy of the founding paper
(Kreutz et al. 2025), the defaults have the same size (two layers of 32), initial learning rate
(Adam, 1e-4, which decreases here) and maximum number of epochs (1000). The paper uses a plain
network and its own observation. This policy sees `lidar-3`, predicts a mixture of Gaussians, is
also trained on people displaced from their paths, and stops when the likelihood of held-out people
no longer improves. The policies shipped with scenes have other sizes, rates and epochs;
`crowdbench policy show` prints their commands.
"""

import argparse
import copy
import math
import sys
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crowdbench import Demonstrations, demonstrations
from crowdbench.errors import CrowdbenchError
from crowdbench.scene import Scene

from .packages import needs

with needs("imitation", __name__):
    import torch
    from gymnasium import spaces
    from imitation.algorithms import bc
    from imitation.util import logger

    from .command import (
        Command,
        add_settings,
        check_numbers,
        new_parser,
        train_each,
    )
    from .mixture import (
        NEAR_GOAL_M,
        NOISE,
        MixturePolicy,
        MixtureSampler,
        features_of,
        target_distance_m,
    )
    from .progress import Progress

OBSERVATIONS = ("lidar-3", "lidar-2", "social-1")
"""Observations that a policy can be cloned on. Only `social-1` shows stops, companions and how
others move. If goals are close to the bounds, a policy that sees rays needs `lidar-3`, with the
distances to the bounds, to reach them. Otherwise `lidar-2` is less prone to memorising a small
recording."""


@dataclass(frozen=True)
class BcSettings:
    """Settings of the cloning."""

    observation: str = OBSERVATIONS[0]
    hidden: tuple[int, ...] = (32, 32)
    learning_rate: float = 1e-4
    batch_size: int = 32
    epochs: int = 1000
    patience: int = 30
    """Number of epochs without a better held-out likelihood after which training stops."""
    held_out: float = 0.1
    """Share of the persons held out for early stopping."""
    smoothing_s: float = 0.0
    """Window in which recorded paths are smoothed, see `crowdbench.demonstrations`."""
    displaced_m: float = 0.5
    """Standard deviation of the displacements, see `crowdbench.demonstrations`."""
    homing: int = 1
    """Number of times that samples near a goal are repeated. They are rare, and a policy that
    misses its goal never arrives."""
    width: float = 1.0
    """Factor by which standard deviations are multiplied after training. Gaussians fitted to data
    that are not Gaussian are too wide, and samples from them are less steady than the recording."""
    copies: int = 1
    """Number of copies of the recording, with different persons displaced in each."""
    seed: int = 0


SETTABLE = {
    "learning_rate": "initial learning rate of Adam; it decreases to 0 along half a cosine",
    "batch_size": "number of samples in a batch",
    "epochs": "maximum number of epochs",
    "patience": "number of epochs without a better held-out likelihood after which training stops",
    "smoothing_s": "window in which recorded paths are smoothed, seconds; 0: none",
    "displaced_m": "standard deviation of displacements from the recorded paths in metres, from "
    "which the samples show how to return; 0: no displacements",
    "homing": "number of times that samples near a goal are repeated",
    "width": "factor by which standard deviations are multiplied after training",
    "copies": "number of copies of the recording, with different persons displaced in each",
}
"""Settings with a command line option, and the help texts of the options."""


def check(settings: BcSettings, prefix: str = "") -> None:
    """Check the settings; their options begin with `prefix`.

    Raises:
        SettingError: a number is out of range.
    """
    check_numbers(
        settings,
        or_zero=("epochs", "patience", "smoothing_s", "displaced_m", "seed"),
        prefixed=(*SETTABLE, "hidden"),
        prefix=prefix,
    )


class Clipped(torch.optim.Adam):
    """Adam with gradients clipped to norm 1; actions far from a narrow Gaussian give large ones."""

    def step(self, closure: Any = None) -> Any:
        """Clip the gradients and take a step."""
        for group in self.param_groups:
            torch.nn.utils.clip_grad_norm_(group["params"], 1.0)
        return super().step(closure)


@dataclass
class Batches:
    """Batches of demonstrations, shuffled in each pass.

    `imitation`'s own loader collates one pair at a time, which takes longer than the training.
    """

    columns: Mapping[str, np.ndarray]
    """Arrays of equal length, by the names that `imitation` uses: `obs`, `acts`, …"""
    size: int
    rng: np.random.Generator

    def __len__(self) -> int:
        return max(1, self._rows // self.size)

    def __iter__(self) -> Iterator[Mapping[str, torch.Tensor]]:
        order = self.rng.permutation(self._rows)
        for k in range(len(self)):
            rows = order[k * self.size : (k + 1) * self.size]
            yield {name: torch.from_numpy(values[rows]) for name, values in self.columns.items()}

    @property
    def _rows(self) -> int:
        return len(self.columns["acts"])


def shown(scene: str | Scene, split: str, settings: BcSettings) -> list[Demonstrations]:
    """Demonstrations to learn from, one set for each copy of the recording."""
    return [
        demonstrations(
            scene,
            split=split,
            observation=settings.observation,
            smoothing_s=settings.smoothing_s,
            displaced_m=settings.displaced_m,
            seed=settings.seed + k,
        )
        for k in range(settings.copies)
    ]


def everything(lots: list[Demonstrations], settings: BcSettings) -> Batches:
    """Batches of all demonstrations, with nobody held out."""
    seen, did = (np.concatenate(each) for each in zip(*(lot.pairs() for lot in lots), strict=True))
    rng = np.random.default_rng(settings.seed)
    return Batches({"obs": seen, "acts": did}, min(settings.batch_size, len(did)), rng)


def clone(
    lots: list[Demonstrations], settings: BcSettings, progress: Progress | None = None
) -> tuple[MixturePolicy, float, int]:
    """Clone a policy; `progress`, if given, is told of each epoch.

    Returns the policy of the best epoch, its held-out log-likelihood in nats per action, and the
    number of that epoch.
    """
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    splits = [lot.split(settings.held_out, settings.seed) for lot in lots]
    x, a = (np.concatenate(each) for each in zip(*(t.pairs() for t, _ in splits), strict=True))
    seen, did = (np.concatenate(e) for e in zip(*(h.pairs() for _, h in splits), strict=True))
    held_out = torch.from_numpy(seen), torch.from_numpy(did)
    # Repeated samples change how often situations occur, not the actions in each situation.
    near = np.flatnonzero(target_distance_m(x, settings.observation) < NEAR_GOAL_M)
    rows = np.concatenate([np.arange(len(x)), np.tile(near, settings.homing - 1)])
    x, a = x[rows], a[rows]
    policy = MixturePolicy(
        spaces.Box(-1.0, 1.0, (x.shape[1],), np.float32),
        spaces.Box(-1.0, 1.0, (2,), np.float32),
        lambda _: settings.learning_rate,
        net_arch=list(settings.hidden),
        features_extractor_class=features_of(settings.observation),
    )
    size = min(settings.batch_size, len(a))
    trainer = bc.BC(
        observation_space=policy.observation_space,
        action_space=policy.action_space,
        policy=policy,
        demonstrations=Batches({"obs": x, "acts": a}, size, rng),
        batch_size=size,
        optimizer_cls=Clipped,
        optimizer_kwargs={"lr": settings.learning_rate},
        ent_weight=0.0,
        rng=rng,
        device="cpu",
        custom_logger=logger.configure(format_strs=[]),
    )
    best, best_epoch, weights = -np.inf, 0, copy.deepcopy(policy.state_dict())
    for epoch in range(1, settings.epochs + 1):
        for group in trainer.optimizer.param_groups:
            group["lr"] = settings.learning_rate * _decay((epoch - 1) / settings.epochs)
        with warnings.catch_warnings():  # imitation logs tensors with gradients
            warnings.filterwarnings("ignore", message="Converting a tensor")
            trainer.train(n_epochs=1, progress_bar=False, log_interval=10**9)
        likelihood = _likelihood(policy, *held_out)
        if likelihood > best:
            best, best_epoch, weights = likelihood, epoch, copy.deepcopy(policy.state_dict())
        if progress is not None:
            progress(epoch, len(a), {"nats per action held out": likelihood, "best": best})
        if epoch - best_epoch >= settings.patience:
            break
    policy.load_state_dict(weights)
    policy.narrow(settings.width)
    return policy, best, best_epoch


def _decay(progress: float) -> float:
    """Half a cosine, from 1 to 0 (Loshchilov & Hutter 2017, SGDR, ICLR, eq. 5)."""
    return 0.5 + 0.5 * math.cos(math.pi * progress)


def _likelihood(policy: MixturePolicy, seen: torch.Tensor, did: torch.Tensor) -> float:
    with torch.no_grad():
        each = [
            policy.get_distribution(s).log_prob(a)
            for s, a in zip(seen.split(65_536), did.split(65_536), strict=True)
        ]
    return float(torch.cat(each).mean())


def add_cloning(parser: argparse._ActionsContainer, prefix: str = "") -> None:
    """Add options for `BcSettings`, except for the observation and the seed."""
    parser.add_argument(
        f"--{prefix}hidden",
        nargs="+",
        type=int,
        default=list(BcSettings.hidden),
        metavar="N",
        help=f"widths of the hidden layers (default: {' '.join(map(str, BcSettings.hidden))})",
    )
    add_settings(parser, BcSettings(), SETTABLE, prefix)


def add_observation(parser: argparse.ArgumentParser) -> None:
    """Add the option for the observation."""
    parser.add_argument(
        "--observation",
        choices=OBSERVATIONS,
        default=OBSERVATIONS[0],
        help="observation of the policy; social-1 shows stops and companions, lidar-3 contains the "
        "bounds (default: %(default)s)",
    )


def settings_from(asked: argparse.Namespace, prefix: str = "") -> BcSettings:
    """Settings from the parsed options."""
    named = {name: getattr(asked, prefix + name) for name in SETTABLE}
    return BcSettings(hidden=tuple(getattr(asked, f"{prefix}hidden")), **named)


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = new_parser("bc", __doc__)
    add_cloning(parser)
    add_observation(parser)
    return parser


def learn(split: str, command: Command, settings: BcSettings) -> str:
    """Clone and write the policy of a split; return lines about it."""
    lots = shown(command.scene, split, settings)
    with command.progress(split, settings.epochs, "epochs", "samples") as progress:
        policy, likelihood, epochs = clone(lots, settings, progress)
    path = command.write(
        split, MixtureSampler(policy), observation=settings.observation, noise=NOISE
    )
    return (
        f"{likelihood:.4f} nats per action after {epochs} epochs\n{command.walk(path, 'ntpp-gmm')}"
    )


def main(arguments: list[str] | None = None) -> int:
    """Clone and write a policy for each split; return the exit code."""
    asked = command_line().parse_args(arguments)
    settings = replace(settings_from(asked), observation=asked.observation, seed=asked.seed)
    try:
        check(settings)
        command = Command.of("bc", asked.scene, asked.splits, asked.out, arguments)
        train_each(learn, command, asked, settings)
    except CrowdbenchError as error:
        print(f"crowdbench.baselines.bc: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    # Worker processes find functions in modules that they can import, which `__main__` is not.
    from .bc import main as imported_main

    sys.exit(imported_main())
