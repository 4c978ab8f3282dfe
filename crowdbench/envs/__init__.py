"""Environments: the simulation with the interfaces of PettingZoo, TorchRL and Stable-Baselines3."""
