"""PPO with TorchRL: one network walks everyone, and learns from all of their lives.

    python -m baselines.ppo --scene plaza-v0

writes `results/ppo-plaza-v0/full.onnx`. The worlds are TorchRL's environment `CrowdEnv`, walked by
TorchRL's collector and improved by its clipped loss (Schulman et al. 2017, arXiv:1707.06347) with
generalised advantages (Schulman et al. 2016, arXiv:1506.02438).

A slot of a world is many persons, one after the other. What makes that right is the mask and the
ends of lives in `CrowdEnv`: only steps in which someone acted are learned from, an advantage sums
rewards of one life, and the value after a life that was cut off (by a timeout or the horizon) is
that of its own last observation, never of whoever came into the slot next.
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
    from crowdbench.simulation.observations import OBSERVATION

NOISE = 2


@dataclass(frozen=True)
class Settings:
    """How a policy is trained."""

    spawn: str = DEFAULT_SPAWN
    worlds: int = 16
    max_alive: int = 50
    frames: int = 320_000
    """World frames to train for, all worlds together."""
    batch_frames: int = 1600
    """World frames between two improvements."""
    horizon_s: float = 120.0
    epochs: int = 4
    minibatch: int = 2048
    """Steps of persons."""
    learning_rate: float = 1e-3
    gamma: float = 0.98
    lmbda: float = 0.95
    clip: float = 0.2
    entropy: float = 1e-3
    hidden: int = 64
    seed: int = 0


class Around(nn.Module):
    """The first guess: towards the goal at the preferred speed; a network says what else."""

    def __init__(self, numbers: int, hidden: int) -> None:
        super().__init__()
        self.layers = _layers(numbers, hidden, 4)
        for parameter in self.layers[-1].parameters():
            nn.init.zeros_(parameter)
        self.split = NormalParamExtractor(scale_mapping="biased_softplus_0.15")

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Location before the squashing, and scale."""
        location, scale = self.split(self.layers(seen))
        straight = seen[..., 3:5] * seen[..., 5:6]
        return location + torch.atanh(straight.clamp(-0.99, 0.99)), scale


class Sampler(nn.Module):
    """Actions as a function of observations (A, obs) and normal numbers (A, 2)."""

    def __init__(self, network: Around) -> None:
        super().__init__()
        self.network = network

    def forward(self, seen: Tensor, noise: Tensor) -> Tensor:
        """Actions (A, 2)."""
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
    """Advantages and targets of the values, (W, T, N, 1), of a batch (W, T) of `CrowdEnv`."""
    after = batch["next", "agents"]
    with torch.no_grad():
        value = critic(batch["agents", "observation"])
        # Of one life alone: a slot's next observation is never that of its next person.
        following = critic(after["observation"])
    by_slot = [
        x.transpose(1, 2)  # (W, N, T, 1)
        for x in (value, following, after["reward"], after["done"], after["terminated"])
    ]
    found = vec_generalized_advantage_estimate(gamma, lmbda, *by_slot, time_dim=-2)
    advantage, target = (x.transpose(1, 2) for x in found)
    return advantage, target


def train(
    scene: str, settings: Settings, reward: Reward | None = None, part: str = "full"
) -> Iterator[tuple[Around, dict[str, float]]]:
    """Yield the network and figures of what it did after each improvement."""
    torch.manual_seed(settings.seed)
    env = CrowdEnv(
        scene,
        spawn=spawn_model(settings.spawn, scene, part),
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
    """Mean speed walked and mean preferred speed of those who acted, m/s."""
    acted = batch["agents", "mask"]
    walked = batch["next", "agents", "observation"][acted][:, :2].norm(dim=1)
    preferred = batch["agents", "observation"][acted][:, 5]
    return {
        "m/s": float(walked.mean()) * max_speed_mps,
        "m/s preferred": float(preferred.mean()) * max_speed_mps,
    }


def _steps(batch: TensorDictBase, advantage: Tensor, target: Tensor) -> TensorDict:
    """The steps in which someone acted."""
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
    "spawn": "spawn model that lets people in",
    "worlds": "crowds side by side",
    "max_alive": "persons that a world has room for",
    "frames": "frames to train for, those of all worlds together",
    "batch_frames": "frames between two improvements, those of all worlds together",
    "horizon_s": "length of an episode, in seconds",
    "learning_rate": "Adam's",
}
"""Settings that the command line takes, and what it says of them."""


def command_line() -> argparse.ArgumentParser:
    """The options of this script."""
    parser = new_parser("ppo", __doc__)
    add_settings(parser, Settings(), SETTABLE)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Train and write a policy."""
    asked = command_line().parse_args(arguments)
    use_one_thread()
    settings = Settings(**{name: getattr(asked, name) for name in (*SETTABLE, "seed")})
    try:
        check_numbers(settings, or_zero=("gamma", "lmbda", "entropy", "seed"))
        command = Command.of("ppo", asked.scene, asked.parts, asked.out, arguments)
        for part in asked.parts:
            network = None
            rounds = train(asked.scene, settings, part=part)
            for k, (network, figures) in enumerate(rounds, 1):  # noqa: B007
                if k % 20 == 1:
                    said = "  ".join(f"{name} {value:,.3g}" for name, value in figures.items())
                    print(f"{k * settings.batch_frames:9,} frames  {said}", flush=True)
            assert network is not None
            path = command.write(part, Sampler(network), observation=OBSERVATION, noise=NOISE)
            print(f"{path}: {command.walk(path, settings.spawn)}", flush=True)
    except CrowdbenchError as error:
        print(f"baselines.ppo: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
