"""Policies: what walks the persons."""

from crowdbench.policies.policy import Policy, StateView
from crowdbench.policies.social_force import SocialForce
from crowdbench.policies.walkers import Random, ReplayPolicy, Straight

__all__ = ["Policy", "Random", "ReplayPolicy", "SocialForce", "StateView", "Straight"]
