"""A robot among people who come and go, for gymnasium and Stable-Baselines3."""
