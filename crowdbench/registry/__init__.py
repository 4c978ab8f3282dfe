"""Recordings, spawn models and policies by name."""

from crowdbench.registry.policies import (
    ANY_PLACE,
    POLICIES,
    list_policies,
    policy,
    policy_source,
    trained_policies,
)
from crowdbench.registry.recordings import (
    GENERATED,
    RECORDINGS,
    has_recording,
    import_recording,
    raw_recording_of,
    recording,
    recording_of,
)
from crowdbench.registry.spawn_models import (
    DEFAULT_FITS,
    DEFAULT_SPAWN,
    FITTED,
    PLANNED,
    SPAWN_MODELS,
    WEIGHTS,
    fitted_models,
    list_spawn_models,
    spawn_model,
    spawn_source,
)

__all__ = [
    "ANY_PLACE", "DEFAULT_FITS", "DEFAULT_SPAWN", "FITTED", "GENERATED", "PLANNED", "POLICIES",
    "RECORDINGS", "SPAWN_MODELS", "WEIGHTS", "fitted_models", "has_recording", "import_recording",
    "list_policies", "list_spawn_models", "policy", "policy_source", "raw_recording_of",
    "recording", "recording_of", "spawn_model", "spawn_source", "trained_policies",
]  # fmt: skip
