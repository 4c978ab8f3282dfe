"""Policies: what walks the persons."""

from crowdbench.policies.card import PolicyCard
from crowdbench.policies.network import OnnxPolicy
from crowdbench.policies.policy import ObservationPolicy, Policy, StatePolicy, StateView
from crowdbench.policies.social_force import SocialForce
from crowdbench.policies.walkers import Random, ReplayPolicy, Straight

__all__ = [
    "ObservationPolicy",
    "OnnxPolicy",
    "Policy",
    "PolicyCard",
    "Random",
    "ReplayPolicy",
    "SocialForce",
    "StatePolicy",
    "StateView",
    "Straight",
]
