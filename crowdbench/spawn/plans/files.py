"""The file `plans.json` of a scene: companions and ways, fitted for each split."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import structs

from crowdbench.errors import WeightsError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.arrays import DEFINITE, Fit, Rule, are_definite, hint
from crowdbench.spawn.fits import FitFile
from crowdbench.spawn.plans.links import Adjustment, Links
from crowdbench.spawn.plans.mixtures import DECIMALS
from crowdbench.spawn.plans.planned import PlannedAreas
from crowdbench.spawn.plans.ways import TripMixtures, Ways

_SHARES = "shares that sum to 1"


class _Ways(msgspec.Struct, frozen=True, forbid_unknown_fields=True, eq=False):
    """The arrays of `Ways`, but for those of trips; `C` is the number of places of stops."""

    bend_covariance: Float[np.ndarray, "K G 2 2"]
    bend_mean: Float[np.ndarray, "K G 2"]
    from_area: Float[np.ndarray, "C K"]
    ranks: Float[np.ndarray, "R 2"]
    stop_covariance: Float[np.ndarray, "C 3 3"]
    stop_mean: Float[np.ndarray, "C 3"]
    stopping: Float[np.ndarray, "K G"]
    to_area: Float[np.ndarray, "C G"]


class PlansFit(Fit, frozen=True):
    """`Links` and `Ways`, and by the model that the times are from, adjustments of the links."""

    log_weight: Float[np.ndarray, " 6"]
    tendency: Float[np.ndarray, " K"]
    larger: Float[np.ndarray, " 3"]
    share: Float[np.ndarray, " C"] = msgspec.field(name="offset_share")
    mean: Float[np.ndarray, "C 5"] = msgspec.field(name="offset_mean")
    covariance: Float[np.ndarray, "C 5 5"] = msgspec.field(name="offset_covariance")
    slope: Float[np.ndarray, " 5"] = msgspec.field(name="offset_slope")
    same_side: float
    group_log_speed: float
    crowded: float
    trips: TripMixtures
    ways: _Ways
    fastest_mps: float
    adjustments: dict[str, Adjustment]

    def rules(self, scene: Scene) -> Iterator[Rule]:
        """Shares sum to 1, covariances are definite, and trips are between places of all areas."""
        trips, (spawn, goal) = self.trips, self.ways.stopping.shape
        for name, by in self.adjustments.items():
            yield f"adjustments.{name}", by.along > 0 and by.across > 0, "along and across > 0"
        for name, places, count in (("starts", trips.starts, spawn), ("goals", trips.goals, goal)):
            every = set(places.area.tolist()) == set(range(count))
            yield f"trips.{name}.area", every, f"places in all of {count} areas"
            shares = _are_shares(places.weight[None], places.area)
            yield f"trips.{name}.weight", shares, _SHARES
            yield f"trips.{name}.covariance", are_definite(places.covariance), DEFINITE
        both = len(trips.starts), len(trips.goals)
        yield "trips.weight", trips.weight.shape == both, f"weights of shape {both}"
        # Weights in the rows and columns of two areas sum to 1.
        rows = [trips.weight[trips.starts.area == a].sum(axis=0) for a in range(spawn)]
        shares = _are_shares(np.stack(rows), trips.goals.area)
        yield "trips.weight", shares and (trips.weight >= 0).all(), _SHARES
        yield "trips.log_speed", trips.log_speed[1] > 0, "a mean and a positive variance"
        known = ((trips.own >= 0) & (trips.own < both)).all()
        different = len(np.unique(trips.own, axis=0)) == len(trips.own)
        yield "trips.own", known and different, "different pairs of places"
        ranks = self.ways.ranks
        rising = len(ranks) >= 2 and (np.diff(ranks, axis=0) > 0).all()
        yield "ways.ranks", rising, "two or more pairs of ascending numbers"
        for name, matrices in (
            ("trips.covariance", trips.covariance),
            ("offset_covariance", self.covariance),
            ("ways.bend_covariance", self.ways.bend_covariance),
            ("ways.stop_covariance", self.ways.stop_covariance),
        ):
            yield name, are_definite(matrices), DEFINITE


PLANS = FitFile("plans", 5, PlansFit, compact=True)
FILE = PLANS.name


def write_plans(
    folder: Path,
    fits: Mapping[str, PlannedAreas],
    adjustments: Mapping[str, Mapping[str, Adjustment]] = MappingProxyType({}),
) -> None:
    """Write the fits of all splits into a scene's folder.

    `adjustments` has those of each split, by the model that the times are from.
    """
    written = {}
    for split, fit in fits.items():
        links = {f.name: getattr(fit.links, f.name) for f in fields(Links)}
        ways = _rounded(fit.ways)
        written[split] = [
            PlansFit(
                **links,
                trips=ways.trips,
                ways=_Ways(*(getattr(ways, name) for name in _Ways.__struct_fields__)),
                fastest_mps=ways.fastest_mps,
                adjustments=dict(adjustments.get(split, {})),
            )
        ]
    PLANS.write(folder, fits["full"].scene, written)


def read_plans(scene: Scene, areas: Areas, split: str, times: str | None = None) -> PlannedAreas:
    """The areas with the plans that a scene ships for a split, adjusted to the times of a model.

    Raises:
        SettingError: the split does not exist.
        WeightsError: the file is missing or broken, belongs to another scene, or has no adjustment
            for this model.
    """
    fit = PLANS.read(scene, areas, split)
    links = Links(**{f.name: getattr(fit, f.name) for f in fields(Links)})
    if times is not None:
        if times not in fit.adjustments:
            raise WeightsError(
                f"{scene.folder / FILE}, splits.{split}.adjustments",
                got=", ".join(sorted(fit.adjustments)) or "nothing",
                expected=f"{times}, the model that the times are from",
                hint=hint(scene),
            )
        links = links.adjusted(fit.adjustments[times])
    ways = Ways(
        fit.trips,
        **structs.asdict(fit.ways),
        longer=np.zeros(len(areas.spawn)),
        fastest_mps=fit.fastest_mps,
    )
    return PlannedAreas.of(areas, links, ways)


def _rounded(fit: Any) -> Any:
    """The arrays of a dataclass, and of those in it, rounded for a file."""
    values = {f.name: getattr(fit, f.name) for f in fields(fit)}
    changed = {n: x.round(DECIMALS) for n, x in values.items() if isinstance(x, np.ndarray)}
    changed |= {n: _rounded(x) for n, x in values.items() if is_dataclass(x)}
    return replace(fit, **changed)


def _are_shares(weight: np.ndarray, area: np.ndarray) -> bool:
    """Whether weights (rows, places) are not negative, and sum to 1 in each row and area."""
    sums = np.stack([weight[:, area == g].sum(axis=1) for g in np.unique(area)])
    return bool((weight >= 0).all() and np.allclose(sums, 1, atol=1e-3))
