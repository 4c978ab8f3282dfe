"""`crowdbench.envs.vec_env` by its short name."""

from crowdbench.envs.vec_env import LivesVecEnv as LivesVecEnv
