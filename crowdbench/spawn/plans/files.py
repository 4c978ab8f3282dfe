"""The file `plans.json` of a scene: companions and ways, fitted for each split."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import structs

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import WeightsError
from crowdbench.files import read_struct, write_json
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, as_array
from crowdbench.spawn.plans.links import OFFSETS, STAGES, Adjustment, Links
from crowdbench.spawn.plans.mixtures import DECIMALS
from crowdbench.spawn.plans.planned import PlannedAreas
from crowdbench.spawn.plans.trip_files import (
    TripsFile,
    check_covariances,
    read_trips,
    written_trips,
)
from crowdbench.spawn.plans.ways import BEND, STOP, Ways
from crowdbench.spawn.weights import check_origin, hint

FILE = "plans.json"
SCHEMA = 4


class _Adjustment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    more: float
    larger: float
    along: Annotated[float, msgspec.Meta(gt=0)]
    across: Annotated[float, msgspec.Meta(gt=0)]


class _Plans(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    log_weight: list[float]
    tendency: list[float]
    larger: list[float]
    offset_share: list[float]
    offset_mean: list[list[float]]
    offset_covariance: list[list[list[float]]]
    offset_slope: list[float]
    same_side: float
    group_log_speed: float
    crowded: float
    trips: TripsFile
    ways: dict[str, Any]
    """The other arrays of `Ways` by name, as nested lists."""
    fastest_mps: float
    adjustments: dict[str, _Adjustment]
    """By the model that the times are from."""


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    model: str
    scene: str
    splits: dict[str, _Plans]


def write_plans(
    folder: Path,
    fits: Mapping[str, PlannedAreas],
    adjustments: Mapping[str, Mapping[str, Adjustment]] = MappingProxyType({}),
) -> None:
    """Write the fits of all splits into a scene's folder.

    `adjustments` has those of each split, by the model that the times are from.
    """
    splits = {
        split: _Plans(
            log_weight=fit.links.log_weight.tolist(),
            tendency=fit.links.tendency.tolist(),
            larger=fit.links.larger.tolist(),
            offset_share=fit.links.share.tolist(),
            offset_mean=fit.links.mean.tolist(),
            offset_covariance=fit.links.covariance.tolist(),
            offset_slope=fit.links.slope.tolist(),
            same_side=fit.links.same_side,
            group_log_speed=fit.links.group_log_speed,
            crowded=fit.links.crowded,
            trips=written_trips(fit.ways.trips),
            ways={name: getattr(fit.ways, name).round(DECIMALS).tolist() for name in _shapes(fit)},
            fastest_mps=fit.ways.fastest_mps,
            adjustments={
                times: _Adjustment(**asdict(by)) for times, by in adjustments.get(split, {}).items()
            },
        )
        for split, fit in fits.items()
    }
    scene = fits["full"].scene
    file = _File(schema=SCHEMA, model="plans", scene=scene, splits=splits)
    write_json(folder / FILE, file, compact=True)


def read_plans(scene: Scene, areas: Areas, split: str, times: str | None = None) -> PlannedAreas:
    """The areas with the plans that a scene ships for a split, adjusted to the times of a model.

    Raises:
        WeightsError: the file is missing or broken, belongs to another scene, or has no adjustment
            for this model.
    """
    path, how = scene.folder / FILE, hint(scene)
    file = read_struct(path, _File, WeightsError, how)
    origin = (file.model, file.scene, file.schema)
    check_origin(path, origin, ("plans", scene.id, SCHEMA), how)
    if set(file.splits) != set(SPLITS):
        raise WeightsError(
            f"{path}, splits",
            got=", ".join(sorted(file.splits)) or "nothing",
            expected=", ".join(SPLITS),
            hint=how,
        )
    of, size, where = file.splits[split], len(areas.spawn), f"{path}, splits.{split}"

    def array(values: list, shape: tuple[int, ...], name: str) -> np.ndarray:
        if not values and shape[0] == 0:  # JSON does not tell the other dimensions
            return np.zeros(shape)
        return as_array(values, shape, f"{where}.{name}", how)

    mixed = max(1, len(of.offset_share))
    links = Links(
        array(of.log_weight, (6,), "log_weight"),
        array(of.tendency, (size,), "tendency"),
        array(of.larger, (STAGES - 1,), "larger"),
        array(of.offset_share, (mixed,), "offset_share"),
        array(of.offset_mean, (mixed, OFFSETS), "offset_mean"),
        array(of.offset_covariance, (mixed, OFFSETS, OFFSETS), "offset_covariance"),
        array(of.offset_slope, (OFFSETS,), "offset_slope"),
        of.same_side,
        of.group_log_speed,
        of.crowded,
    )
    check_covariances(links.covariance, f"{where}.offset_covariance", how)
    if times is not None:
        if times not in of.adjustments:
            raise WeightsError(
                f"{where}.adjustments",
                got=", ".join(sorted(of.adjustments)) or "nothing",
                expected=f"{times}, the model that the times are from",
                hint=how,
            )
        links = links.adjusted(Adjustment(**structs.asdict(of.adjustments[times])))
    shapes = _shapes(areas, len(of.ways.get("stop_mean", [])))
    if set(of.ways) != set(shapes):
        raise WeightsError(
            f"{where}.ways",
            got=", ".join(sorted(of.ways)) or "nothing",
            expected=", ".join(sorted(shapes)),
            hint=how,
        )
    arrays = {name: array(of.ways[name], shape, f"ways.{name}") for name, shape in shapes.items()}
    for name in (name for name in arrays if name.endswith("covariance")):
        check_covariances(arrays[name], f"{where}.ways.{name}", how)
    trips = read_trips(of.trips, (size, len(areas.goal)), f"{where}.trips", how)
    ways = Ways(trips, **arrays, longer=np.zeros(size), fastest_mps=of.fastest_mps)
    return PlannedAreas.of(areas, links, ways)


def _shapes(areas: Areas, stops: int | None = None) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of `Ways`; `stops` is the number of places where people stop."""
    if isinstance(areas, PlannedAreas):
        stops = len(areas.ways.stop_mean)
    both, count = (len(areas.spawn), len(areas.goal)), stops or 0
    return {
        "bend_mean": (*both, BEND),
        "bend_covariance": (*both, BEND, BEND),
        "stopping": both,
        "stop_mean": (count, STOP),
        "stop_covariance": (count, STOP, STOP),
        "from_area": (count, both[0]),
        "to_area": (count, both[1]),
    }
