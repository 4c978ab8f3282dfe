"""Spawn models: when, where and whither persons enter."""

from crowdbench.spawn.areas import Areas, fit_areas
from crowdbench.spawn.block_replay import BlockReplay
from crowdbench.spawn.events import Arrivals, SpawnEvents, arrivals_in, arrivals_of
from crowdbench.spawn.model import SpawnModel
from crowdbench.spawn.ntpp import NtppGMM
from crowdbench.spawn.poisson import PoissonGMM
from crowdbench.spawn.renewal import RenewalGMM
from crowdbench.spawn.replay import Replay

__all__ = [
    "Areas",
    "Arrivals",
    "BlockReplay",
    "NtppGMM",
    "PoissonGMM",
    "RenewalGMM",
    "Replay",
    "SpawnEvents",
    "SpawnModel",
    "arrivals_in",
    "arrivals_of",
    "fit_areas",
]
