"""PPO with TorchRL: one network controls everyone and learns from all trips.

    python -m baselines.ppo --scene plaza-v0

writes `results/ppo-plaza-v0/full.onnx`. It uses the environment `CrowdEnv`, TorchRL's collector and
clipped loss (Schulman et al. 2017, arXiv:1707.06347), and generalised advantage estimation
(Schulman et al. 2016, arXiv:1506.02438).

Each slot of a world is used by many persons in turn. Training therefore uses the mask and the ends
of trips in `CrowdEnv`. It only learns from steps in which someone acted. An advantage sums the
rewards of a single trip. If a trip is truncated by a timeout or the horizon, its value is
bootstrapped from its own last observation, not from that of the next person in the slot.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from baselines.packages import needs
from crowdbench import Reward, spawn_model
from crowdbench.errors import CrowdbenchError
from crowdbench.registry import DEFAULT_SPAWN

with needs("torchrl", __name__):
    import torch
    from tensordict import TensorDict, TensorDictBase
    from tensordict.nn import (
        NormalParamExtractor,
        ProbabilisticTensorDictSequential,
        TensorDictModule,
    )
    from torch import Tensor, nn
    from torchrl.collectors import Collector
    from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value.functional import vec_generalized_advantage_estimate

    from baselines.command import Command, add_settings, check_numbers, new_parser, use_one_thread
    from crowdbench.envs.torchrl_env import CrowdEnv
    from crowdbench.simulation.observations import GOAL_DIRECTION, OBSERVATION, PREFERRED_SPEED

NOISE = 2
"""Number of normal numbers per action."""


@dataclass(frozen=True)
class Settings:
    """Settings of the training; those in `SETTABLE` are described there."""

    spawn: str = DEFAULT_SPAWN
    worlds: int = 16
    max_alive: int = 50
    frames: int = 320_000
    """Number of training frames, summed over all worlds."""
    batch_frames: int = 1600
    """Number of frames between two updates, summed over all worlds."""
    horizon_s: float = 120.0
    epochs: int = 4
    minibatch: int = 2048
    """Number of steps of single persons in a minibatch."""
    learning_rate: float = 1e-3
    gamma: float = 0.98
    lmbda: float = 0.95
    clip: float = 0.2
    entropy: float = 1e-3
    hidden: int = 64
    seed: int = 0


class Around(nn.Module):
    """Distribution of actions: walking straight to the goal plus the correction of a network."""

    def __init__(self, numbers: int, hidden: int) -> None:
        super().__init__()
        self.layers = _layers(numbers, hidden, 4)
        for parameter in self.layers[-1].parameters():
            nn.init.zeros_(parameter)
        self.split = NormalParamExtractor(scale_mapping="biased_softplus_0.15")

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Location (before tanh) and scale of the actions, each (…, 2)."""
        location, scale = self.split(self.layers(seen))
        straight = seen[..., GOAL_DIRECTION] * seen[..., PREFERRED_SPEED]
        return location + torch.atanh(straight.clamp(-0.99, 0.99)), scale


class Sampler(nn.Module):
    """Computes actions from observations (A, obs) and standard normal numbers (A, 2)."""

    def __init__(self, network: Around) -> None:
        super().__init__()
        self.network = network

    def forward(self, seen: Tensor, noise: Tensor) -> Tensor:
        """Sampled actions (A, 2)."""
        location, scale = self.network(seen)
        return torch.tanh(location + scale * noise)


def _layers(numbers: int, hidden: int, out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(numbers, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(),
        nn.Linear(hidden, out),
    )  # fmt: skip


def advantages(
    batch: TensorDictBase, critic: Callable[[Tensor], Tensor], gamma: float, lmbda: float
) -> tuple[Tensor, Tensor]:
    """Advantages and value targets, each (W, T, N, 1), of a batch (W, T) of `CrowdEnv`."""
    after = batch["next", "agents"]
    with torch.no_grad():
        value = critic(batch["agents", "observation"])
        # In `CrowdEnv`, the next observation of a slot is always that of the same person.
        following = critic(after["observation"])
    by_slot = [
        x.transpose(1, 2)  # (W, N, T, 1)
        for x in (value, following, after["reward"], after["done"], after["terminated"])
    ]
    found = vec_generalized_advantage_estimate(gamma, lmbda, *by_slot, time_dim=-2)
    advantage, target = (x.transpose(1, 2) for x in found)
    return advantage, target


def train(
    scene: str, settings: Settings, reward: Reward | None = None, split: str = "full"
) -> Iterator[tuple[Around, dict[str, float]]]:
    """Train a network; yield it and statistics of the last batch after each update."""
    torch.manual_seed(settings.seed)
    env = CrowdEnv(
        scene,
        spawn=spawn_model(settings.spawn, scene, split),
        worlds=settings.worlds,
        max_alive=settings.max_alive,
        horizon_s=settings.horizon_s,
        observation=OBSERVATION,
        reward=reward,
        seed=settings.seed,
    )
    numbers = env.observation_spec["agents", "observation"].shape[-1]
    network = Around(numbers, settings.hidden)
    keys = {"in_keys": ["loc", "scale"], "distribution_class": TanhNormal}
    of_slots: ProbabilisticTensorDictSequential = ProbabilisticActor(
        TensorDictModule(network, [("agents", "observation")], ["loc", "scale"]),
        out_keys=[("agents", "action")],
        return_log_prob=True,
        log_prob_key="log_prob",
        **keys,
    )
    actor = ProbabilisticActor(
        TensorDictModule(network, ["observation"], ["loc", "scale"]),
        out_keys=["action"],
        return_log_prob=True,
        log_prob_key="log_prob",
        **keys,
    )
    critic = ValueOperator(_layers(numbers, settings.hidden, 1), in_keys=["observation"])
    loss = ClipPPOLoss(
        actor,
        critic,
        clip_epsilon=settings.clip,
        entropy_coeff=settings.entropy,
        normalize_advantage=True,
        loss_critic_type="smooth_l1",
    )
    loss.set_keys(sample_log_prob="log_prob")
    optimizer = torch.optim.Adam(loss.parameters(), settings.learning_rate)
    collector = Collector(
        env,
        of_slots,
        frames_per_batch=settings.batch_frames,
        total_frames=settings.frames,
        auto_register_policy_transforms=False,
    )
    began = time.monotonic()
    for batch in collector:
        collected_s = time.monotonic() - began
        steps = _steps(batch, *advantages(batch, critic.module, settings.gamma, settings.lmbda))
        began = time.monotonic()
        for _ in range(settings.epochs):
            for rows in torch.randperm(len(steps)).split(settings.minibatch):
                losses = loss(steps[rows])
                total = sum(value for name, value in losses.items() if name.startswith("loss_"))
                optimizer.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimizer.step()
        trained_s = time.monotonic() - began
        after = batch["next", "agents"]
        ended = batch["agents", "mask"] & after["done"][..., 0]
        yield (
            network,
            {
                "reward": float(steps["reward"].mean()),
                "at goal": float(after["terminated"][..., 0][ended].float().mean()),
                **_speeds(batch, env.scene.motion.max_speed_mps),
                "agent-steps/s collected": len(steps) / collected_s,
                "agent-steps/s trained": settings.epochs * len(steps) / trained_s,
            },
        )
        began = time.monotonic()
    collector.shutdown()


def _speeds(batch: TensorDictBase, max_speed_mps: float) -> dict[str, float]:
    """Mean speed and mean preferred speed of everyone who acted, in m/s."""
    acted = batch["agents", "mask"]
    walked = batch["next", "agents", "observation"][acted][:, :2].norm(dim=1)
    preferred = batch["agents", "observation"][acted][:, PREFERRED_SPEED]
    return {
        "m/s": float(walked.mean()) * max_speed_mps,
        "m/s preferred": float(preferred.mean()) * max_speed_mps,
    }


def _steps(batch: TensorDictBase, advantage: Tensor, target: Tensor) -> TensorDict:
    """The steps in which someone acted, as one flat batch."""
    acted = batch["agents", "mask"]
    agents = batch["agents"]
    return TensorDict(
        {
            "observation": agents["observation"][acted],
            "action": agents["action"][acted],
            "log_prob": batch["log_prob"][acted],
            "advantage": advantage[acted],
            "value_target": target[acted],
            "reward": batch["next", "agents", "reward"][acted],
        },
        batch_size=[int(acted.sum())],
    )


SETTABLE = {
    "spawn": "spawn model",
    "worlds": "number of parallel worlds",
    "max_alive": "maximum number of people at the same time per world",
    "frames": "number of training frames, summed over all worlds",
    "batch_frames": "number of frames between two updates, summed over all worlds",
    "horizon_s": "length of an episode in seconds",
    "learning_rate": "learning rate of Adam",
}
"""Settings with a command line option, and the help texts of the options."""


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = new_parser("ppo", __doc__)
    add_settings(parser, Settings(), SETTABLE)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Train and write a policy for each split; return the exit code."""
    asked = command_line().parse_args(arguments)
    use_one_thread()
    settings = Settings(**{name: getattr(asked, name) for name in (*SETTABLE, "seed")})
    try:
        check_numbers(settings, or_zero=("gamma", "lmbda", "entropy", "seed"))
        command = Command.of("ppo", asked.scene, asked.splits, asked.out, arguments)
        for split in asked.splits:
            network = None
            rounds = train(asked.scene, settings, split=split)
            for k, (network, figures) in enumerate(rounds, 1):  # noqa: B007
                if k % 20 == 1:
                    said = "  ".join(f"{name} {value:,.3g}" for name, value in figures.items())
                    print(f"{k * settings.batch_frames:9,} frames  {said}", flush=True)
            assert network is not None
            path = command.write(split, Sampler(network), observation=OBSERVATION, noise=NOISE)
            print(f"{path}: {command.walk(path, settings.spawn)}", flush=True)
    except CrowdbenchError as error:
        print(f"baselines.ppo: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
