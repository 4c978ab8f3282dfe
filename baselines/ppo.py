"""PPO with TorchRL: one network controls everyone and learns from all trips.

    python -m crowdbench.baselines.ppo --scene plaza-v0

writes `results/ppo-plaza-v0/full.onnx`. It uses the environment `CrowdEnv`, TorchRL's collector and
clipped loss (Schulman et al. 2017, arXiv:1707.06347), and generalised advantage estimation
(Schulman et al. 2016, arXiv:1506.02438).

Each slot of a world is used by many persons in turn. Training therefore uses the mask and the ends
of trips in `CrowdEnv`. It only learns from steps in which someone acted. An advantage sums the
rewards of a single trip. If a trip is truncated by a timeout or the horizon, its value is
bootstrapped from its own last observation, not from that of the next person in the slot.

`--device cuda` keeps observations and networks on a GPU; the simulation runs on the CPU, with as
many threads as `NUMBA_NUM_THREADS` says. `--collectors 4` divides the worlds among four processes,
in each of which a copy of the network acts on the CPU.
"""

import argparse
import sys
from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial

import numpy as np

from crowdbench import Reward, reference_rewards, spawn_model
from crowdbench.errors import CrowdbenchError, SettingError
from crowdbench.registry import DEFAULT_SPAWN
from crowdbench.scene import Scene

from .packages import needs

with needs("torchrl", __name__):
    import torch
    from tensordict import TensorDict, TensorDictBase
    from tensordict.nn import NormalParamExtractor, TensorDictModule
    from torch import Tensor, nn
    from torchrl.collectors import BaseCollector, Collector, MultiSyncCollector
    from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value.functional import generalized_advantage_estimate

    from crowdbench.envs.torchrl_env import CrowdEnv
    from crowdbench.simulation import observations, social
    from crowdbench.simulation.observations import EXTENDED, OBSERVATION, version_of
    from crowdbench.spawn.recorded_plans import VISIT_M

    from .command import (
        Command,
        add_settings,
        check_device,
        check_numbers,
        new_parser,
        train_each,
    )

NOISE = 2
"""Number of normal numbers per action."""
OBSERVATIONS = ("lidar-2", "lidar-3", "social-1", *EXTENDED)
"""Observations that a policy can be trained on: those with the preferred speed."""
VELOCITY = slice(0, 2)
"""Velocity / max_speed, in all of them."""


@dataclass(frozen=True)
class PpoSettings:
    """Settings of the training; those in `SETTABLE` are described there."""

    spawn: str = DEFAULT_SPAWN
    observation: str = OBSERVATION
    worlds: int = 64
    max_alive: int = 50
    frames: int = 640_000
    """Number of training frames, summed over all worlds."""
    batch_frames: int = 6400
    """Number of frames between two updates, summed over all worlds."""
    horizon_s: float = 120.0
    epochs: int = 3
    minibatch: int = 4096
    """Number of steps of single persons in a minibatch."""
    learning_rate: float = 1e-3
    """Initial learning rate of Adam; it decreases to 0."""
    gamma: float = 0.98
    lmbda: float = 0.95
    clip: float = 0.2
    std: float = 0.03
    """Initial standard deviation of actions."""
    hidden: int = 64
    device: str = "cpu"
    collectors: int = 1
    """Number of processes that collect batches; 1: this process does."""
    seed: int = 0


class Around(nn.Module):
    """Distribution of actions: walking straight to the target plus the correction of a network."""

    def __init__(self, observation: str, numbers: int, hidden: int, std: float) -> None:
        super().__init__()
        self.social = version_of(observation).own_frame
        self.layers = _layers(numbers, hidden, 4)
        for parameter in self.layers[-1].parameters():
            nn.init.zeros_(parameter)
        self.split = NormalParamExtractor(scale_mapping=f"biased_softplus_{std}")

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the actions, each (…, 2)."""
        correction, scale = self.split(self.layers(seen))
        return self.straight(seen) + correction, scale

    def straight(self, seen: Tensor) -> Tensor:
        """Actions (…, 2) that walk to the target at the preferred speed, and stand at stops."""
        if not self.social:
            return seen[..., observations.GOAL_DIRECTION] * seen[..., observations.PREFERRED_SPEED]
        near = seen[..., social.ROUTE_LENGTH] * social.ROUTE_RANGE_M <= VISIT_M
        walks = 1 - seen[..., social.STOP] * near
        return walks * seen[..., social.ROUTE_DIRECTION] * seen[..., social.PREFERRED_SPEED]


class GaussianSampler(nn.Module):
    """Computes actions from observations (A, obs) and standard normal numbers (A, 2)."""

    def __init__(self, network: Around) -> None:
        super().__init__()
        self.network = network

    def forward(self, seen: Tensor, noise: Tensor) -> Tensor:
        """Sampled actions (A, 2)."""
        mean, std = self.network(seen)
        return mean + std * noise


class OfPresent(nn.Module):
    """Samples actions of the people in occupied slots, few of which are on most scenes."""

    def __init__(self, network: Around) -> None:
        super().__init__()
        self.network = network

    def forward(self, seen: Tensor, mask: Tensor) -> Tensor:
        """Actions (W, N, 2) for observations (W, N, obs); 0 in empty slots."""
        actions = seen.new_zeros((*mask.shape, 2))
        actions[mask] = torch.normal(*self.network(seen[mask]))
        return actions


def _layers(numbers: int, hidden: int, out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(numbers, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(),
        nn.Linear(hidden, out),
    )  # fmt: skip


def advantages(
    batch: TensorDictBase, critic: Callable[[Tensor], Tensor], gamma: float, lmbda: float
) -> tuple[Tensor, Tensor]:
    """Advantages and value targets, each (W, T, N, 1), of a batch (W, T) of `CrowdEnv`."""
    acted, after = batch["agents", "mask"], batch["next", "agents"]
    value = torch.zeros_like(after["reward"])
    following = torch.zeros_like(value)
    with torch.no_grad():
        value[acted] = critic(batch["agents", "observation"][acted])
        # Whoever acts next in a slot is the same person, unless its trip has ended.
        following[:, :-1] = value[:, 1:]
        last = after["truncated"][..., 0].clone()
        last[:, -1] = True
        last &= acted
        following[last] = critic(after["observation"][last])
    # TorchRL's vectorised estimate took most of the training, because many trips end in a batch.
    advantage, target = generalized_advantage_estimate(
        gamma, lmbda, value, following, after["reward"], after["done"], after["terminated"],
        time_dim=1,
    )  # fmt: skip
    return advantage, target


@dataclass(frozen=True)
class Round:
    """A batch of steps and the update of the network by it."""

    network: Around
    frames: int
    """Number of frames so far, summed over all worlds."""
    steps: int
    """Number of steps of single persons in the batch."""
    figures: dict[str, float]
    """Means over the batch: reward per step, share of trips that end at the goal, and speeds."""


class Learner:
    """Network, critic and optimizer."""

    def __init__(self, numbers: int, settings: PpoSettings) -> None:
        self.settings = settings
        self.network = Around(settings.observation, numbers, settings.hidden, settings.std)
        self.network.to(settings.device)
        self.actor = ProbabilisticActor(
            TensorDictModule(self.network, ["observation"], ["loc", "scale"]),
            in_keys=["loc", "scale"],
            out_keys=["action"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
            log_prob_key="log_prob",
        )
        layers = _layers(numbers, settings.hidden, 1).to(settings.device)
        critic = ValueOperator(layers, in_keys=["observation"])
        self.critic = critic.module
        self.loss = ClipPPOLoss(
            self.actor,
            critic,
            clip_epsilon=settings.clip,
            entropy_bonus=False,
            normalize_advantage=True,
            loss_critic_type="smooth_l1",
        )
        self.loss.set_keys(sample_log_prob="log_prob")
        self.optimizer = torch.optim.Adam(
            self.loss.parameters(), settings.learning_rate, fused=True
        )

    def learn(self, batch: TensorDictBase, progress: float) -> int:
        """Update the networks by a batch, and return the number of steps of single persons in it.

        `progress` is the share of the training that is done, 0 to 1.
        """
        settings = self.settings
        for group in self.optimizer.param_groups:
            group["lr"] = settings.learning_rate * (1 - progress)
        found = advantages(batch, self.critic, settings.gamma, settings.lmbda)
        steps = steps_of(batch, *found)
        with torch.no_grad():
            steps["log_prob"] = self.actor.get_dist(steps).log_prob(steps["action"])
        # Shuffled once, because gathering rows takes about as long as learning from them.
        steps = steps[torch.randperm(len(steps), device=steps.device)]
        for _ in range(settings.epochs):
            for some in steps.split(settings.minibatch):
                losses = self.loss(some)
                self.optimizer.zero_grad()
                (losses["loss_objective"] + losses["loss_critic"]).backward()
                nn.utils.clip_grad_norm_(self.loss.parameters(), 1.0)
                self.optimizer.step()
        return len(steps)


def train(
    scene: str | Scene, settings: PpoSettings, reward: Reward | None = None, split: str = "full"
) -> Generator[Round, None, None]:
    """Train a network; yield it after each update, with figures of the last batch."""
    check_device(settings.device)
    if settings.worlds % settings.collectors:
        raise SettingError(
            "collectors",
            got=f"{settings.collectors}, which do not share {settings.worlds} worlds equally",
            expected="a divisor of the number of worlds",
        )
    torch.manual_seed(settings.seed)
    make = partial(_environment, scene, settings, reward, split)
    # The seed of the only collector is that of the settings, those of several are drawn from it.
    seeds = np.random.SeedSequence(settings.seed).generate_state(settings.collectors).tolist()
    env = make(settings.seed if settings.collectors == 1 else seeds[0])
    learner = Learner(env.observation_spec["agents", "observation"].shape[-1], settings)
    seen = [("agents", "observation"), ("agents", "mask")]
    policy = TensorDictModule(OfPresent(learner.network), seen, [("agents", "action")])
    common = {
        "frames_per_batch": settings.batch_frames,
        "total_frames": settings.frames,
        "auto_register_policy_transforms": False,
    }
    collector: BaseCollector
    if settings.collectors == 1:
        collector = Collector(
            env,
            policy,
            track_traj_ids=False,  # a world is not a trip
            return_same_td=True,  # no copies, because each batch is used before the next one
            **common,
        )
    else:
        collector = MultiSyncCollector(
            [partial(make, seed) for seed in seeds],
            policy,
            policy_device="cpu",
            use_buffers=True,
            cat_results=0,  # the worlds of all processes are one batch
            update_at_each_batch=True,
            **common,
        )
    frames = 0
    try:
        for collected in collector:
            batch = collected.to(settings.device)
            steps = learner.learn(batch, frames / settings.frames)
            frames += batch.numel()
            figures = _figures(batch, settings.observation, env.scene.motion.max_speed_mps)
            yield Round(learner.network, frames, steps, figures)
    finally:
        collector.shutdown()


def _environment(
    scene: str | Scene, settings: PpoSettings, reward: Reward | None, split: str, seed: int
) -> CrowdEnv:
    """The environment of one collector, with its share of the worlds."""
    return CrowdEnv(
        scene,
        spawn=spawn_model(settings.spawn, scene, split),
        worlds=settings.worlds // settings.collectors,
        max_alive=settings.max_alive,
        on_full="drop",
        horizon_s=settings.horizon_s,
        observation=settings.observation,
        reward=reward or Reward(),
        seed=seed,
        device=settings.device if settings.collectors == 1 else "cpu",
    )


def _figures(batch: TensorDictBase, observation: str, max_speed_mps: float) -> dict[str, float]:
    acted, after = batch["agents", "mask"], batch["next", "agents"]
    ended = acted & after["done"][..., 0]
    wish = social if version_of(observation).own_frame else observations
    speed = after["observation"][..., VELOCITY].norm(dim=-1)[acted]
    preferred = batch["agents", "observation"][..., wish.PREFERRED_SPEED][acted]
    return {
        "reward": float(after["reward"][acted].mean()),
        "at goal": float(after["terminated"][..., 0][ended].float().mean()),
        "m/s": float(speed.mean()) * max_speed_mps,
        "m/s preferred": float(preferred.mean()) * max_speed_mps,
    }


def steps_of(batch: TensorDictBase, advantage: Tensor, target: Tensor) -> TensorDict:
    """The steps in which someone acted, as one flat batch."""
    acted = batch["agents", "mask"]
    agents = batch["agents"]
    return TensorDict(
        {
            "observation": agents["observation"][acted],
            "action": agents["action"][acted],
            "advantage": advantage[acted],
            "value_target": target[acted],
        },
        batch_size=[int(acted.sum())],
    )


SETTABLE = {
    "spawn": "spawn model",
    "std": "initial standard deviation of actions, in units of the maximum speed",
    "worlds": "number of parallel worlds",
    "max_alive": "maximum number of people at the same time per world",
    "frames": "number of training frames, summed over all worlds",
    "batch_frames": "number of frames between two updates, summed over all worlds",
    "minibatch": "number of steps of single persons in a minibatch",
    "horizon_s": "length of an episode in seconds",
    "learning_rate": "initial learning rate of Adam; it decreases to 0",
    "collectors": "number of processes that collect batches, each with its share of the worlds",
    "device": "device of observations and networks: cpu or cuda",
}
"""Settings with a command line option, and the help texts of the options."""


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = new_parser("ppo", __doc__)
    parser.add_argument(
        "--observation",
        choices=OBSERVATIONS,
        default=OBSERVATION,
        help="observation of the policy; social-1 shows stops and companions, which the spawn "
        "models cox-plans and ntpp-plans send, and those with `contact` what bodies kept a person "
        "from walking, which a scene with body_radius_m needs (default: %(default)s)",
    )
    add_settings(parser, PpoSettings(), SETTABLE)
    return parser


def learn(split: str, command: Command, settings: PpoSettings) -> str:
    """Train and write the policy of a split; return a line about it."""
    print(f"reward per step of others: {_others(command.scene, settings, split)}", flush=True)
    with command.progress(split, settings.frames, "frames", "agent-steps") as progress:
        for last in train(command.scene, settings, split=split):
            progress(last.frames, last.steps, last.figures)
    network = GaussianSampler(last.network).to("cpu")
    path = command.write(split, network, observation=settings.observation, noise=NOISE)
    return str(command.walk(path, settings.spawn))


def _others(scene: str | Scene, settings: PpoSettings, split: str) -> str:
    """What shipped policies earn in the environment of a training."""
    earned = reference_rewards(
        scene,
        spawn=spawn_model(settings.spawn, scene, split),
        max_alive=settings.max_alive,
        on_full="drop",
        horizon_s=settings.horizon_s,
        observation=settings.observation,
        seed=settings.seed,
    )
    return ", ".join(f"{name} {each.per_step:.3g}" for name, each in earned.items())


def main(arguments: list[str] | None = None) -> int:
    """Train and write a policy for each split; return the exit code."""
    asked = command_line().parse_args(arguments)
    settings = PpoSettings(
        **{name: getattr(asked, name) for name in (*SETTABLE, "observation", "seed")}
    )
    try:
        check_numbers(settings, or_zero=("gamma", "lmbda", "seed"))
        command = Command.of("ppo", asked.scene, asked.splits, asked.out, arguments)
        if settings.collectors > 1 and (asked.workers or 1) > 1:
            raise SettingError(
                "workers",
                got=f"{asked.workers} with {settings.collectors} collectors",
                expected="several of one of them only",
            )
        train_each(learn, command, asked, settings)
    except CrowdbenchError as error:
        print(f"crowdbench.baselines.ppo: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    # Worker processes find functions in modules that they can import, which `__main__` is not.
    from .ppo import main as imported_main

    sys.exit(imported_main())
