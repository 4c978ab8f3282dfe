"""The models of other simulators, as policies: `crowdbench evaluate eth-v0 --policy
examples.peers.models:CollisionFreeSpeedV2`.

Each has the default parameters of its library (*as published*) or those given. `SEARCHED` says
which ones calibration may change, and between which values.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import jupedsim as jps
from numpy.random import Generator

from crowdbench.scene import Scene

from .adapter import Crowd, PeerPolicy
from .jupedsim_crowd import JuPedSimCrowd
from .pysocialforce_crowd import PySocialForceCrowd


class Range(NamedTuple):
    """Values of a parameter that calibration may choose, and the published one."""

    low: float
    high: float
    published: float


class Peer(PeerPolicy):
    """A model of another simulator, with its published parameters or others."""

    searched: ClassVar[Mapping[str, Range]] = MappingProxyType({})
    adapted_in: ClassVar[str]
    """The file of its crowd."""

    def __init__(self, parameters: Mapping[str, float] = MappingProxyType({})) -> None:
        self.parameters = dict(parameters)


class _JuPedSim(Peer):
    adapted_in = "jupedsim_crowd.py"
    model: ClassVar[type]
    agent: ClassVar[type]

    def crowd(self, scene: Scene) -> Crowd:
        """An empty crowd."""
        return JuPedSimCrowd(scene, self.model, self.agent, self.parameters)


class CollisionFreeSpeedV2(_JuPedSim):
    """Tordeux, Chraibi & Seyfried (2016), Collision-free speed model for pedestrian dynamics.

    Version 1 of JuPedSim is the same model, whose repulsion is the same for everyone.
    """

    name = "collision-free-speed-v2"
    model, agent = jps.CollisionFreeSpeedModelV2, jps.CollisionFreeSpeedModelV2AgentParameters
    searched = MappingProxyType(
        {
            "time_gap": Range(0.1, 2.0, 1.0),
            "radius": Range(0.1, 0.3, 0.2),
            "strength_neighbor_repulsion": Range(0.5, 20.0, 8.0),
            "range_neighbor_repulsion": Range(0.02, 1.0, 0.1),
        }
    )


class CollisionFreeSpeedV3(_JuPedSim):
    """The collision-free speed model of JuPedSim in which headings relax over time."""

    name = "collision-free-speed-v3"
    model, agent = jps.CollisionFreeSpeedModelV3, jps.CollisionFreeSpeedModelV3AgentParameters
    searched = MappingProxyType(
        {
            "time_gap": Range(0.1, 2.0, 1.0),
            "radius": Range(0.1, 0.3, 0.2),
            "theta_max_upper_bound": Range(0.2, 1.57, 1.57),  # any greater strength has no effect
            "range_neighbor_repulsion": Range(0.02, 1.0, 0.1),
            "agent_buffer": Range(0.0, 0.5, 0.0),
        }
    )


class AnticipationVelocity(_JuPedSim):
    """Xu, Chraibi & Seyfried (2021), Anticipation in a velocity-based model for pedestrian
    dynamics, Transportation Research Part C 133, 103464.
    """

    name = "anticipation-velocity"
    deterministic: ClassVar[bool] = False  # people who stand in each other's way are pushed aside
    model, agent = jps.AnticipationVelocityModel, jps.AnticipationVelocityModelAgentParameters
    searched = MappingProxyType(
        {
            "time_gap": Range(0.1, 2.0, 1.06),
            "radius": Range(0.1, 0.3, 0.2),
            "strength_neighbor_repulsion": Range(0.5, 20.0, 8.0),
            "range_neighbor_repulsion": Range(0.02, 1.0, 0.1),
            "anticipation_time": Range(0.1, 4.0, 1.0),
            "reaction_time": Range(0.05, 1.0, 0.3),
        }
    )

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin with empty worlds, and a random seed for the model."""
        super().reset(scene, rng)
        self._seed = int(rng.integers(2**31))

    def crowd(self, scene: Scene) -> Crowd:
        """An empty crowd."""
        parameters = self.parameters | {"rng_seed": self._seed}
        return JuPedSimCrowd(scene, self.model, self.agent, parameters)


class SocialForceJuPedSim(_JuPedSim):
    """Helbing, Farkas & Vicsek (2000), Simulating dynamical features of escape panic, Nature 407,
    487–490.
    """

    name = "social-force-jupedsim"
    model, agent = jps.SocialForceModel, jps.SocialForceModelAgentParameters
    searched = MappingProxyType(
        {
            "reaction_time": Range(0.1, 2.0, 0.5),
            "agent_scale": Range(20.0, 4000.0, 2000.0),
            "obstacle_scale": Range(20.0, 4000.0, 2000.0),
            "force_distance": Range(0.03, 1.0, 0.08),
            "radius": Range(0.1, 0.35, 0.3),
        }
    )


class GeneralizedCentrifugalForce(_JuPedSim):
    """Chraibi, Seyfried & Schadschneider (2010), Generalized centrifugal-force model for
    pedestrian dynamics, Physical Review E 82, 046111.
    """

    name = "generalized-centrifugal-force"
    model = jps.GeneralizedCentrifugalForceModel
    agent = jps.GeneralizedCentrifugalForceModelAgentParameters
    searched = MappingProxyType(
        {
            "tau": Range(0.1, 2.0, 0.5),
            "a_v": Range(0.05, 1.5, 1.0),
            "a_min": Range(0.1, 0.3, 0.2),
            "b_min": Range(0.1, 0.2, 0.2),
            "b_max": Range(0.2, 0.5, 0.4),
            "strength_neighbor_repulsion": Range(0.02, 1.5, 0.3),
        }
    )


class WarpDriver(_JuPedSim):
    """Wolinski, Lin & Pettré (2016), WarpDriver: context-aware probabilistic motion prediction for
    crowd simulation, ACM Transactions on Graphics 35(6).
    """

    name = "warp-driver"
    model, agent = jps.WarpDriverModel, jps.WarpDriverModelAgentParameters
    searched = MappingProxyType(
        {
            "time_horizon": Range(0.5, 5.0, 2.0),
            "sigma": Range(0.05, 1.0, 0.3),
            "time_uncertainty": Range(0.05, 2.0, 0.5),
            "velocity_uncertainty_x": Range(0.02, 1.0, 0.2),
            "velocity_uncertainty_y": Range(0.02, 1.0, 0.2),
        }
    )


class PySocialForce(Peer):
    """Moussaïd et al. (2010), The walking behaviour of pedestrian social groups and its impact on
    crowd dynamics, PLoS ONE 5(4), e10047.
    """

    name = "pysocialforce"
    adapted_in = "pysocialforce_crowd.py"
    searched = MappingProxyType(
        {
            "desired_force.relaxation_time": Range(0.1, 2.0, 0.5),
            "social_force.factor": Range(0.2, 15.0, 5.1),
            "social_force.lambda_importance": Range(0.5, 4.0, 2.0),
            "social_force.gamma": Range(0.1, 1.0, 0.35),
            "group_coherence_force_alt.factor": Range(0.1, 8.0, 1.0),
            "group_gaze_force_alt.factor": Range(0.1, 8.0, 1.0),
        }
    )

    def crowd(self, scene: Scene) -> Crowd:
        """An empty crowd."""
        return PySocialForceCrowd(scene, self.parameters)


MODELS: Mapping[str, type[Peer]] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            CollisionFreeSpeedV2,
            CollisionFreeSpeedV3,
            AnticipationVelocity,
            SocialForceJuPedSim,
            GeneralizedCentrifugalForce,
            WarpDriver,
            PySocialForce,
        )
    }
)
