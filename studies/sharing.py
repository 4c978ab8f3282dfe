"""Does one network for all areas predict arrivals better than a network for each?

    python -m studies sharing eth-v0 hotel-v0 zara1-v0

prints a table of held-out log-likelihoods of `ntpp-gmm`, trained with a network for each area
(`own`) and with one for all (`shared`, see `crowdbench scene fit --shared`).
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench.data.blocks import SPLITS
from crowdbench.registry import recording_of
from crowdbench.scene import Scene, load_scene
from crowdbench.scene_building.fit import check_torch
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn import Areas, Arrivals, arrivals_of
from crowdbench.spawn.areas import read_areas
from studies.markdown import table

SEEDS = 5


def compare(scene: str | Path, *, seeds: int = SEEDS) -> Float[np.ndarray, "2 folds seeds"]:
    """Nats per held-out person with own networks and with the shared one, by fold and seed.

    Raises:
        SceneError, WeightsError: there is no such scene, or it lacks areas or statistics.
        RecordingError: its recording has not been imported.
        SettingError: torch is not installed.
    """
    check_torch()
    place = load_scene(scene)
    crowd, blocks, areas = recording_of(place), read_reference(place).blocks, read_areas(place)
    count = len(areas.spawn)
    parts = [
        (
            arrivals_of(crowd, blocks.training(fold), count),
            arrivals_of(crowd, blocks.scored(fold), count),
        )
        for fold in SPLITS[1:]
    ]
    nats = [_nats(s, *part, k, areas, place) for s in (False, True) for part in parts
            for k in range(seeds)]  # fmt: skip
    return np.array(nats).reshape(2, len(parts), seeds)


def _nats(
    shared: bool, known: Arrivals, held_out: Arrivals, seed: int, areas: Areas, scene: Scene
) -> float:
    from crowdbench.spawn.ntpp import training as ntpp_training

    settings = replace(ntpp_training.DEFAULT, shared=shared)
    model = ntpp_training.fit(known, areas, scene, seed=seed, settings=settings)
    return model.log_likelihood(held_out)


def line(scene: str, nats: Float[np.ndarray, "2 folds seeds"]) -> list[str]:
    """A row of the table: means, and the difference in each fold with its spread over seeds."""
    own, shared = nats
    difference = shared - own
    each = ", ".join(
        f"{fold.mean():+.3f} ± {fold.std(ddof=1):.3f}".replace("-", "−") for fold in difference
    )
    means = (f"{values.mean():.3f}".replace("-", "−") for values in (own, shared))
    return [scene, *means, each]


def comparison(scenes: Sequence[str]) -> str:
    """The table with a row for each scene; errors as of `compare`."""
    lines = [line(scene, compare(scene)) for scene in scenes]
    return table(["scene", "own", "shared", "difference in each fold"], lines)
