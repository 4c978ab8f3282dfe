"""Does the default reward train walkers? Minutes per scene and route.

    python -m studies runners eth-v0 --route plain     # PPO by name on parallel_env
    python -m studies runners eth-v0 --route sb3       # Stable-Baselines3 on CrowdVecEnv

Trains on the default reward and prints how fast the policy then walks beside how fast people
prefer to, and how many arrive, for its mean actions and for sampled ones. It exits with 1 where
the mean speed is more than 10 % off or fewer than 95 % arrive.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torch import nn

from crowdbench import parallel_env

Act = Callable[[np.ndarray], np.ndarray]
LOG_STD = -1.5
"""Of the first policy: an action of 1 is the greatest speed, several times that of a walker."""


def walked(scene: str, act: Act, seed: int = 1000) -> tuple[float, float, float]:
    """Mean speed and mean preferred speed over persons, m/s, and the share who arrive.

    Of those who enter and end in ten minutes; everyone is walked by `act`.
    """
    env = parallel_env(scene, horizon_s=600.0)
    seen, _ = env.reset(seed=seed)
    there = set(env.agents)  # whom nobody saw enter
    max_speed = env.scene.motion.max_speed_mps
    speeds: dict[str, list[float]] = {}
    preferred: dict[str, float] = {}
    arrived: list[bool] = []
    means: list[tuple[float, float]] = []
    while env.agents:
        names = env.agents
        actions = act(np.stack([seen[name] for name in names]))
        for name in names:
            preferred.setdefault(name, float(seen[name][5]) * max_speed)
        seen, _, _, _, infos = env.step(dict(zip(names, actions, strict=True)))
        for name in names:
            velocity = seen[name][:2] * max_speed
            speeds.setdefault(name, []).append(float(np.hypot(*velocity)))
            outcome = infos[name].get("outcome")
            if outcome not in (None, "horizon") and name not in there:
                arrived.append(outcome == "goal")
                means.append((float(np.mean(speeds[name])), preferred[name]))
    speed, wish = np.mean(means, axis=0)
    return float(speed), float(wish), float(np.mean(arrived))


class Network(nn.Module):
    """A mean action and a value, each by two layers of 64; one standard deviation for all."""

    def __init__(self, inputs: int) -> None:
        super().__init__()

        def layers(out: int) -> nn.Sequential:
            return nn.Sequential(
                nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, out)
            )

        self.mean, self.value = layers(2), layers(1)
        self.log_std = nn.Parameter(torch.full((2,), LOG_STD))
        last = self.mean[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.bias)
        with torch.no_grad():
            last.weight *= 0.01

    def distribution(self, seen: torch.Tensor) -> torch.distributions.Normal:
        """The distribution of actions."""
        return torch.distributions.Normal(self.mean(seen), self.log_std.exp())


def plain_ppo(scene: str, steps: int, gamma: float, seed: int) -> tuple[Act, Act]:
    """PPO (Schulman et al. 2017) on `parallel_env`, each person's life an episode of its own."""
    torch.manual_seed(seed)
    env = parallel_env(scene)
    seen, _ = env.reset(seed=seed)
    network = Network(len(next(iter(seen.values()))))
    optimizer = torch.optim.Adam(network.parameters(), 1e-3, eps=1e-5)
    done = 0
    trips: dict[str, list[Any]] = {}
    batch: list[Any] = []
    while done < steps:
        names = env.agents
        rows = torch.from_numpy(np.stack([seen[name] for name in names]))
        with torch.no_grad():
            drawn = network.distribution(rows)
            actions = drawn.sample()
            chance = drawn.log_prob(actions).sum(1)
        acted = dict(zip(names, actions.numpy(), strict=True))
        seen, rewards, terminated, truncated, _ = env.step(acted)
        for k, name in enumerate(names):
            trips.setdefault(name, []).append((rows[k], actions[k], chance[k], rewards[name]))
            if terminated[name] or truncated[name]:
                last = None if terminated[name] else seen[name]
                batch.append((trips.pop(name), last))
        done += len(names)
        if not env.agents:
            seen, _ = env.reset()
        if sum(len(life) for life, _ in batch) + sum(map(len, trips.values())) >= 2048:
            batch += [(life, seen[name]) for name, life in trips.items()]  # so far
            improve(network, optimizer, batch, gamma)
            trips, batch = {}, []

    def mean(rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return np.asarray(network.mean(torch.from_numpy(rows)))

    def sampled(rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return network.distribution(torch.from_numpy(rows)).sample().numpy()

    return mean, sampled


def improve(
    network: Network, optimizer: torch.optim.Optimizer, batch: list[Any], gamma: float
) -> None:
    """Ten epochs on pieces of trips, each with what was seen after it (None: it is over)."""
    rows, actions, chances, advantages, targets = [], [], [], [], []
    for life, last in batch:
        seen = torch.stack([step[0] for step in life])
        with torch.no_grad():
            value = network.value(seen)[:, 0].tolist()
            after = 0.0 if last is None else float(network.value(torch.from_numpy(last)))
        gained = 0.0
        found = []
        for t in reversed(range(len(life))):
            gained = life[t][3] + gamma * after - value[t] + gamma * 0.95 * gained
            after = value[t]
            found.append(gained)
        advantages += found[::-1]
        targets += [a + v for a, v in zip(found[::-1], value, strict=True)]
        rows.append(seen)
        actions += [step[1] for step in life]
        chances += [step[2] for step in life]
    seen, action, chance = torch.cat(rows), torch.stack(actions), torch.stack(chances)
    advantage, target = torch.tensor(advantages), torch.tensor(targets)
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    for _ in range(10):
        for part in torch.randperm(len(seen)).split(256):
            new = network.distribution(seen[part])
            ratio = (new.log_prob(action[part]).sum(1) - chance[part]).exp()
            gain = advantage[part]
            clipped = torch.minimum(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
            missed = (network.value(seen[part])[:, 0] - target[part]).square().mean()
            optimizer.zero_grad()
            (0.5 * missed - clipped).backward()
            nn.utils.clip_grad_norm_(network.parameters(), 0.5)
            optimizer.step()


def sb3_ppo(scene: str, steps: int, gamma: float, seed: int) -> tuple[Act, Act]:
    """Stable-Baselines3's PPO on `CrowdVecEnv`."""
    from stable_baselines3 import PPO

    from crowdbench.envs.vec_env import CrowdVecEnv

    env = CrowdVecEnv(scene, 16, seed=seed)
    model = PPO(
        "MlpPolicy", env, gamma=gamma, learning_rate=1e-3, n_steps=128, batch_size=256, seed=seed,
        policy_kwargs={"log_std_init": LOG_STD}, device="cpu",
    )  # fmt: skip
    model.learn(steps)
    return (
        lambda rows: model.predict(rows, deterministic=True)[0],
        lambda rows: model.predict(rows)[0],
    )


ROUTES = {"plain": plain_ppo, "sb3": sb3_ppo}


def train_and_walk(
    scene: str, route: str, *, steps: int, gamma: float, seed: int
) -> Iterator[tuple[str, bool]]:
    """Lines on how policies walk after a training by a route, and whether they walk well enough.

    `steps` are of single persons.
    """
    torch.set_num_threads(1)
    began = time.monotonic()
    acts = ROUTES[route](scene, steps, gamma, seed)
    took = time.monotonic() - began
    for what, act in zip(("mean actions", "sampled actions"), acts, strict=True):
        speed, wish, arrived = walked(scene, act)
        yield (
            f"{scene} {route} γ={gamma:g} seed {seed}, {took:.0f} s, "
            f"{what}: {speed:.2f} m/s, preferred {wish:.2f} ({speed / wish - 1:+.1%}), "
            f"{arrived:.1%} arrive",
            abs(speed / wish - 1) <= 0.1 and arrived >= 0.95,
        )
