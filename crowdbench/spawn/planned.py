"""Plans on top of any arrival process: companions, and ways with stops and via points.

`PlannedAreas` are areas whose people do not come alone: spawn models that draw places from them
become models of plans. The fits are in `plans.json`, one for each split; as with areas, all models
of a scene share them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.errors import WeightsError
from crowdbench.files import read_struct, write_json
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, as_array
from crowdbench.spawn.events import SpawnEvents, entering
from crowdbench.spawn.links import FEWEST, OFFSETS, Links, candidates, fit_links
from crowdbench.spawn.plans import SLOWEST_MPS, plans_of
from crowdbench.spawn.ways import BEND, STOP, WALK, Ways, fit_ways
from crowdbench.spawn.weights import check_origin, hint
from crowdbench.trajectories.blocks import SPLITS, TimeBlocks
from crowdbench.trajectories.companions import groups_of
from crowdbench.trajectories.table import Trajectories

FILE = "plans.json"
SCHEMA = 1
_TRIES = 20
"""Number of ways that are drawn for a companion, who otherwise gets that of the person it joins."""
_COMMON_M = 2.0


class _Plans(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    log_weight: list[float]
    tendency: list[float]
    offset_mean: list[float]
    offset_slope: list[float]
    offset_covariance: list[list[float]]
    group_log_speed: float
    ways: dict[str, Any]
    """Arrays of `Ways` by name, as nested lists."""
    fastest_mps: float


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    model: str
    scene: str
    splits: dict[str, _Plans]


@dataclass(frozen=True, eq=False)
class PlannedAreas(Areas):
    """Areas whose people have companions, and ways of their own."""

    links: Links
    ways: Ways

    @classmethod
    def of(cls, areas: Areas, links: Links, ways: Ways) -> "PlannedAreas":
        """The areas with these models of companions and ways."""
        known = {field.name: getattr(areas, field.name) for field in fields(Areas)}
        return cls(**known, links=links, ways=ways)

    def draw(
        self,
        time_s: Float[np.ndarray, " E"],
        spawn_area: Int[np.ndarray, " E"],
        scene: Scene,
        rng: Generator,
    ) -> SpawnEvents:
        """Draw a plan for each arrival; companions have plans that differ by an offset."""
        order = np.argsort(time_s, kind="stable")
        time_s, area = time_s[order], spawn_area[order]
        joins = self.links.draw(time_s, area, rng)
        leader = _leaders(joins)
        first = joins < 0
        goal_area = np.zeros(len(time_s), dtype=np.int64)
        cumulative = self.flow.cumsum(axis=1)[area[first]]
        u = rng.random((len(cumulative), 1)) * cumulative[:, -1:]
        goal_area[first] = (u >= cumulative).sum(axis=1)
        goal_area = goal_area[leader]
        ways = np.full((len(time_s), 8), np.nan)
        ways[first] = self.ways.draw(area[first], goal_area[first], scene, rng)
        size = np.bincount(leader, minlength=len(joins))
        together = size[leader] > 1
        slower = first & together
        ways[slower, 4] = self._possible_speed(ways[slower, 4] + self.links.group_log_speed)
        self._place_companions(ways, time_s, joins, leader, scene, rng)
        number = np.cumsum(size > 1) - 1
        stops = np.isfinite(ways[:, 7])
        return entering(
            time_s=time_s,
            start=ways[:, :2],
            goal=ways[:, 2:4],
            spawn_area=area,
            goal_area=goal_area,
            speed=np.exp(ways[:, 4]),
            group=np.where(together, number[leader], -1),
            via=ways[:, 5:7],
            wait_s=np.where(stops, np.exp(np.where(stops, ways[:, 7], 0.0)), 0.0),
        )

    def _place_companions(
        self,
        ways: Float[np.ndarray, "E 8"],
        time_s: Float[np.ndarray, " E"],
        joins: Int[np.ndarray, " E"],
        leader: Int[np.ndarray, " E"],
        scene: Scene,
        rng: Generator,
    ) -> None:
        """Fill in the ways of those who join somebody, the second of each group first."""
        rank = _ranks(leader)
        groups, of_group = np.unique(leader, return_inverse=True)
        members = np.full((len(groups), int(rank.max(initial=0)) + 1), -1)
        members[of_group, rank] = np.arange(len(leader))
        for place in range(1, members.shape[1]):
            open_ = members[:, place]
            open_ = open_[open_ >= 0]
            for _ in range(_TRIES):
                other = joins[open_]
                walked = np.exp(ways[other, 4]) * (time_s[open_] - time_s[other])
                drawn = self._beside(ways[other], walked, scene, rng)
                good = scene.walkable(drawn[:, :2]) & scene.walkable(drawn[:, 2:4])
                earlier = members[of_group[open_], :place]
                distance = _closest_m(
                    drawn[:, None], time_s[open_][:, None], ways[earlier], time_s[earlier]
                )
                good &= distance.min(axis=1) >= 2 * scene.motion.person_radius_m
                ways[open_[good]] = drawn[good]
                open_ = open_[~good]
                if len(open_) == 0:
                    break
            ways[open_] = ways[joins[open_]]

    def _beside(
        self,
        ways: Float[np.ndarray, "n 8"],
        walked_m: Float[np.ndarray, " n"],
        scene: Scene,
        rng: Generator,
    ) -> Float[np.ndarray, "n 8"]:
        """Ways of people who join those with these ways, who have walked this far."""
        offset = self.links.offsets(walked_m, rng)
        ahead = _directions(ways[:, 2:4] - ways[:, :2])
        at_start, at_goal = _turned(ahead, offset[:, :2]), _turned(ahead, offset[:, 2:4])
        found = ways.copy()
        found[:, :2] += at_start
        found[:, 2:4] += at_goal
        via = found[:, 5:7] + (at_start + at_goal) / 2
        free = np.isfinite(via[:, 0])
        free[free] = scene.walkable(via[free])
        found[free, 5:7] = via[free]
        found[:, 4] = self._possible_speed(found[:, 4] + offset[:, 4])
        return found

    def _possible_speed(self, log_speed: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.clip(log_speed, *np.log([SLOWEST_MPS, self.ways.fastest_mps]))


def fit_plans(crowd: Trajectories, blocks: TimeBlocks, areas: Areas) -> PlannedAreas:
    """Fit companions and ways to the people who enter in the time blocks.

    `crowd` is a recording as `fit_areas` returns it.

    Raises:
        SceneError: no trip is complete.
    """
    persons, _, _ = blocks.of_arrivals(crowd)
    persons = persons[crowd.spawn_area[persons] >= 0]
    persons = persons[np.argsort(crowd.spawn_s[persons], kind="stable")]
    time_s = crowd.spawn_s[persons]
    area = crowd.spawn_area[persons].astype(np.int64)
    group, plans = groups_of(crowd)[persons].astype(np.int64), plans_of(crowd)
    earlier = _companion(time_s, area, group)
    later = np.flatnonzero(earlier >= 0)
    known = np.isfinite(plans.speed[persons]) & crowd.left[persons]
    later = later[known[later] & known[earlier[later]]]
    pairs = persons[later], persons[earlier[later]]
    offsets = _offsets(crowd, plans.speed, *pairs)
    walked_m = plans.speed[pairs[1]] * (crowd.spawn_s[pairs[0]] - crowd.spawn_s[pairs[1]])
    first = np.zeros(len(crowd), dtype=bool)
    first[persons[earlier < 0]] = True
    in_group = np.zeros(len(crowd), dtype=bool)
    in_group[persons[group >= 0]] = True
    log_speed = np.log(plans.speed)
    walks = first & np.isfinite(log_speed)
    slower = 0.0
    if min((walks & in_group).sum(), (walks & ~in_group).sum()) >= FEWEST:
        slower = float(log_speed[walks & in_group].mean() - log_speed[walks & ~in_group].mean())
    links = replace(
        fit_links(time_s, area, group, offsets, walked_m, len(areas.spawn)),
        group_log_speed=slower,
    )
    # Ways are those of people who are alone; companions get them from the first of their group.
    as_alone = replace(plans, speed=np.where(in_group, plans.speed * np.exp(-slower), plans.speed))
    return PlannedAreas.of(areas, links, fit_ways(crowd, as_alone, areas, first))


def _companion(
    time_s: Float[np.ndarray, " E"], area: Int[np.ndarray, " E"], group: Int[np.ndarray, " E"]
) -> Int[np.ndarray, " E"]:
    """The last person of the same group who entered the same area before each person; else −1."""
    pairs = candidates(time_s, area)
    same = (group[pairs.later] >= 0) & (group[pairs.later] == group[pairs.earlier])
    found = np.full(len(time_s), -1)
    found[pairs.later[same]] = pairs.earlier[same]  # sorted: the last one stays
    return found


def _offsets(
    crowd: Trajectories,
    speed: Float[np.ndarray, " P"],
    later: Int[np.ndarray, " n"],
    earlier: Int[np.ndarray, " n"],
) -> Float[np.ndarray, "n 5"]:
    """Offsets of people to those whom they join; see `links.OFFSETS`."""
    start, goal = crowd.start.astype(np.float64), crowd.goal.astype(np.float64)
    ahead = _directions(goal[earlier] - start[earlier])
    back = ahead * [1.0, -1.0]
    return np.column_stack(
        [
            _turned(back, start[later] - start[earlier]),
            _turned(back, goal[later] - goal[earlier]),
            _log_ratios(crowd, speed, later, earlier),
        ]
    )


def _log_ratios(
    crowd: Trajectories,
    speed: Float[np.ndarray, " P"],
    later: Int[np.ndarray, " n"],
    earlier: Int[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Log ratio of the distances that two people cover while both are there.

    Speeds of whole lives would differ more: one of two companions may have stopped alone, before
    the other one entered. They are used where the common distance is too short.
    """
    found = np.log(speed[later] / speed[earlier])
    for k, (i, j) in enumerate(zip(later.tolist(), earlier.tolist(), strict=True)):
        begin = max(crowd.first[i], crowd.first[j])
        end = min(crowd.last[i], crowd.last[j])
        if end <= begin:
            continue
        ways = [
            float(np.hypot(*(path[end - since] - path[begin - since])))
            for path, since in (
                (crowd.path(i), crowd.first[i]),
                (crowd.path(j), crowd.first[j]),
            )
        ]
        if min(ways) >= _COMMON_M:
            found[k] = np.log(ways[0] / ways[1])
    return found


def _leaders(joins: Int[np.ndarray, " E"]) -> Int[np.ndarray, " E"]:
    """The first person of each person's group; `joins` are earlier persons, or −1."""
    leader = np.where(joins < 0, np.arange(len(joins)), joins)
    while (leader[leader] != leader).any():
        leader = leader[leader]
    return leader


def _ranks(leader: Int[np.ndarray, " E"]) -> Int[np.ndarray, " E"]:
    """Place of each person in its group: 0 for the first one, who leads it."""
    order = np.argsort(leader, kind="stable")
    size = np.bincount(leader, minlength=len(leader))
    before = np.cumsum(size) - size
    rank = np.empty(len(leader), dtype=np.int64)
    rank[order] = np.arange(len(leader)) - before[leader[order]]
    return rank


def _closest_m(
    one: Float[np.ndarray, "n 1 8"],
    one_s: Float[np.ndarray, "n 1"],
    other: Float[np.ndarray, "n m 8"],
    other_s: Float[np.ndarray, "n m"],
) -> Float[np.ndarray, "n m"]:
    """Least distance of straight walkers with these ways while both are there, metres.

    Those who are never there together are infinitely far apart.
    """

    def moves(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        direction = way[..., 2:4] - way[..., :2]
        length = np.maximum(np.linalg.norm(direction, axis=-1), 1e-9)
        speed = np.exp(way[..., 4])
        return direction / length[..., None] * speed[..., None], length / speed

    (v, life), (w, other_life) = moves(one), moves(other)
    begin = np.maximum(one_s, other_s)
    end = np.minimum(one_s + life, other_s + other_life)
    gap = (
        one[..., :2] + v * (begin - one_s)[..., None]
        - other[..., :2] - w * (begin - other_s)[..., None]
    )  # fmt: skip
    drift = v - w
    when = -(gap * drift).sum(axis=-1) / np.maximum((drift * drift).sum(axis=-1), 1e-12)
    when = np.clip(when, 0.0, np.maximum(end - begin, 0.0))
    distance = np.linalg.norm(gap + drift * when[..., None], axis=-1)
    return np.asarray(np.where(end >= begin, distance, np.inf))


def _directions(way: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    length = np.maximum(np.hypot(*way.T), 1e-9)
    return np.asarray(way / length[:, None])


def _turned(
    direction: Float[np.ndarray, "n 2"], vector: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """The vectors, turned by the angle of the directions."""
    (cos, sin), (x, y) = direction.T, vector.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])


def write_plans(folder: Path, fits: Mapping[str, PlannedAreas]) -> None:
    """Write the fits of all splits into a scene's folder."""
    splits = {
        split: _Plans(
            log_weight=fit.links.log_weight.tolist(),
            tendency=fit.links.tendency.tolist(),
            offset_mean=fit.links.mean.tolist(),
            offset_slope=fit.links.slope.tolist(),
            offset_covariance=fit.links.covariance.tolist(),
            group_log_speed=fit.links.group_log_speed,
            ways={name: getattr(fit.ways, name).tolist() for name in _shapes(fit)},
            fastest_mps=fit.ways.fastest_mps,
        )
        for split, fit in fits.items()
    }
    scene = fits["full"].scene
    write_json(folder / FILE, _File(schema=SCHEMA, model="plans", scene=scene, splits=splits))


def read_plans(scene: Scene, areas: Areas, split: str) -> PlannedAreas:
    """The areas with the plans that a scene ships for a split.

    Raises:
        WeightsError: the file is missing or broken, or belongs to another scene.
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

    links = Links(
        array(of.log_weight, (6,), "log_weight"),
        array(of.tendency, (size,), "tendency"),
        array(of.offset_mean, (OFFSETS,), "offset_mean"),
        array(of.offset_slope, (OFFSETS,), "offset_slope"),
        array(of.offset_covariance, (OFFSETS, OFFSETS), "offset_covariance"),
        of.group_log_speed,
    )
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
        if arrays[name].size and not (np.linalg.eigvalsh(arrays[name]) > 0).all():
            raise WeightsError(
                f"{where}.ways.{name}",
                got="invalid values",
                expected="symmetric, positive definite matrices",
                hint=how,
            )
    ways = Ways(**arrays, fastest_mps=of.fastest_mps)
    return PlannedAreas.of(areas, links, ways)


def _shapes(areas: Areas, stops: int | None = None) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of `Ways`; `stops` is the number of places where people stop."""
    if isinstance(areas, PlannedAreas):
        stops = len(areas.ways.stop_mean)
    both, count = (len(areas.spawn), len(areas.goal)), stops or 0
    return {
        "trip_mean": (*both, WALK),
        "trip_covariance": (*both, WALK, WALK),
        "bend_mean": (*both, BEND),
        "bend_covariance": (*both, BEND, BEND),
        "stopping": both,
        "stop_mean": (count, STOP),
        "stop_covariance": (count, STOP, STOP),
        "from_area": (count, both[0]),
        "to_area": (count, both[1]),
    }
