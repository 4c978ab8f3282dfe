"""Statistical checks of how well a scene's fitted spawn models explain its recording.

The likelihood is the probability of the recorded arrivals under a model. Time rescaling tests
whether their gaps and group sizes have the distributions of the model. Counts compare the number of
people in samples of the model with the recorded number, overall and in the first frames.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from crowdbench.data.blocks import SPLITS
from crowdbench.registry import fitted_models, recording_of, spawn_model
from crowdbench.scene import Scene
from crowdbench.scene_building.fit import NEURAL
from crowdbench.spawn import Arrivals, FittedModel, PoissonGMM, arrivals_of
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import arrivals_in, blocks_of
from crowdbench.spawn.ntpp.model import networks
from crowdbench.spawn.plaza import SCENE as PLAZA
from crowdbench.spawn.plaza import PlazaArrivals
from crowdbench.spawn.times import groups

SAMPLES = 20
"""Number of samples per fit in which persons are counted."""
FIRST_FRAMES = 25
OWN_S = 36_000.0
"""Length of the samples on which a model is tested against itself, seconds."""


@dataclass(frozen=True, kw_only=True)
class Checked:
    """Results for one model, averaged over its fits."""

    model: str
    full: float
    """Log-likelihood of the whole recording by models fitted to all of it, nats per person."""
    heldout: float
    """Log-likelihood of the folds, each by models fitted to the other folds, nats per person."""
    fresh: float | None = None
    """Log-likelihood of ten new hours of the plaza, whose true process is known; else None."""
    gaps: groups.KolmogorovSmirnov | None = None
    sizes: groups.KolmogorovSmirnov | None = None
    """Tests of the recorded gaps and group sizes, for the first fit; None without hazards."""
    own_gaps: groups.KolmogorovSmirnov | None = None
    own_sizes: groups.KolmogorovSmirnov | None = None
    """The same of a sample of that fit."""
    persons: float | None = None
    """Number of people in samples, relative to the recorded number in the same time."""
    first: float | None = None
    """Arrivals in the first 25 frames of samples, relative to the average over the sample."""


def check_models(scene: Scene) -> Iterator[Checked]:
    """Check each fitted model of a scene; on the plaza, the true process first.

    Raises:
        RecordingError: the recording has not been imported.
    """
    crowd, centres = recording_of(scene), read_areas(scene).spawn.mean
    areas = len(centres)
    blocks = blocks_of(crowd, scene)
    whole = arrivals_of(crowd, blocks, areas)
    folds = [arrivals_of(crowd, blocks.scored(split), areas) for split in SPLITS[1:]]
    fresh = None
    if scene.id == PLAZA:
        truth = PlazaArrivals(scene)
        # The true process and the fitted clusters number the areas differently.
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
        )
    for name in fitted_models(scene):
        # All fits of the other models are the same one.
        fits = range(scene.protocol.fits if name in NEURAL else 1)
        models = [_fitted(name, scene, "full", fit) for fit in fits]
        on_folds = [
            _pooled([_fitted(name, scene, split, fit) for split in SPLITS[1:]], folds)
            for fit in fits
        ]
        model, rng = models[0], np.random.default_rng(0)
        own = arrivals_in(model.sample(OWN_S, scene, rng), OWN_S, scene.grid_s, areas)
        persons, first = _counts(models * (scene.protocol.fits // len(models)), scene, whole)
        yield Checked(
            model=name,
            full=float(np.mean([m.log_likelihood(whole) for m in models])),
            heldout=float(np.mean(on_folds)),
            fresh=float(np.mean([m.log_likelihood(fresh) for m in models]))
            if fresh is not None
            else None,
            gaps=_test(model, whole, rng, "gap"),
            sizes=_test(model, whole, rng, "size"),
            own_gaps=_test(model, own, rng, "gap"),
            own_sizes=_test(model, own, rng, "size"),
            persons=persons,
            first=first,
        )


@dataclass(frozen=True, kw_only=True)
class Networks:
    """Number of areas of `ntpp-gmm` with a trained network; the other areas have constant rates."""

    areas: int
    """Number of spawn areas."""
    full: list[int]
    """Number of trained networks in each fit to the whole recording."""
    heldout: list[int]
    """Number of trained networks in all folds together, for each fit."""
    constant: float
    """Share of the persons who enter areas without a network, for fits to the whole recording."""

    def __str__(self) -> str:
        """The numbers as a text for users."""
        folds, low, high = len(SPLITS) - 1, min(self.full), max(self.full)
        span = f"{low}" if low == high else f"{low} to {high} (by fit)"
        return (
            f"ntpp-gmm has a trained network in {span} of {self.areas} areas if fitted "
            f"to the whole recording, and in {sum(self.heldout)} of "
            f"{len(self.heldout) * folds * self.areas} cases over all fits of all folds. "
            f"{self.constant:.0%} of the persons enter areas without a network, where groups enter "
            "at a constant rate as in poisson-groups."
        )


def trained_networks(scene: Scene) -> Networks:
    """Count the trained networks in the scene's fits of `ntpp-gmm`.

    Raises:
        WeightsError: the fits are missing or broken.
    """
    areas = read_areas(scene)
    full, heldout = (networks(scene, areas, splits) for splits in (SPLITS[:1], SPLITS[1:]))
    rate = PoissonGMM.read(scene, areas).rate
    return Networks(
        areas=len(areas.spawn),
        full=full.sum(axis=1).tolist(),
        heldout=heldout.sum(axis=1).tolist(),
        constant=float(((full == 0) * rate).sum(axis=1).mean() / rate.sum()),
    )


def _fitted(name: str, scene: Scene, split: str, fit: int) -> FittedModel:
    model = spawn_model(name, scene, split, fit)
    assert isinstance(model, FittedModel)
    return model


def _pooled(models: Sequence[FittedModel], folds: list[Arrivals]) -> float:
    nats = [m.log_likelihood(a) * len(a.tick) for m, a in zip(models, folds, strict=True)]
    return float(sum(nats) / sum(len(a.tick) for a in folds))


def _test(
    model: FittedModel, arrivals: Arrivals, rng: np.random.Generator, what: Literal["gap", "size"]
) -> groups.KolmogorovSmirnov | None:
    # Rates of `cox-gmm` are hidden; `ntpp-paper` has densities of gaps.
    if not isinstance(model, groups.HasHazards):
        return None
    return groups.kolmogorov_smirnov(groups.rescaled(model, arrivals, rng, what))


def _counts(models: list[FittedModel], scene: Scene, whole: Arrivals) -> tuple[float, float]:
    horizon_s, first_s = scene.horizon_s, FIRST_FRAMES * scene.dt_s
    times = [
        m.sample(horizon_s, scene, np.random.default_rng([k, fit])).time_s
        for fit, m in enumerate(models)
        for k in range(SAMPLES)
    ]
    per_s = float(np.mean([len(t) for t in times])) / horizon_s
    first_per_s = float(np.mean([(t < first_s - 1e-9).sum() for t in times])) / first_s
    return per_s / (len(whole.tick) / whole.exposure_s()), first_per_s / per_s
