"""What shipped policies earn in an environment, to compare the rewards of a training with."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Unpack

import numpy as np

from crowdbench.envs.config import EnvConfig, EnvCrowd, EnvSettings
from crowdbench.errors import SettingError, check_seed, checked
from crowdbench.registry import policy
from crowdbench.run.acting import Actor, needs
from crowdbench.run.episode import generator
from crowdbench.scene import Scene
from crowdbench.simulation.reward import total
from crowdbench.simulation.simulation import check_count

REFERENCES = ("straight", "social-force", "random")
"""Policies that every scene has."""


class Earned(NamedTuple):
    """Mean rewards of a policy that walks everyone."""

    per_step: float
    """Over all steps of all people."""
    per_trip: float
    """Over all trips that began and ended in that time, as Stable-Baselines3's `ep_rew_mean`."""

    @classmethod
    def of(cls, reward: float, steps: int, of_trips: float, trips: int) -> "Earned":
        """The means of two sums; NaN where there was no step, or no trip."""
        return cls(reward / steps if steps else np.nan, of_trips / trips if trips else np.nan)


@checked()
def reference_rewards(
    scene: str | Path | Scene,
    config: EnvConfig | None = None,
    *,
    policies: Sequence[str] = REFERENCES,
    seconds: float = 120.0,
    worlds: int = 8,
    seed: int = 0,
    **settings: Unpack[EnvSettings],
) -> dict[str, Earned]:
    """What policies earn in an environment of these settings, each of them alone.

    A mean is NaN if nobody came, or no trip ended, in that time.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        config: the settings of the environment, by default those of `EnvConfig()`.
        policies: names of policies.
        seconds: simulated time per world, at most the horizon of an episode.
        worlds: number of worlds.
        seed: seed of the arrivals, which are the same for all policies.
        settings: fields of `EnvConfig`, which replace those of `config`.

    Raises:
        SceneError, SettingError, WeightsError, RecordingError: a scene, policy, model or recording
            does not exist or does not fit.
    """
    check_count("worlds", worlds)
    if not 0 < seconds < np.inf:
        raise SettingError("seconds", got=repr(seconds), expected="a positive number")
    config = EnvConfig.of(EnvCrowd, config, **settings)
    check_seed(seed)
    return {name: _earned(scene, config, name, seconds, worlds, seed) for name in policies}


def _earned(
    scene: str | Path | Scene, config: EnvConfig, name: str, seconds: float, worlds: int, seed: int
) -> Earned:
    crowd = EnvCrowd(scene, config, worlds=worlds)
    simulation, walker = crowd.simulation, policy(name, crowd.scene)
    shown = simulation.settings.shown
    theirs = shown._replace(**needs(walker))
    crowd.begin(seed)
    actor = Actor(walker, simulation if theirs == shown else simulation.showing(theirs))
    actor.reset(*(generator(seed, world, "policy") for world in range(worlds)))
    simulation.observe()  # rewards are of the ways that are observed
    collected = np.zeros(simulation.slots.alive.shape)
    whole = simulation.slots.spawned.copy()
    sums, steps, trips, ended = 0.0, 0, 0, 0.0
    for _ in range(min(crowd.frames, crowd.scene.frames(seconds))):
        simulation.step(actor.actions(), own_frame=actor.own_frame)
        crowd.check_capacity()
        simulation.observe()
        slots = simulation.slots
        reward = np.where(slots.acted, total(crowd.reward_parts()), 0.0)
        sums, steps = sums + float(reward.sum()), steps + int(slots.acted.sum())
        collected += reward
        over = (slots.ended != 0) & whole
        ended, trips = ended + float(collected[over].sum()), trips + int(over.sum())
        collected[slots.spawned] = 0.0
        whole = (whole & (slots.ended == 0)) | slots.spawned
    return Earned.of(sums, steps, ended, trips)
