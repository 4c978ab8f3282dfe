"""Spawn models: when, where and with which goal persons enter."""

from crowdbench.spawn.areas import Areas, fit_areas
from crowdbench.spawn.block_replay import BlockReplay
from crowdbench.spawn.events import Arrivals, SpawnEvents, arrivals_in, arrivals_of
from crowdbench.spawn.joint.model import JointGMM
from crowdbench.spawn.model import FittedModel, SpawnModel
from crowdbench.spawn.ntpp.model import NtppGMM
from crowdbench.spawn.paper.model import NtppPaper
from crowdbench.spawn.perturbed_replay import PerturbedReplay
from crowdbench.spawn.replay import Replay
from crowdbench.spawn.steering.scenario import Addition, Change, Scenario
from crowdbench.spawn.steering.steered import Steered
from crowdbench.spawn.times.cox import CoxGMM
from crowdbench.spawn.times.poisson import PoissonGMM, PoissonGroups, PoissonPaper
from crowdbench.spawn.times.renewal import RenewalGMM

__all__ = [
    "Addition", "Areas", "Arrivals", "BlockReplay", "Change", "CoxGMM", "FittedModel", "JointGMM",
    "NtppGMM", "NtppPaper", "PerturbedReplay", "PoissonGMM", "PoissonGroups", "PoissonPaper",
    "RenewalGMM", "Replay", "Scenario", "SpawnEvents", "SpawnModel", "Steered", "arrivals_in",
    "arrivals_of", "fit_areas",
]  # fmt: skip
