"""Rollouts: simulated crowds of a spawn model and a policy."""
