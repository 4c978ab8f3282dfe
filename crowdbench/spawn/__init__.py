"""Spawn models: when, where and with which goal persons enter."""

from crowdbench.spawn.areas import Areas, fit_areas
from crowdbench.spawn.block_replay import BlockReplay
from crowdbench.spawn.cox import CoxGMM
from crowdbench.spawn.events import Arrivals, SpawnEvents, arrivals_in, arrivals_of
from crowdbench.spawn.model import SpawnModel
from crowdbench.spawn.ntpp import NtppGMM
from crowdbench.spawn.ntpp_paper import NtppPaper
from crowdbench.spawn.poisson import PoissonGMM, PoissonPaper
from crowdbench.spawn.poisson_groups import PoissonGroups
from crowdbench.spawn.renewal import RenewalGMM
from crowdbench.spawn.replay import Replay
from crowdbench.spawn.scenario import Addition, Change, Scenario
from crowdbench.spawn.steered import Steered

__all__ = [
    "Addition",
    "Areas",
    "Arrivals",
    "BlockReplay",
    "Change",
    "CoxGMM",
    "NtppGMM",
    "NtppPaper",
    "PoissonGMM",
    "PoissonGroups",
    "PoissonPaper",
    "RenewalGMM",
    "Replay",
    "Scenario",
    "SpawnEvents",
    "SpawnModel",
    "Steered",
    "arrivals_in",
    "arrivals_of",
    "fit_areas",
]
