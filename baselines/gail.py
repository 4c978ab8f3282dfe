"""GAIL with `imitation`: train a policy whose actions a discriminator cannot detect as simulated.

    python -m crowdbench.baselines.gail --scene eth-v0

writes `results/gail-eth-v0/full.onnx`, and the training curves to `full.csv`. Generative
adversarial imitation learning is the method of Ho & Ermon (2016), NeurIPS. PPO optimises the
policy.

Trips differ in length. A reward that is always positive, such as GAIL's −log(1 − D), encourages
people to stay, and one that is always negative encourages them to leave (Kostrikov et al. 2019,
Discriminator-Actor-Critic, ICLR, sec. 4.1). The reward here is log D − log(1 − D), as in Fu et al.
(2018, AIRL, ICLR). It is zero where the discriminator is undecided, so that episode length does not
bias the reward. This is why `allow_variable_horizon` of `imitation` is set.

The policy in training controls everyone in the crowd, but it learns only from the persons of the
sub-environments.

PPO shifts the mean of a narrow Gaussian by more than its width. Walkers then no longer keep their
velocity exactly, as recorded people do between two annotations. To prevent this, the policy can
also be trained on recorded people between the rounds, as in cloning (`--reminders`; Jena et al.
2020, Augmenting GAIL with BC for Sample Efficient Imitation Learning, CoRL).
"""

import argparse
import csv
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, islice, repeat
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from crowdbench import Demonstrations, demonstrations, spawn_model
from crowdbench.errors import CrowdbenchError
from crowdbench.files import replacing
from crowdbench.registry import DEFAULT_SPAWN
from crowdbench.scene import Scene

from .packages import needs

with needs("imitation", __name__):
    import torch
    from imitation.algorithms.adversarial.gail import GAIL
    from imitation.rewards.reward_nets import RewardNet
    from imitation.util import logger
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecEnvWrapper
    from torch import Tensor, nn

    from crowdbench.envs.vec_env import CrowdVecEnv
    from crowdbench.simulation.social import PROBES

    from . import bc
    from .command import (
        Command,
        add_settings,
        check_numbers,
        new_parser,
        train_each,
    )
    from .mixture import BOUNDS, NOISE, MixturePolicy, MixtureSampler
    from .progress import Progress

CHANGES = 10.0
"""Factor by which changes of velocity, which are small, are scaled for the discriminator."""
OUTSIDE = {"lidar-3": BOUNDS, "social-1": slice(PROBES.start, PROBES.start + 1)}
"""Values of observations of which one is 0 for people outside the bounds. In `social-1` it is the
free distance where the person is, which is 0 in walls, too."""
AGAINST = 10.0
"""Amount subtracted from the log-odds of people who walk out of the bounds."""


@dataclass(frozen=True)
class GailSettings:
    """Settings of the training with GAIL; `bc.BcSettings` has those of the cloning before it."""

    spawn: str = DEFAULT_SPAWN
    observation: str = bc.OBSERVATIONS[0]
    smoothing_s: float = 0.0
    """Window in which recorded paths are smoothed, see `crowdbench.demonstrations`."""
    persons: int = 64
    """Number of sub-environments."""
    steps: int = 500_000
    """Number of training steps, summed over all sub-environments."""
    horizon_s: float = 120.0
    round_steps: int = 64
    """Number of steps of each sub-environment between two updates."""
    ppo_epochs: int = 5
    learning_rate: float = 1e-4
    reminders: int = 0
    """Number of batches of recorded people on which the policy is cloned after each update."""
    clip: float = 0.1
    gamma: float = 0.95
    discriminator: int = 64
    """Width of the discriminator's two layers."""
    discriminator_rate: float = 1e-3
    discriminator_updates: int = 8
    discriminator_batch: int = 512

    @property
    def per_round(self) -> int:
        """Number of training steps between two updates."""
        return self.round_steps * self.persons

    @property
    def rounds(self) -> int:
        """Number of updates."""
        return max(1, self.steps // self.per_round)


class Discriminator(RewardNet):
    """Log-odds that an action in a state is that of a recorded person.

    If the observation contains the bounds, a constant is subtracted for people who walk out of
    them. No recorded person does so, but the network would learn this too slowly, because such
    steps are rare even if every tenth trip ends this way.
    """

    def __init__(
        self, observation_space: Any, action_space: Any, hidden: int, *, bounds: slice | None
    ) -> None:
        super().__init__(observation_space, action_space)
        self.bounds = bounds  # where the observation is 0 for people who are outside
        numbers = observation_space.shape[0] + 4
        self.layers = nn.Sequential(
            nn.Linear(numbers, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(),
            nn.Linear(hidden, 1),
        )  # fmt: skip

    def forward(self, state: Tensor, action: Tensor, next_state: Tensor, done: Tensor) -> Tensor:
        """Log-odds (A,) for states (A, obs) and actions (A, 2)."""
        change = CHANGES * (action - state[:, :2])
        odds = self.layers(torch.cat([state, action, change], dim=1))[:, 0]
        if self.bounds is None:
            return odds
        return odds - AGAINST * (next_state[:, self.bounds] <= 0).any(dim=1)


class FairGAIL(GAIL):
    """GAIL with the reward log D − log(1 − D), which is the discriminator's log-odds."""

    @property
    def reward_train(self) -> RewardNet:
        """The discriminator, whose output is used as the reward."""
        return self._reward_net


class Learner:
    """The policy in training, as the policy of people without a sub-environment."""

    name = "learner"
    sees: ClassVar[Literal["observation"]] = "observation"

    def __init__(self, policy: MixturePolicy, observation: str) -> None:
        self.sampler = MixtureSampler(policy)
        self.observation = observation

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        """Begin an episode whose noise is drawn from `rng`."""
        self._rng = rng

    def act(self, seen: np.ndarray) -> np.ndarray:
        """Actions (A, 2), one per observation."""
        noise = self._rng.standard_normal((len(seen), NOISE), dtype=np.float32)
        with torch.no_grad():
            return self.sampler(torch.from_numpy(seen), torch.from_numpy(noise)).numpy()


class Outcomes(VecEnvWrapper):
    """Wrapper that counts the outcomes of trips and records speeds."""

    def __init__(self, venv: CrowdVecEnv) -> None:
        super().__init__(venv)
        self.ended: Counter[str] = Counter()
        self.speeds: list[float] = []

    def reset(self) -> Any:
        """Reset the wrapped environment."""
        return self.venv.reset()

    def step_wait(self) -> Any:
        """Step the wrapped environment and record outcomes and speeds."""
        seen, rewards, dones, infos = self.venv.step_wait()
        self.ended.update(info["outcome"] for info in infos if "outcome" in info)
        goes_on = seen[~dones]
        if len(goes_on):
            self.speeds.append(float(np.linalg.norm(goes_on[:, :2], axis=1).mean()))
        return seen, rewards, dones, infos


def experts(shown: Demonstrations, size: int, rng: np.random.Generator) -> bc.Batches:
    """Batches of `size` recorded transitions, in random order."""
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
    """Increase the likelihood of recorded actions, for `times` batches of `lessons`."""
    for batch in islice(lessons, times):
        loss = -policy.get_distribution(batch["obs"]).log_prob(batch["acts"]).mean()
        policy.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
        policy.optimizer.step()


def train(
    scene: str | Scene,
    split: str,
    policy: MixturePolicy,
    settings: GailSettings,
    seed: int,
    lessons: Iterable[Mapping[str, Tensor]] = (),
) -> Iterator[dict[str, float]]:
    """Train the policy in place; yield statistics after each round.

    `lessons` are infinitely many batches of recorded `obs` and `acts` for the reminders.
    """
    torch.manual_seed(seed)
    lessons = iter(lessons)
    rng = np.random.default_rng(seed)
    trips = CrowdVecEnv(
        scene,
        settings.persons,
        spawn=spawn_model(settings.spawn, scene, split),
        horizon_s=settings.horizon_s,
        observation=settings.observation,
        seed=seed,
    )
    venv = Outcomes(trips)
    per_round = settings.per_round
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
        policy_kwargs={
            "net_arch": [layer.out_features for layer in _hidden(policy)],
            "features_extractor_class": type(policy.features_extractor),
        },
    )
    generator.policy.load_state_dict(policy.state_dict())
    trips.others = Learner(generator.policy, settings.observation)
    size = min(settings.discriminator_batch, per_round)
    shown = demonstrations(
        scene,
        split=split,
        observation=settings.observation,
        smoothing_s=settings.smoothing_s,
    )
    trainer = FairGAIL(
        demonstrations=experts(shown, size, rng),
        demo_batch_size=size,
        venv=venv,
        gen_algo=generator,
        reward_net=Discriminator(
            venv.observation_space,
            venv.action_space,
            settings.discriminator,
            bounds=OUTSIDE.get(settings.observation),
        ),
        disc_opt_kwargs={"lr": settings.discriminator_rate},
        gen_replay_buffer_capacity=8 * per_round,
        n_disc_updates_per_round=settings.discriminator_updates,
        custom_logger=logger.configure(format_strs=[]),
        allow_variable_horizon=True,
    )
    for k in range(settings.rounds):
        venv.ended.clear()
        venv.speeds.clear()
        trainer.train_gen(per_round)
        remind(generator.policy, lessons, settings.reminders)
        found = [trainer.train_disc() for _ in range(settings.discriminator_updates)]
        policy.load_state_dict(generator.policy.state_dict())
        yield {
            "steps": (k + 1) * per_round,
            "at goal": venv.ended["goal"] / max(1, venv.ended.total()),
            "m/s": float(np.mean(venv.speeds)) * trips.scene.motion.max_speed_mps,
            "recorded told": float(np.mean([f["disc_acc_expert"] for f in found])),
            "walked told": float(np.mean([f["disc_acc_gen"] for f in found])),
            "waited": trips.waited,
        }


def _hidden(policy: MixturePolicy) -> list[nn.Linear]:
    return [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, nn.Linear)]


SETTABLE = {
    "steps": "number of training steps, summed over all sub-environments",
    "persons": "number of sub-environments, that is, of people it learns from at a time; the "
    "policy controls everyone else too",
    "spawn": "spawn model",
    "horizon_s": "length of an episode in seconds",
    "learning_rate": "learning rate of Adam for the policy",
    "discriminator_rate": "learning rate of Adam for the discriminator",
    "reminders": "number of batches of recorded people on which the policy is cloned after each "
    "update",
}
"""Settings with a command line option, and the help texts of the options."""


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = new_parser("gail", __doc__)
    add_settings(parser, GailSettings(), SETTABLE)
    bc.add_observation(parser)
    cloning = parser.add_argument_group("cloning before GAIL (0 epochs: no cloning)")
    bc.add_cloning(cloning, "cloning-")
    return parser


def learn(
    split: str, command: Command, settings: GailSettings, first: bc.BcSettings, seed: int
) -> str:
    """Clone, train and write the policy of a split; return a line about it."""
    lots = bc.shown(command.scene, split, first)
    # Reminders would undo the narrowing of the clone, so with them it is done at the end.
    width = first.width if settings.reminders else 1.0
    cloning = replace(first, width=first.width / width)
    with command.progress(f"{split}/cloning", cloning.epochs, "epochs", "samples") as progress:
        policy, _, _ = bc.clone(lots, cloning, progress)
    lessons = chain.from_iterable(repeat(bc.everything(lots, first)))
    rounds = train(command.scene, split, policy, settings, seed, lessons)
    total = settings.rounds * settings.per_round
    with command.progress(split, total, "steps", "agent-steps") as progress:
        curves = _watched(rounds, progress)
    policy.narrow(width)
    path = command.write(
        split, MixtureSampler(policy), observation=settings.observation, noise=NOISE
    )
    _write(curves, path.with_suffix(".csv"))
    return str(command.walk(path, settings.spawn))


def main(arguments: list[str] | None = None) -> int:
    """Clone, train and write a policy for each split; return the exit code."""
    asked = command_line().parse_args(arguments)
    first = bc.settings_from(asked, "cloning_")
    first = replace(first, observation=asked.observation, seed=asked.seed)
    settings = GailSettings(
        observation=first.observation,
        smoothing_s=first.smoothing_s,
        **{name: getattr(asked, name) for name in SETTABLE},
    )
    try:
        bc.check(first, "cloning-")
        check_numbers(settings, or_zero=("learning_rate", "gamma", "reminders", "smoothing_s"))
        command = Command.of("gail", asked.scene, asked.splits, asked.out, arguments)
        spawn_model(settings.spawn, command.scene)  # raises errors early, before the cloning
        train_each(learn, command, asked, settings, first, asked.seed, also=[".csv"])
    except CrowdbenchError as error:
        print(f"crowdbench.baselines.gail: {error}", file=sys.stderr)
        return 2
    return 0


def _watched(rounds: Iterator[dict[str, float]], progress: Progress) -> list[dict[str, float]]:
    curves, before = [], 0
    for row in rounds:
        curves.append(row)
        steps = int(row["steps"])
        progress(steps, steps - before, {k: v for k, v in row.items() if k != "steps"})
        before = steps
    return curves


def _write(curves: list[dict[str, float]], path: Path) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(curves[0]))
        writer.writeheader()
        writer.writerows(curves)


if __name__ == "__main__":
    # Worker processes find functions in modules that they can import, which `__main__` is not.
    from .gail import main as imported_main

    sys.exit(imported_main())
