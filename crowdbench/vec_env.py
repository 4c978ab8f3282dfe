"""Short import path for `crowdbench.envs.vec_env`."""

from crowdbench.envs.vec_env import CrowdVecEnv as CrowdVecEnv
