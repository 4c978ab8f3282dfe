"""One part of each kind, as another package would add them."""

import numpy as np

from crowdbench.data.table import from_rows
from crowdbench.metrics.forms import RelativeWasserstein
from crowdbench.simulation.observations import Observation
from crowdbench.spawn import PoissonGMM
from crowdbench.spawn.areas import read_areas


class PathLength(RelativeWasserstein):
    """Path length of those who enter, in steps of 0.1 m."""

    name, family, unit, lattice_step = "path_length", "trips", "m", 0.1

    def summarise(self, crowd, blocks, place):
        persons, block, _ = blocks.of_arrivals(crowd)
        length = crowd.path_lengths()[persons]
        return self.histogram(length, block, blocks)


class Clockwork:
    """Everybody of poisson-gmm, at even intervals."""

    name, start = "clockwork", "stationary"

    def __init__(self, scene, split="full"):
        self.model = PoissonGMM.read(scene, read_areas(scene), split, 0)
        self.areas = self.model.areas

    def sample(self, horizon_s, scene, rng):
        count = len(self.model.sample(horizon_s, scene, rng))
        time_s = np.linspace(0, horizon_s, count, endpoint=False)
        area = rng.integers(len(self.areas.spawn), size=count)
        return self.areas.draw(time_s, area, scene, rng)


class Dawdler:
    """Half as fast as people prefer to walk, by an observation of its own package."""

    name, sees, observation = "dawdler", "observation", "centre-1"

    def reset(self, scene, rng):
        pass

    def act(self, seen):
        assert seen.shape[1] == 40
        return (0.5 * seen[:, 3:5] * seen[:, 5:6]).astype(np.float32)


class Centre(Observation):
    """lidar-2, and where one is between the bounds, from −1 to 1."""

    name, extra = "centre-1", 2

    def observe(self, simulation, out):
        b = simulation.scene.bounds
        low, high = np.array([b.x_min_m, b.y_min_m]), np.array([b.x_max_m, b.y_max_m])
        xy = simulation.slots.position
        out[:] = np.clip(2 * (xy - low) / (high - low) - 1, -1, 1)


def read_columns(path, *, name, dt_s):
    """Rows `person frame x y`, parted by tabs."""
    person, frame, x, y = np.loadtxt(path, delimiter="\t", ndmin=2).T
    return from_rows(
        scene=name,
        dt_s=dt_s,
        person_id=person.astype(np.int64),
        frame=frame.astype(np.int64),
        xy=np.stack([x, y], axis=1),
        where=path,
    )
