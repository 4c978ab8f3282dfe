"""The generated recording of the plaza: its true process, walked by social forces.

Companions do not repel each other, so that they stay together.
"""

from dataclasses import replace

from crowdbench.data.companions import with_companions
from crowdbench.data.table import Trajectories
from crowdbench.policies.social_force import GroupForce
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.spawn.plaza import SCENE, PlazaArrivals


def record(seed: int = 0, horizon_s: float | None = None) -> Trajectories:
    """Generate a recording of the plaza from its true process and the walker `GroupForce`.

    `horizon_s` defaults to the length of the scene's recording (30 minutes). The persons have
    their true areas, numbered west, east, north, south. Companions are those that are found by the
    rule of all recordings.
    """
    scene = load_scene(SCENE)
    crowd = rollout(scene, PlazaArrivals(scene), GroupForce(), seed=seed, horizon_s=horizon_s)
    provenance = {"source": "generated", "seed": seed}
    return with_companions(replace(crowd, scene="plaza", provenance=provenance))
