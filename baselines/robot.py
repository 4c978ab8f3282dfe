"""PPO with Stable-Baselines3: a robot that learns to drive among people.

    python -m crowdbench.baselines.robot --scene eth-v0

writes `results/robot-eth-v0/full.onnx`, which `crowdbench robots --controllers` and
`crowdbench.robot.controllers.controller` take, and compares it with the robot that drives straight.
It uses `RobotVecEnv` and the clipped loss of Stable-Baselines3 (Schulman et al. 2017,
arXiv:1707.06347).

As the robots of CrowdNav (Chen et al. 2019, ICRA, 6015-6022), which begin as clones of ORCA, the
network first imitates a controller (`imitate`), here the dynamic window: where the network drives
itself, it is shown what that controller would do (DAgger: Ross, Gordon & Bagnell 2011, AISTATS).
The same layers encode each of the nearest people, and the maximum over people goes on, beside what
the robot knows of itself and of walls (`SocialFeatures`).
"""

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.errors import CrowdbenchError
from crowdbench.policies.network import check_onnx
from crowdbench.report.text.terminal import print_note, print_table
from crowdbench.robot.comparison import compare, printed
from crowdbench.robot.controllers import controller
from crowdbench.robot.network import export_robot
from crowdbench.robot.observing import FASTEST_MPS, OF_PERSON, OWN, PROBES
from crowdbench.robot.worlds import RobotWorlds

from .packages import needs

with needs("sb3", __name__):
    import torch
    from gymnasium import spaces
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import Tensor, nn

    from crowdbench.robot.sb3 import RobotVecEnv

    from .command import Command, add_settings, check_numbers, use_one_thread

PROGRAM = "crowdbench.baselines.robot"
SPLIT = "full"
"""Arrivals are those of the whole recording."""
SELF = OWN + PROBES
"""Number of values of `social` about the robot, its path and walls, which come first."""
RANGE_M = 10.0
"""Range of the observation, the default of `RobotConfig`."""
TURN = 2.0
"""Turn rate per sine of the angle to the path, both as shares of the largest, in the beginning."""
LOOK_AHEAD_S = 4.0
"""Closest approaches are looked for in this time."""
CLONING_RATE, CLONING_EPOCHS, CLONING_MINIBATCH = 1e-3, 4, 512
TRAINING_SEED = 1_000_000
"""Added to the seed of a training, so that its episodes are not those of comparisons."""


@dataclass(frozen=True)
class RobotSettings:
    """Settings of the training; those in `SETTABLE` are described there."""

    robot: str = "delivery"
    walkers: str = "social-force"
    teacher: str = "dwa"
    rounds: int = 8
    worlds: int = 64
    steps: int = 300_000
    """Number of actions, summed over all worlds."""
    batch_steps: int = 64
    """Number of actions in each world between two updates."""
    minibatch: int = 1024
    epochs: int = 6
    learning_rate: float = 3e-4
    """Initial learning rate of Adam; it decreases to 0."""
    gamma: float = 0.98
    std: float = 0.2
    """Initial standard deviation of actions."""
    hidden: int = 64
    episodes: int = 200
    """Number of episodes in which the robot is compared with the straight one."""
    seed: int = 0


class SocialFeatures(BaseFeaturesExtractor):
    """The first layers of the networks of `RobotPolicy`: from the observation `social` to features.

    The features (W, 2 + hidden) are the direction of the path and what two layers make of the rest.
    """

    def __init__(self, space: spaces.Box, hidden: int = 64) -> None:
        super().__init__(space, 2 + hidden)
        width = hidden // 2
        self.encode = nn.Sequential(
            nn.Linear(9 + OWN, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.layers = nn.Sequential(
            nn.Linear(SELF + width, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh()
        )

    def forward(self, seen: Tensor) -> Tensor:
        """Features of observations (W, numbers)."""
        own, people = seen[:, :SELF], seen[:, SELF:].unflatten(1, (-1, OF_PERSON))
        position, velocity = people[..., :2] * RANGE_M, people[..., 2:4] * FASTEST_MPS
        gap, there = people[..., 4:5] * RANGE_M, people[..., 5:]
        # The time and the distance of the closest approach if both keep their velocities.
        closing = -(position * velocity).sum(-1, keepdim=True)
        squared = (velocity * velocity).sum(-1, keepdim=True)
        time_s = (closing / (squared + 1e-3)).clamp(0.0, LOOK_AHEAD_S)
        near = (position + velocity * time_s).norm(dim=-1, keepdim=True)
        robot = own[:, None, :OWN].expand(-1, people.shape[1], -1)
        scaled = (position / 3, velocity / 1.5, time_s / 2, near / 2)
        close = (torch.exp(-gap), torch.exp(-near), torch.exp(-time_s))
        encoded = self.encode(torch.cat([*scaled, *close, robot], -1)) * there
        layers = self.layers(torch.cat([own, encoded.amax(1)], 1))
        return torch.cat([own[:, :2], layers], 1)


class RobotPolicy(ActorCriticPolicy):
    """A policy of Stable-Baselines3 that begins as a robot which drives along its path.

    The mean action is linear in the direction of the path and in the features, whose weights are
    nearly 0 at first: the training need not discover where the goal is.
    """

    def __init__(self, *args: Any, hidden: int = 64, **kwargs: Any) -> None:
        super().__init__(
            *args,
            features_extractor_class=SocialFeatures,
            features_extractor_kwargs={"hidden": hidden},
            share_features_extractor=False,
            net_arch={"pi": [], "vf": [hidden]},
            **kwargs,
        )

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        with torch.no_grad():
            self.action_net.weight[0, 0] = 1.0  # ahead, the faster the better it faces the path
            self.action_net.weight[1, 1] = TURN


def imitate(model: PPO, teacher: str = "dwa", rounds: int = 8, steps: int = 64) -> float:
    """Let a model drive like a controller, before it learns by the reward.

    In the first round the controller drives, afterwards the model. After each round of `steps`
    actions per world, the mean actions are fitted to all that the controller has shown.

    Returns:
        The mean squared deviation of the actions of the last round from those shown, before it was
        fitted.

    Raises:
        SettingError: there is no such controller.
    """
    env, policy = model.get_env(), model.policy
    worlds: RobotWorlds = env.worlds
    driver = controller(teacher, worlds.scene)
    driver.reset(worlds.scene, worlds.robot, worlds.worlds, worlds.period_s)
    optimizer = torch.optim.Adam(policy.parameters(), CLONING_RATE)
    seen, shown, deviation = [], [], 0.0
    observation = env.reset()
    for k in range(rounds):
        off = []
        for _ in range(steps):
            seen.append(observation)
            shown.append(driver.act(worlds.view))
            action, _ = model.predict(observation, deterministic=True)
            off.append(float(((action - shown[-1]) ** 2).mean()))
            observation, *_ = env.step(action if k else shown[-1])
        deviation = sum(off) / steps
        x, y = (torch.as_tensor(np.concatenate(of)) for of in (seen, shown))
        for _ in range(CLONING_EPOCHS):
            for some in torch.randperm(len(x)).split(CLONING_MINIBATCH):
                mean = policy.get_distribution(x[some]).distribution.mean
                loss = ((mean - y[some]) ** 2).mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
    return deviation


class Report(BaseCallback):
    """Reports the episodes that ended since the last update."""

    def __init__(self, command: Command, settings: RobotSettings) -> None:
        super().__init__()
        self.progress_of = command.progress("robot", settings.steps, "steps", "steps")
        self._ended: list[dict[str, Any]] = []
        self._before = 0

    def _on_step(self) -> bool:
        self._ended += [info for info in self.locals["infos"] if "success" in info]
        return True

    def _on_rollout_end(self) -> None:
        count = max(1, len(self._ended))
        names = {"success": "success", "hits person": "collision_person", "s": "time_s"}
        figures = {
            title: sum(info[name] for info in self._ended) / count for title, name in names.items()
        }
        self.progress_of(self.num_timesteps, self.num_timesteps - self._before, figures)
        self._before, self._ended = self.num_timesteps, []


def train(command: Command, settings: RobotSettings) -> PPO:
    """Train a robot in the worlds of a scene."""
    env = RobotVecEnv(
        command.scene, settings.worlds, robot=settings.robot, walkers=settings.walkers,
        seed=TRAINING_SEED + settings.seed,
    )  # fmt: skip
    model = PPO(
        RobotPolicy,
        env,
        n_steps=settings.batch_steps,
        batch_size=settings.minibatch,
        n_epochs=settings.epochs,
        gamma=settings.gamma,
        learning_rate=lambda left: settings.learning_rate * left,
        policy_kwargs={"hidden": settings.hidden, "log_std_init": math.log(settings.std)},
        seed=settings.seed,
        device="cpu",
    )
    deviation = imitate(model, settings.teacher, settings.rounds)
    print(f"imitates {settings.teacher}: mean squared deviation {deviation:.3f}", flush=True)
    report = Report(command, settings)
    with report.progress_of:
        model.learn(settings.steps, callback=report)
    return model


SETTABLE = {
    "robot": "the robot, by the name of a preset",
    "walkers": "how people walk: a policy by name",
    "teacher": "the controller that is imitated first",
    "rounds": "number of rounds of imitation, each of 64 actions per world",
    "worlds": "number of parallel worlds",
    "steps": "number of actions of the robots, summed over all worlds",
    "batch_steps": "number of actions in each world between two updates",
    "minibatch": "number of actions in a minibatch",
    "epochs": "number of passes over the actions of an update",
    "learning_rate": "initial learning rate of Adam; it decreases to 0",
    "std": "initial standard deviation of actions",
    "episodes": "number of episodes of the comparison after the training",
}
"""Settings with a command line option, and the help texts of the options."""


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--scene", required=True, help="id of a scene, or its folder")
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="random seed (default: %(default)s)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="output folder (default: results/robot-SCENE)"
    )
    add_settings(parser, RobotSettings(), SETTABLE)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Train a robot, write its network, and compare it; return the exit code."""
    asked = command_line().parse_args(arguments)
    settings = RobotSettings(**{name: getattr(asked, name) for name in (*SETTABLE, "seed")})
    try:
        check_numbers(settings, or_zero=("seed",))
        check_onnx("onnxscript")  # needed after the training
        command = Command.of("robot", asked.scene, [SPLIT], asked.out, arguments)
        use_one_thread()
        model = train(command, settings)
        worlds = model.get_env().worlds
        path = export_robot(model, command.path(SPLIT), worlds, command=command.line)
        print(f"written: {path}")
        columns, rows, note = printed(
            compare(
                command.scene, ["straight", str(path)], episodes=settings.episodes,
                config=worlds.config, workers=1,
            )
        )  # fmt: skip
        print_table(*columns, rows=rows)
        print_note(note)
    except CrowdbenchError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
