"""crowdbench: a benchmark of crowds that come and go.

    import crowdbench

    env = crowdbench.parallel_env("eth-v0")
    observations, infos = env.reset(seed=0)
    while env.agents:
        actions = {}
        for agent in env.agents:
            seen = observations[agent]
            actions[agent] = seen[5] * seen[3:5]  # at its preferred speed to its goal
        observations, rewards, terminations, truncations, infos = env.step(actions)
    for name, result in crowdbench.score("eth-v0", env.trajectories()).items():
        print(f"{name:22}{result.distance:.3f}")

Names are loaded when they are first used: importing crowdbench is quick.
"""

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from crowdbench.crowds import read, rollout
    from crowdbench.demos import Demonstrations, demonstrations
    from crowdbench.environment import CrowdParallelEnv, parallel_env
    from crowdbench.errors import CrowdbenchError
    from crowdbench.evaluation import evaluate
    from crowdbench.metrics import METRICS, MetricResult, distance
    from crowdbench.reference import score
    from crowdbench.registry import policy, recording, recording_of, spawn_model
    from crowdbench.rewards import Reward
    from crowdbench.scene import Scene, list_scenes, load_scene
    from crowdbench.tables import read_own, write_parquet
    from crowdbench.trajectories import Trajectories

_HOME = {
    "crowds": ("read", "rollout"),
    "demos": ("Demonstrations", "demonstrations"),
    "environment": ("CrowdParallelEnv", "parallel_env"),
    "errors": ("CrowdbenchError",),
    "evaluation": ("evaluate",),
    "metrics": ("METRICS", "MetricResult", "distance"),
    "reference": ("score",),
    "registry": ("policy", "recording", "recording_of", "spawn_model"),
    "rewards": ("Reward",),
    "scene": ("Scene", "list_scenes", "load_scene"),
    "tables": ("read_own", "write_parquet"),
    "trajectories": ("Trajectories",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "METRICS",
    "CrowdParallelEnv",
    "CrowdbenchError",
    "Demonstrations",
    "MetricResult",
    "Reward",
    "Scene",
    "Trajectories",
    "demonstrations",
    "distance",
    "evaluate",
    "list_scenes",
    "load_scene",
    "parallel_env",
    "policy",
    "read",
    "read_own",
    "recording",
    "recording_of",
    "rollout",
    "score",
    "spawn_model",
    "write_parquet",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'crowdbench' has no attribute {name!r}")
    return getattr(importlib.import_module(f"crowdbench.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_MODULE_OF])
