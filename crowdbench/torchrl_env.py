"""Short import path for `crowdbench.envs.torchrl_env` and `crowdbench.envs.torchrl_slots`."""

from crowdbench.envs.torchrl_env import CrowdEnv as CrowdEnv
from crowdbench.envs.torchrl_slots import SlotEnv as SlotEnv
