"""Spawn models: when, where and whither persons enter."""

from crowdbench.spawn.areas import Areas, fit_areas
from crowdbench.spawn.events import Arrivals, SpawnEvents, arrivals_of
from crowdbench.spawn.model import SpawnModel
from crowdbench.spawn.poisson import PoissonGMM
from crowdbench.spawn.replay import Replay

__all__ = [
    "Areas",
    "Arrivals",
    "PoissonGMM",
    "Replay",
    "SpawnEvents",
    "SpawnModel",
    "arrivals_of",
    "fit_areas",
]
