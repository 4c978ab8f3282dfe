"""Short import path for `crowdbench.envs.torchrl_env`."""

from crowdbench.envs.torchrl_env import CrowdEnv as CrowdEnv
from crowdbench.envs.torchrl_env import SlotEnv as SlotEnv
