"""Policies: models that move the people of a crowd."""

from crowdbench.policies.card import PolicyCard
from crowdbench.policies.guided import GuidedWalker
from crowdbench.policies.memory import Memory
from crowdbench.policies.network import OnnxPolicy
from crowdbench.policies.policy import (
    ObservationPolicy,
    Policy,
    RememberingPolicy,
    StatePolicy,
    StateView,
)
from crowdbench.policies.social_force import SocialForce
from crowdbench.policies.speed_model import SpeedModel
from crowdbench.policies.walkers import Random, RecordedPaths, ReplayPolicy, Straight

__all__ = [
    "GuidedWalker", "Memory", "ObservationPolicy", "OnnxPolicy", "Policy", "PolicyCard", "Random",
    "RecordedPaths", "RememberingPolicy", "ReplayPolicy", "SocialForce", "SpeedModel",
    "StatePolicy", "StateView", "Straight",
]  # fmt: skip
