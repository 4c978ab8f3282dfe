"""crowdbench: a benchmark for crowd simulation with realistic arrivals.

    import crowdbench
    from crowdbench.simulation.observations import GOAL_DIRECTION, PREFERRED_SPEED

    env = crowdbench.parallel_env("eth-v0")
    observations, infos = env.reset(seed=0)
    while env.agents:
        actions = {}
        for agent in env.agents:
            seen = observations[agent]
            actions[agent] = seen[PREFERRED_SPEED] * seen[GOAL_DIRECTION]
        observations, rewards, terminations, truncations, infos = env.step(actions)
    for name, result in crowdbench.score("eth-v0", env.trajectories()).items():
        print(f"{name:22}{result.distance:.3f}")

Names are loaded on first use, so importing crowdbench is fast.
"""

import importlib
from typing import TYPE_CHECKING, Any

from crowdbench.envs.registration import register_on_import

__version__ = "0.1.0"

if TYPE_CHECKING:
    from crowdbench.crowds import read, rollout, score, score_rollouts
    from crowdbench.data.storage import read_own, write_parquet
    from crowdbench.data.table import Trajectories
    from crowdbench.envs.config import EnvConfig
    from crowdbench.envs.demonstrations import Demonstrations, demonstrations
    from crowdbench.envs.parallel_env import CrowdParallelEnv, aec_env, parallel_env
    from crowdbench.envs.person_env import PersonEnv, person_env
    from crowdbench.envs.reference_rewards import reference_rewards
    from crowdbench.errors import CrowdbenchError
    from crowdbench.evaluation import evaluate
    from crowdbench.metrics import METRICS, MetricResult, distance
    from crowdbench.plugins import register
    from crowdbench.registry import (
        list_policies,
        list_spawn_models,
        policy,
        recording,
        recording_of,
        spawn_model,
    )
    from crowdbench.robot.config import RobotConfig, RobotReward
    from crowdbench.robot.env import RobotEnv, robot_env
    from crowdbench.robot.robots import Robot
    from crowdbench.run.executor import engine
    from crowdbench.scene import Scene, list_scenes, load_scene
    from crowdbench.simulation.reward import Reward

_HOME = {
    "crowds": ("read", "rollout", "score", "score_rollouts"),
    "envs.config": ("EnvConfig",),
    "envs.demonstrations": ("Demonstrations", "demonstrations"),
    "envs.parallel_env": ("CrowdParallelEnv", "aec_env", "parallel_env"),
    "envs.person_env": ("PersonEnv", "person_env"),
    "envs.reference_rewards": ("reference_rewards",),
    "errors": ("CrowdbenchError",),
    "evaluation": ("evaluate",),
    "robot.config": ("RobotConfig", "RobotReward"),
    "robot.env": ("RobotEnv", "robot_env"),
    "robot.robots": ("Robot",),
    "run.executor": ("engine",),
    "metrics": ("METRICS", "MetricResult", "distance"),
    "plugins": ("register",),
    "registry": (
        "list_policies", "list_spawn_models", "policy", "recording", "recording_of", "spawn_model",
    ),
    "scene": ("Scene", "list_scenes", "load_scene"),
    "simulation.reward": ("Reward",),
    "data.storage": ("read_own", "write_parquet"),
    "data.table": ("Trajectories",),
}  # fmt: skip
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "METRICS", "CrowdParallelEnv", "CrowdbenchError", "Demonstrations", "EnvConfig",
    "MetricResult", "PersonEnv", "Reward", "Robot", "RobotConfig", "RobotEnv", "RobotReward",
    "Scene", "Trajectories", "aec_env", "demonstrations", "distance", "engine", "evaluate",
    "list_policies", "list_scenes", "list_spawn_models", "load_scene", "parallel_env",
    "person_env", "policy", "read", "read_own", "recording", "recording_of",
    "reference_rewards", "register", "robot_env", "rollout", "score", "score_rollouts",
    "spawn_model", "write_parquet",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'crowdbench' has no attribute {name!r}")
    return getattr(importlib.import_module(f"crowdbench.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_MODULE_OF])


register_on_import()
