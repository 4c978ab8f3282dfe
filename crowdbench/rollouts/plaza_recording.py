"""The plaza's recording, which is generated: its true arrivals, walked by social forces."""

from dataclasses import replace

from crowdbench.policies import SocialForce
from crowdbench.rollouts.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.spawn.plaza import SCENE, PlazaArrivals
from crowdbench.trajectories.table import Trajectories

SEED = 0


def record(seed: int = SEED, horizon_s: float | None = None) -> Trajectories:
    """Generate a recording of the plaza: the true arrivals, walked by social forces.

    `horizon_s` is by default that of the scene (30 minutes). The areas of the persons are the
    true ones, numbered west, east, north, south.
    """
    scene = load_scene(SCENE)
    crowd = rollout(scene, PlazaArrivals(scene), SocialForce(), seed=seed, horizon_s=horizon_s)
    return replace(crowd, scene="plaza", provenance={"source": "generated", "seed": seed})
