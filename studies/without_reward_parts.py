"""What does it cost to drop a part of the reward?

    python -m studies without-reward-parts eth-v0

trains `crowdbench.baselines.ppo` with the observation `social-1`, with the default reward and with
each part dropped, under arrivals with stops and companions. `contact` is a part only in a scene
with bodies. Each trained policy then walks in new worlds. A row has the mean of each part there,
with the default weights, in 1/1000 per step of a person, its speed divided by its preferred speed,
and the share of trips that end at the goal.
"""

from collections.abc import Iterator
from dataclasses import replace

import torch

from crowdbench import Reward, load_scene, spawn_model
from crowdbench.baselines import ppo
from crowdbench.baselines.command import use_one_thread
from crowdbench.envs.torchrl_env import CrowdEnv
from crowdbench.simulation import social
from crowdbench.simulation.reward import PARTS

WORLDS, SEED = 16, 1_000


def row(network: ppo.Around, scene: str, settings: ppo.PpoSettings, count: int) -> str:
    """Means over all steps in new worlds of the first `count` parts, as a row of a table."""
    env = CrowdEnv(
        scene,
        spawn=spawn_model(settings.spawn, scene),
        worlds=WORLDS,
        max_alive=settings.max_alive,
        horizon_s=settings.horizon_s,
        observation=settings.observation,
        seed=SEED,
    )
    act = ppo.OfPresent(network)
    parts, ratio, goals = [], [], []
    now = env.reset()
    with torch.no_grad():
        for _ in range(env.frames):
            seen, mask = now["agents", "observation"], now["agents", "mask"]
            now["agents", "action"] = act(seen, mask)
            now = env.step(now)["next"]
            after = now["agents"]
            parts.append(after["reward_parts"][mask])
            moving = mask & (seen[..., social.WAIT_LEFT][..., 0] == 0)
            speed = after["observation"][..., social.VELOCITY].norm(dim=-1)
            ratio.append((speed / seen[..., social.PREFERRED_SPEED][..., 0])[moving])
            goals.append(after["terminated"][..., 0][mask & after["done"][..., 0]])
    mean = 1000 * torch.cat(parts).mean(dim=0)
    arrived = torch.cat(goals).float().mean()
    numbers = " | ".join(f"{x:.1f}" for x in mean[:count].tolist())
    return f"{numbers} | {torch.cat(ratio).mean():.2f} | {arrived:.1%}"


def rows(scene: str, *, spawn: str, frames: int) -> Iterator[str]:
    """The lines of the table, each after its training of `frames` frames."""
    use_one_thread()
    bodies = load_scene(scene).motion.body_radius_m > 0
    parts = [name for name in PARTS if bodies or name != "contact"]
    settings = ppo.PpoSettings(observation="social-1", spawn=spawn, frames=frames)
    yield f"| dropped | {' | '.join(parts)} | speed / preferred | at goal |"
    yield "|---" * (len(parts) + 3) + "|"
    for name in ("", *parts):
        reward = replace(Reward(), **{name: 0.0}) if name else Reward()
        *_, last = ppo.train(scene, settings, reward)
        yield f"| {name or 'nothing'} | {row(last.network, scene, settings, len(parts))} |"
