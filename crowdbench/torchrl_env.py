"""`crowdbench.envs.torchrl_env` by its short name."""

from crowdbench.envs.torchrl_env import CrowdEnv as CrowdEnv
