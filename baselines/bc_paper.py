"""The behaviour cloning of the founding paper (Kreutz et al. 2025, ICRA), with `imitation`.

    python -m crowdbench.baselines.bc_paper --scene eth-v0

writes `results/bc-paper-eth-v0/full.onnx`, which `crowdbench evaluate eth-v0 --policy
results/bc-paper-eth-v0/full.onnx` rolls out. As in the paper, the policy is a network with two
layers of 32, trained for 1000 epochs at the learning rate 1e-4. It sees its velocity, the distance
to its goal, the angle to its goal over 2π, and 32 rays, and predicts a Gaussian whose standard
deviation is the same in all states. Where the paper is silent, this follows its published code:
batches of 1024, `imitation`'s weight of the entropy (1e-3), actions scaled to [−1, 1] between the
extremes of the recording, and actions that are sampled, not means. The learning rate of the code is
1e-3, `imitation`'s default (`--learning-rate 1e-3`). On short recordings it is needed: with batches
of 1024 and 1e-4, the standard deviation hardly changes in 1000 epochs on ETH.

Two things differ. Velocities, distances and rays have the units of `lidar-1` and not pixels of a
picture. People who hardly move, and those with short or long trips, are not left out.

`crowdbench.baselines.bc` is crowdbench's own cloning.
"""

import argparse
import math
import sys
import warnings
from dataclasses import dataclass

import numpy as np

from crowdbench import Demonstrations, demonstrations
from crowdbench.errors import CrowdbenchError
from crowdbench.simulation.observations import GOAL_DIRECTION, head_of

from .packages import needs

with needs("imitation", __name__):
    import torch
    from gymnasium import spaces
    from imitation.algorithms import bc
    from imitation.util import logger
    from stable_baselines3.common.policies import ActorCriticPolicy
    from torch import Tensor, nn

    from .bc import Batches
    from .command import (
        Command,
        add_settings,
        check_numbers,
        new_parser,
        train_each,
    )
    from .progress import Progress

OBSERVATION = "lidar-1"
SELF = head_of(OBSERVATION)
"""Number of values before the rays."""
NOISE = 2
"""Number of normal numbers per action."""
LAYERS = {"pi": [32, 32], "vf": []}
"""The paper's layers; cloning needs no value of a state, so its network has no layers."""


@dataclass(frozen=True)
class BcPaperSettings:
    """Settings of the cloning."""

    learning_rate: float = 1e-4
    batch_size: int = 1024
    epochs: int = 1000
    seed: int = 0


SETTABLE = {
    "learning_rate": "learning rate of Adam",
    "batch_size": "number of samples in a batch",
    "epochs": "number of epochs",
}
"""Settings with a command line option, and the help texts of the options."""


class PaperObservation(nn.Module):
    """The paper's observation, from `lidar-1`: the direction to the goal becomes one angle."""

    def forward(self, seen: Tensor) -> Tensor:
        """Velocity (2), distance and angle / 2π of the goal, rays: (A, obs − 1) of (A, obs)."""
        cos, sin = seen[:, GOAL_DIRECTION].unbind(dim=1)
        angle = torch.atan2(sin, cos)[:, None] / (2 * math.pi)
        return torch.cat([seen[:, : GOAL_DIRECTION.start], angle, seen[:, SELF:]], dim=1)


class PaperSampler(nn.Module):
    """Computes actions from observations (A, obs) and standard normal numbers (A, 2)."""

    std: Tensor
    middle: Tensor
    reach: Tensor

    def __init__(self, policy: ActorCriticPolicy, lowest: np.ndarray, highest: np.ndarray):
        """A cloned policy, and the velocities (2,) that it knows as −1 and 1."""
        super().__init__()
        self.features = PaperObservation()
        self.actor = policy.mlp_extractor.policy_net
        self.head = policy.action_net
        self.register_buffer("std", policy.log_std.detach().exp())
        self.register_buffer("middle", torch.from_numpy((highest + lowest) / 2))
        self.register_buffer("reach", torch.from_numpy((highest - lowest) / 2))

    def forward(self, seen: Tensor, noise: Tensor) -> Tensor:
        """Sampled actions (A, 2), clipped to the range of the demonstrations."""
        mean = self.head(self.actor(self.features(seen)))
        drawn: Tensor = self.middle + self.reach * (mean + self.std * noise).clamp(-1, 1)
        return drawn


def clone(
    shown: Demonstrations, settings: BcPaperSettings, progress: Progress | None = None
) -> PaperSampler:
    """Clone a policy from demonstrations with the observation `lidar-1`.

    `progress`, if given, is told of each epoch.
    """
    torch.manual_seed(settings.seed)
    rng = np.random.default_rng(settings.seed)
    pairs, did = shown.pairs()
    seen = PaperObservation()(torch.from_numpy(pairs)).numpy()
    lowest, highest = did.min(axis=0), did.max(axis=0)
    half = np.maximum((highest - lowest) / 2, 1e-6)
    scaled = ((did - lowest) / half - 1).astype(np.float32)
    observed = spaces.Box(-1.0, 1.0, (seen.shape[1],), np.float32)
    actions = spaces.Box(-1.0, 1.0, (2,), np.float32)
    policy = ActorCriticPolicy(observed, actions, lambda _: settings.learning_rate, net_arch=LAYERS)
    size = min(settings.batch_size, len(did))
    trainer = bc.BC(
        observation_space=observed,
        action_space=actions,
        policy=policy,
        demonstrations=Batches({"obs": seen, "acts": scaled}, size, rng),
        batch_size=size,
        optimizer_kwargs={"lr": settings.learning_rate, "fused": True},
        rng=rng,
        device="cpu",
        custom_logger=logger.configure(format_strs=[]),
    )
    epoch = 0

    def report() -> None:
        nonlocal epoch
        epoch += 1
        if progress is not None:
            std = float(policy.log_std.detach().exp().mean())
            progress(epoch, len(did), {"standard deviation": std})

    with warnings.catch_warnings():  # imitation logs tensors with gradients
        warnings.filterwarnings("ignore", message="Converting a tensor")
        trainer.train(
            n_epochs=settings.epochs,
            on_epoch_end=report,
            progress_bar=False,
            log_interval=10**9,
        )
    return PaperSampler(policy, lowest, highest)


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = new_parser("bc-paper", __doc__)
    add_settings(parser, BcPaperSettings(), SETTABLE)
    return parser


def learn(split: str, command: Command, settings: BcPaperSettings) -> str:
    """Clone and write the policy of a split; return lines about it."""
    shown = demonstrations(command.scene, split=split, observation=OBSERVATION)
    with command.progress(split, settings.epochs, "epochs", "samples") as progress:
        sampler = clone(shown, settings, progress)
    path = command.write(split, sampler, observation=OBSERVATION, noise=NOISE)
    deviation = ", ".join(f"{s:.3f}" for s in (sampler.std * sampler.reach).tolist())
    return f"standard deviations {deviation} of the maximum speed\n{command.walk(path, 'ntpp-gmm')}"


def main(arguments: list[str] | None = None) -> int:
    """Clone and write a policy for each split; return the exit code."""
    asked = command_line().parse_args(arguments)
    settings = BcPaperSettings(seed=asked.seed, **{name: getattr(asked, name) for name in SETTABLE})
    try:
        check_numbers(settings, or_zero=("seed",))
        command = Command.of("bc-paper", asked.scene, asked.splits, asked.out, arguments)
        train_each(learn, command, asked, settings)
    except CrowdbenchError as error:
        print(f"crowdbench.baselines.bc_paper: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    # Worker processes find functions in modules that they can import, which `__main__` is not.
    from .bc_paper import main as imported_main

    sys.exit(imported_main())
