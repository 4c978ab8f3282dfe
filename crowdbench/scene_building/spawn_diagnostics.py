"""How well a scene's fitted spawn models explain its recording, beside how they score.

Likelihood says how probable the recorded arrivals are under a model, time rescaling whether their
gaps and group sizes look as the model says they should, counts whether its samples let in as many
people as were recorded, from the first moment on.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from crowdbench.registry import fitted_models, recording_of, spawn_model
from crowdbench.scene import Scene
from crowdbench.spawn import Arrivals, PoissonGMM, SpawnModel, arrivals_of
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import arrivals_in, blocks_of
from crowdbench.spawn.groups import HasHazards
from crowdbench.spawn.ntpp import networks
from crowdbench.spawn.plaza import SCENE as PLAZA
from crowdbench.spawn.plaza import PlazaArrivals
from crowdbench.spawn.rescaling import KolmogorovSmirnov, kolmogorov_smirnov, rescaled
from crowdbench.trajectories.blocks import PARTS

SAMPLES = 20
"""Of each fit, to count persons in."""
FIRST_FRAMES = 25
OWN_S = 36_000.0
"""Length of the sample that a model is held against itself with."""


@dataclass(frozen=True, kw_only=True)
class Checked:
    """What was found of one model; means over its fits."""

    model: str
    full: float
    """Log-likelihood of the recording, fitted to all of it, nats per person."""
    heldout: float
    """That of the folds, each by models fitted to the others."""
    fresh: float | None
    """That of ten fresh hours of the plaza, whose truth is known."""
    gaps: KolmogorovSmirnov | None
    """Of the recording, by the first fit."""
    sizes: KolmogorovSmirnov | None
    own_gaps: KolmogorovSmirnov | None
    """Of its own sample."""
    own_sizes: KolmogorovSmirnov | None
    persons: float | None
    """Who enter in its samples, per recorded person in the same time."""
    first: float | None
    """Who enter in the first 25 frames of its samples, per person in as many frames on average."""


def check_models(scene: Scene) -> Iterator[Checked]:
    """Check each model that the scene has fits of; on the plaza the true process first.

    Raises:
        RecordingError: the recording has not been imported.
    """
    crowd, centres = recording_of(scene), read_areas(scene).spawn.mean
    areas = len(centres)
    blocks = blocks_of(crowd, scene)
    whole = arrivals_of(crowd, blocks, areas)
    folds = [arrivals_of(crowd, blocks.scored(part), areas) for part in PARTS[1:]]
    fresh = None
    if scene.id == PLAZA:
        truth = PlazaArrivals(scene)
        # The truth numbers its areas otherwise than the clusters that were found.
        gap = np.linalg.norm(centres[:, None] - truth.areas.spawn.mean, axis=2)
        true_area, found_area = gap.argmin(axis=1), gap.argmin(axis=0)
        events = truth.sample(OWN_S, scene, np.random.default_rng(1))
        in_truth = arrivals_in(events, OWN_S, scene.grid_s, areas)
        fresh = replace(in_truth, area=found_area[in_truth.area])
        as_truth = [replace(a, area=true_area[a.area]) for a in (whole, *folds)]
        yield Checked(
            model=truth.name,
            full=truth.log_likelihood(as_truth[0]),
            heldout=_pooled([truth] * len(folds), as_truth[1:]),
            fresh=truth.log_likelihood(in_truth),
            gaps=None, sizes=None, own_gaps=None, own_sizes=None, persons=None, first=None,
        )  # fmt: skip
    fits = range(scene.protocol.fits)
    for name in fitted_models(scene):
        models = [spawn_model(name, scene, fit=fit) for fit in fits]
        on_folds = [
            _pooled([spawn_model(name, scene, part, fit) for part in PARTS[1:]], folds)
            for fit in fits
        ]
        model, rng = models[0], np.random.default_rng(0)
        own = arrivals_in(model.sample(OWN_S, scene, rng), OWN_S, scene.grid_s, areas)
        persons, first = _counts(models, scene, whole)
        yield Checked(
            model=name,
            full=float(np.mean([m.log_likelihood(whole) for m in models])),
            heldout=float(np.mean(on_folds)),
            fresh=None
            if fresh is None
            else float(np.mean([m.log_likelihood(fresh) for m in models])),
            gaps=_test(model, whole, rng, "gap"),
            sizes=_test(model, whole, rng, "size"),
            own_gaps=_test(model, own, rng, "gap"),
            own_sizes=_test(model, own, rng, "size"),
            persons=persons,
            first=first,
        )


@dataclass(frozen=True, kw_only=True)
class Networks:
    """How many areas of `ntpp-gmm` have a trained network; the others have constant rates."""

    areas: int
    full: list[int]
    """Of each fit to the whole recording."""
    heldout: list[int]
    """Of each fit, in all folds together."""
    constant: float
    """Share of the persons who enter an area without one, by the fits to the whole recording."""

    def __str__(self) -> str:
        """One sentence."""
        folds = len(PARTS) - 1
        return (
            f"ntpp-gmm has a trained network in {_span(self.full)} of {self.areas} areas; in all "
            f"fits of all folds, in {sum(self.heldout)} of "
            f"{len(self.heldout) * folds * self.areas}. {self.constant:.0%} of the persons enter "
            "areas without one, at constant rates of groups as in poisson-groups."
        )


def trained_networks(scene: Scene) -> Networks:
    """Count the networks in the scene's fits of `ntpp-gmm`.

    Raises:
        WeightsError: the scene has none, or they are broken.
    """
    areas = read_areas(scene)
    full, heldout = (networks(scene, areas, parts) for parts in (PARTS[:1], PARTS[1:]))
    rate = PoissonGMM.read(scene, areas).rate
    return Networks(
        areas=len(areas.spawn),
        full=full.sum(axis=1).tolist(),
        heldout=heldout.sum(axis=1).tolist(),
        constant=float(((full == 0) * rate).sum(axis=1).mean() / rate.sum()),
    )


def _span(counts: Sequence[int]) -> str:
    low, high = min(counts), max(counts)
    return f"{low}" if low == high else f"{low} to {high} (by fit)"


def _pooled(models: Sequence[SpawnModel], folds: list[Arrivals]) -> float:
    """Nats per person of all folds together."""
    nats = [m.log_likelihood(a) * len(a.tick) for m, a in zip(models, folds, strict=True)]
    return float(sum(nats) / sum(len(a.tick) for a in folds))


def _test(
    model: SpawnModel, arrivals: Arrivals, rng: np.random.Generator, what: Literal["gap", "size"]
) -> KolmogorovSmirnov:
    assert isinstance(model, HasHazards)  # all fitted models do
    return kolmogorov_smirnov(rescaled(model, arrivals, rng, what))


def _counts(models: list[SpawnModel], scene: Scene, whole: Arrivals) -> tuple[float, float]:
    horizon_s, first_s = scene.horizon_s, FIRST_FRAMES * scene.dt_s
    times = [
        m.sample(horizon_s, scene, np.random.default_rng([k, fit])).time_s
        for fit, m in enumerate(models)
        for k in range(SAMPLES)
    ]
    per_s = float(np.mean([len(t) for t in times])) / horizon_s
    first_per_s = float(np.mean([(t < first_s - 1e-9).sum() for t in times])) / first_s
    return per_s / (len(whole.tick) / whole.exposure_s()), first_per_s / per_s
