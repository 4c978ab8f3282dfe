"""What users bring along: spawn models and policies of their own, and environments of them."""

from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from worlds import Person, events, square

from crowdbench.envs.parallel_env import CrowdParallelEnv, parallel_env
from crowdbench.policies import Straight
from crowdbench.scene import Scene
from crowdbench.spawn import SpawnEvents
from crowdbench.spawn.events import no_events
from crowdbench.spawn.model import Start

DT = 0.4


class Given:
    """Lets exactly these people in."""

    name = "given"
    start: ClassVar[Start] = "empty"

    def __init__(self, *people: Person) -> None:
        self.events = events(*people) if people else no_events()

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        return self.events[self.events.time_s < horizon_s - 1e-9]


class OneByOne(Given):
    """A spawn model as a user writes it: made from the scene."""

    def __init__(self, scene: Scene) -> None:
        b = scene.bounds
        middle = ((b.x_min_m + b.x_max_m) / 2, (b.y_min_m + b.y_max_m) / 2)
        times = np.arange(0.0, scene.horizon_s, 10.0).tolist()
        super().__init__(*[Person(time_s=t, start=middle, goal=middle) for t in times])


class PerFold(Given):
    """Lets in as many as the number of the fold it was made for, plus one."""

    def __init__(self, scene: Scene, split: str) -> None:
        b = scene.bounds
        middle = ((b.x_min_m + b.x_max_m) / 2, (b.y_min_m + b.y_max_m) / 2)
        there = [Person(time_s=5.0, start=middle, goal=middle) for _ in range(int(split[-1]) + 1)]
        super().__init__(*there)


class Announcing(Straight):
    """A policy as a user writes it; it says when an episode begins."""

    name = "announcing"

    def reset(self, scene: Scene, rng: Generator) -> None:
        print("walking", flush=True)
        super().reset(scene, rng)


class Incomplete:
    """Lacks what spawn models and policies need."""

    name = "incomplete"

    def __init__(self, scene: Scene | None = None) -> None:
        pass


def env_of(
    *people: Person,
    scene: Scene | None = None,
    horizon_s: float = 40.0,
    max_alive: int = 8,
    max_persons: int = 16,
    **options: Any,
) -> CrowdParallelEnv:
    """An environment in which these people enter, by default in a free square."""
    return parallel_env(
        square() if scene is None else scene,
        spawn=Given(*people),
        horizon_s=horizon_s,
        max_alive=max_alive,
        max_persons=max_persons,
        **options,
    )


def stand(env: CrowdParallelEnv) -> dict[str, np.ndarray]:
    """Actions with which nobody moves."""
    return {name: np.zeros(2, np.float32) for name in env.agents}


def run(env: CrowdParallelEnv, velocity: tuple[float, float] = (1.0, 0.0)) -> dict[str, np.ndarray]:
    """Actions with which everyone goes 2 m in a step, by default to the right."""
    return {name: np.array(velocity, np.float32) for name in env.agents}
