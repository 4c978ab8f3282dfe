"""GAIL: walk so that a discriminator cannot tell it from recorded people, with `imitation`.

    python -m baselines.gail --scene eth-v0

writes `results/gail-eth-v0/full.onnx`, and `full.csv` with the curves of the training. Generative
adversarial imitation learning is Ho & Ermon (2016), NeurIPS; the walkers are improved by PPO.

Lives differ in length, and a reward that is always positive, as GAIL's −log(1 − D), pays people
for staying, one that is always negative for leaving (Kostrikov et al. 2019, Discriminator-Actor-
Critic, ICLR, sec. 4.1). So the reward here is their difference log D − log(1 − D), as in Fu et al.
(2018, AIRL, ICLR): where the discriminator is at a loss it is zero, and nobody gains by the length
of a life. That is what `imitation`'s `allow_variable_horizon` is set for.

Everyone in the crowd is walked by the policy that is being trained; the persons of the
sub-environments are those it learns from.

PPO moves the mean of a narrow Gaussian by more than it is wide, and walkers who kept their velocity
exactly, as recorded people do between two annotations, no longer do. Where that matters, they are
shown recorded people between the rounds as in cloning (`--reminders`; Jena et al. 2020, Augmenting
GAIL with BC for Sample Efficient Imitation Learning, CoRL).
"""

import argparse
import csv
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, islice, repeat
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from baselines.packages import needs
from crowdbench import Demonstrations, demonstrations, spawn_model
from crowdbench.errors import CrowdbenchError
from crowdbench.files import replacing
from crowdbench.registry import DEFAULT_SPAWN
from crowdbench.scene import Scene

with needs("imitation", __name__):
    import torch
    from imitation.algorithms.adversarial.gail import GAIL
    from imitation.rewards.reward_nets import RewardNet
    from imitation.util import logger
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnvWrapper
    from torch import Tensor, nn

    from baselines import bc
    from baselines.command import Command, add_settings, check_numbers, new_parser, use_one_thread
    from baselines.mixture import BOUNDS, NOISE, MixturePolicy, Sampler
    from crowdbench.envs.vec_env import LivesVecEnv

CHANGES = 10.0
"""How much larger the discriminator sees changes of velocity, which are small, than velocities."""
AGAINST = 10.0
"""Log-odds against those who walk out of the bounds."""


@dataclass(frozen=True)
class Settings:
    """How a policy is trained; how it is cloned first stands in `baselines.bc`."""

    spawn: str = DEFAULT_SPAWN
    observation: str = bc.OBSERVATIONS[0]
    persons: int = 64
    """Sub-environments."""
    steps: int = 500_000
    """Of persons, all together."""
    horizon_s: float = 120.0
    round_steps: int = 64
    """Steps of each person between two improvements."""
    ppo_epochs: int = 5
    learning_rate: float = 1e-4
    reminders: int = 0
    """Batches of recorded people from whom it clones anew after each improvement."""
    clip: float = 0.1
    gamma: float = 0.95
    discriminator: int = 64
    """Width of its two layers."""
    discriminator_rate: float = 1e-3
    discriminator_updates: int = 8
    discriminator_batch: int = 512


class Discriminator(RewardNet):
    """Log-odds that a person who does this in this situation is a recorded one.

    Where they see the bounds it need not learn that nobody recorded walks out of them: so rare an
    end, even if it is one life in ten, it would learn too slowly.
    """

    def __init__(
        self, observation_space: Any, action_space: Any, hidden: int, *, bounds: bool
    ) -> None:
        super().__init__(observation_space, action_space)
        self.bounds = bounds
        numbers = observation_space.shape[0] + 4
        self.layers = nn.Sequential(
            nn.Linear(numbers, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(),
            nn.Linear(hidden, 1),
        )  # fmt: skip

    def forward(self, state: Tensor, action: Tensor, next_state: Tensor, done: Tensor) -> Tensor:
        """Of states (A, obs) and actions (A, 2); shape (A,)."""
        change = CHANGES * (action - state[:, :2])
        odds = self.layers(torch.cat([state, action, change], dim=1))[:, 0]
        if not self.bounds:
            return odds
        return odds - AGAINST * (next_state[:, BOUNDS] <= 0).any(dim=1)


class FairGAIL(GAIL):
    """GAIL whose reward is log D − log(1 − D): the discriminator's log-odds as they are."""

    @property
    def reward_train(self) -> RewardNet:
        """The discriminator."""
        return self._reward_net


class Learner:
    """The policy under training as a walker of everyone else."""

    name = "learner"
    sees: ClassVar[Literal["observation"]] = "observation"

    def __init__(self, policy: MixturePolicy, observation: str) -> None:
        self.sampler = Sampler(policy)
        self.observation = observation

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        """Draw from `rng` from now on."""
        self._rng = rng

    def act(self, seen: np.ndarray) -> np.ndarray:
        """One action per observation."""
        noise = self._rng.standard_normal((len(seen), NOISE), dtype=np.float32)
        with torch.no_grad():
            return self.sampler(torch.from_numpy(seen), torch.from_numpy(noise)).numpy()


class Outcomes(VecEnvWrapper):
    """Counts how lives end, and how fast people walk."""

    def __init__(self, venv: LivesVecEnv) -> None:
        super().__init__(venv)
        self.ended: Counter[str] = Counter()
        self.speeds: list[float] = []

    def reset(self) -> Any:
        """Pass it on."""
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Count, and pass it on."""
        seen, rewards, dones, infos = self.venv.step_wait()
        self.ended.update(info["outcome"] for info in infos if "outcome" in info)
        goes_on = seen[~dones]
        if len(goes_on):
            self.speeds.append(float(np.linalg.norm(goes_on[:, :2], axis=1).mean()))
        return seen, rewards, dones, infos


def experts(shown: Demonstrations, size: int, rng: np.random.Generator) -> bc.Batches:
    """Batches of recorded transitions."""
    acted = ~np.isnan(shown.actions[:, 0])
    after = np.flatnonzero(acted) + 1
    return bc.Batches(
        {
            "obs": shown.observations[acted],
            "acts": shown.actions[acted],
            "next_obs": shown.observations[after],
            "dones": ~acted[after],
        },
        size,
        rng,
    )


def remind(policy: MixturePolicy, lessons: Iterator[Mapping[str, Tensor]], times: int) -> None:
    """Make what recorded people did likelier, a batch at a time."""
    for batch in islice(lessons, times):
        loss = -policy.get_distribution(batch["obs"]).log_prob(batch["acts"]).mean()
        policy.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        policy.optimizer.step()


def train(
    scene: str,
    part: str,
    policy: MixturePolicy,
    settings: Settings,
    seed: int,
    lessons: Iterable[Mapping[str, Tensor]] = (),
) -> Iterator[dict[str, float]]:
    """Improve the policy in place; yields figures after each round.

    `lessons` are what it is reminded of: batches of `obs` and `acts`, without an end.
    """
    torch.manual_seed(seed)
    lessons = iter(lessons)
    rng = np.random.default_rng(seed)
    lives = LivesVecEnv(
        scene,
        settings.persons,
        spawn=spawn_model(settings.spawn, scene, part),
        horizon_s=settings.horizon_s,
        observation=settings.observation,
        seed=seed,
    )
    venv = Outcomes(lives)
    per_round = settings.round_steps * settings.persons
    generator = PPO(
        MixturePolicy,
        venv,
        n_steps=settings.round_steps,
        batch_size=per_round // max(1, per_round // 512),
        n_epochs=settings.ppo_epochs,
        learning_rate=settings.learning_rate,
        clip_range=settings.clip,
        gamma=settings.gamma,
        ent_coef=0.0,
        seed=seed,
        device="cpu",
        policy_kwargs={"net_arch": [layer.out_features for layer in _hidden(policy)]},
    )
    generator.policy.load_state_dict(policy.state_dict())
    lives.others = Learner(generator.policy, settings.observation)
    size = min(settings.discriminator_batch, per_round)
    shown = demonstrations(scene, part=part, observation=settings.observation)
    trainer = FairGAIL(
        demonstrations=experts(shown, size, rng),
        demo_batch_size=size,
        venv=venv,
        gen_algo=generator,
        reward_net=Discriminator(
            venv.observation_space,
            venv.action_space,
            settings.discriminator,
            bounds=settings.observation == "lidar-3",
        ),
        disc_opt_kwargs={"lr": settings.discriminator_rate},
        gen_replay_buffer_capacity=8 * per_round,
        n_disc_updates_per_round=settings.discriminator_updates,
        custom_logger=logger.configure(format_strs=[]),
        allow_variable_horizon=True,
    )
    for k in range(max(1, settings.steps // per_round)):
        venv.ended.clear()
        venv.speeds.clear()
        trainer.train_gen(per_round)
        remind(generator.policy, lessons, settings.reminders)
        found = [trainer.train_disc() for _ in range(settings.discriminator_updates)]
        policy.load_state_dict(generator.policy.state_dict())
        yield {
            "steps": (k + 1) * per_round,
            "at goal": venv.ended["goal"] / max(1, venv.ended.total()),
            "m/s": float(np.mean(venv.speeds)) * lives.scene.motion.max_speed_mps,
            "recorded told": float(np.mean([f["disc_acc_expert"] for f in found])),
            "walked told": float(np.mean([f["disc_acc_gen"] for f in found])),
            "waited": lives.waited,
        }


def _hidden(policy: MixturePolicy) -> list[nn.Linear]:
    return [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, nn.Linear)]


SETTABLE = {
    "steps": "steps of persons to train for, all together",
    "persons": "persons it learns from at a time; the crowd around them is walked by it too",
    "spawn": "spawn model that lets people in",
    "horizon_s": "length of an episode, in seconds",
    "learning_rate": "Adam's, of the policy",
    "discriminator_rate": "Adam's, of the discriminator",
    "reminders": "batches of recorded people from whom it clones anew after each improvement",
}
"""Settings that the command line takes, and what it says of them."""


def command_line() -> argparse.ArgumentParser:
    """The options of this script."""
    parser = new_parser("gail", __doc__)
    add_settings(parser, Settings(), SETTABLE)
    bc.add_observation(parser)
    cloning = parser.add_argument_group("cloning, from which it starts (0 epochs: from nothing)")
    bc.add_cloning(cloning, "cloning-")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Clone, train and write policies."""
    asked = command_line().parse_args(arguments)
    use_one_thread()
    names = (*SETTABLE, "observation")
    settings = Settings(**{name: getattr(asked, name) for name in names})
    first = bc.settings_from(asked, "cloning_")
    first = replace(first, observation=settings.observation, seed=asked.seed)
    try:
        check_numbers(settings, or_zero=("learning_rate", "gamma", "reminders"))
        bc.check(first)
        command = Command.of("gail", asked.scene, asked.parts, asked.out, arguments)
        spawn_model(settings.spawn, command.scene)  # if there is none, before anything is cloned
        for part in asked.parts:
            lots = bc.shown(asked.scene, part, first)
            # Reminders would undo a narrowing of the clone: then it comes last.
            width = first.width if settings.reminders else 1.0
            policy, _, _ = bc.clone(lots, replace(first, width=first.width / width))
            lessons = chain.from_iterable(repeat(bc.everything(lots, first)))
            rounds = train(asked.scene, part, policy, settings, asked.seed, lessons)
            curves = _watched(rounds)
            policy.narrow(width)
            path = command.write(
                part, Sampler(policy), observation=settings.observation, noise=NOISE
            )
            _write(curves, path.with_suffix(".csv"))
            print(f"{path}: {command.walk(path, settings.spawn)}", flush=True)
    except CrowdbenchError as error:
        print(f"baselines.gail: {error}", file=sys.stderr)
        return 2
    return 0


def _watched(rounds: Iterator[dict[str, float]]) -> list[dict[str, float]]:
    curves, began, said = [], time.monotonic(), -np.inf
    for row in rounds:
        curves.append(row)
        took = time.monotonic() - began
        if took - said > 10:
            said = took
            figures = "  ".join(f"{name} {v:.2f}" for name, v in row.items() if name != "steps")
            print(f"{row['steps']:9,} steps  {figures}  {row['steps'] / took:,.0f}/s", flush=True)
    return curves


def _write(curves: list[dict[str, float]], path: Path) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(curves[0]))
        writer.writeheader()
        writer.writerows(curves)


if __name__ == "__main__":
    sys.exit(main())
