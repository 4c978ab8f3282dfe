"""The simulation behind the interfaces of PettingZoo, TorchRL and Stable-Baselines3."""
