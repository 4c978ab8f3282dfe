"""What people on the plaza do: true areas, companions who walk abreast, and stops.

A group has one start, goal, speed and plan. Its members stand in a line across the way, in the
order in which they entered, and keep their place in it at the start, at the stop and at the goal:
each is 0.7 m (standard deviation 0.1 m) beside the one before, with the middle of the line at the
group's place. Groups are slower than people who are alone. Some groups stop once, at the kiosk or
at a bench, for a log-normal time. The places are redrawn until the whole group has room there.
"""

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.events import SpawnEvents, entering

CENTRES_M = np.array(
    [[1.5, 9.5], [28.5, 10.0], [16.5, 18.5], [12.0, 1.5]]
)  # west, east, north, south
SPREAD_M = np.array([[0.4, 0.9], [0.4, 0.8], [0.9, 0.4], [0.8, 0.4]])
FLOW = np.array(
    [[0.0, 0.5, 0.3, 0.2], [0.6, 0.0, 0.1, 0.3], [0.3, 0.2, 0.0, 0.5], [0.2, 0.3, 0.5, 0.0]]
)
SPEED_MPS, SPEED_SD_MPS = 1.34, 0.26  # Weidmann (1993), Transporttechnik der Fußgänger

ABREAST_M, ABREAST_SD_M = 0.7, 0.1
SLOWER = 0.9
"""Speed of groups, relative to that of people who are alone."""
STOPPING = 0.15
"""P(a group, or a person who is alone, stops on its way)."""
PLACES_M = np.array([[19.5, 10.8], [9.0, 12.0]])  # in front of the kiosk, at a bench
PLACE_SPREAD_M = np.array([[0.5, 0.4], [0.5, 0.4]])
PLACE_SHARE = np.array([0.6, 0.4])
WAIT_S = np.array([12.0, 20.0])
"""Median wait at each place."""
WAIT_LOG_SD = np.array([0.4, 0.4])
_DRAWS = 100


def true_areas(scene: str) -> Areas:
    """The true areas, flows and speeds of the plaza. The places are those of whole groups."""
    from scipy.stats import norm

    gaussians = _gaussians(CENTRES_M, SPREAD_M)
    levels = np.linspace(0.005, 0.995, 101)  # a normal truncated at 2.6 standard deviations
    return Areas(
        scene=scene,
        spawn=gaussians,
        goal=gaussians,
        flow=FLOW,
        speed_quantiles=SPEED_MPS + SPEED_SD_MPS * norm.ppf(levels),
        left_out=(0.0, 0.0),
    )


def draw_plans(
    time_s: Float[np.ndarray, " E"],
    area: Int[np.ndarray, " G"],
    group: Int[np.ndarray, " E"],
    areas: Areas,
    scene: Scene,
    rng: Generator,
) -> SpawnEvents:
    """Draw the plans of people who enter at these times (ascending, seconds).

    `area` is the spawn area of each group, `group` the group of each person.
    """
    size = np.bincount(group, minlength=len(area))
    # Places, speeds and goals of the groups are drawn as for people who are alone.
    alone = areas.draw(np.zeros(len(area)), area, scene, rng)
    goal_area = alone.goal_area.astype(np.int64)
    speed = alone.speed * np.where(size > 1, SLOWER, 1.0)
    stops = rng.random(len(area)) < STOPPING
    place = rng.choice(len(PLACES_M), len(area), p=PLACE_SHARE)
    wait_s = WAIT_S[place] * np.exp(WAIT_LOG_SD[place] * rng.standard_normal(len(area)))
    points = _points(area, goal_area, place, group, _aside(group, size, rng), areas, scene, rng)
    number = np.cumsum(size > 1) - 1
    return entering(
        time_s=time_s,
        start=points[:, 0],
        goal=points[:, 1],
        spawn_area=area[group],
        goal_area=goal_area[group],
        speed=speed[group],
        group=np.where(size > 1, number, -1)[group],
        via=np.where(stops[group, None], points[:, 2], np.nan),
        wait_s=np.where(stops, wait_s, 0.0)[group],
    )


def _aside(
    group: Int[np.ndarray, " E"], size: Int[np.ndarray, " G"], rng: Generator
) -> Float[np.ndarray, " E"]:
    """Place of each person in the line of its group: metres to the left of the middle."""
    order = np.argsort(group, kind="stable")
    gap = rng.normal(ABREAST_M, ABREAST_SD_M, len(group))
    along = np.empty(len(group))
    along[order] = np.cumsum(gap)  # the gap before the first member shifts the line, no more
    middle = np.bincount(group, along, len(size)) / np.maximum(size, 1)
    side = np.where(rng.random(len(size)) < 0.5, -1.0, 1.0)
    return np.asarray(side[group] * (along - middle[group]))


def _points(
    area: Int[np.ndarray, " G"],
    goal_area: Int[np.ndarray, " G"],
    place: Int[np.ndarray, " G"],
    group: Int[np.ndarray, " E"],
    aside_m: Float[np.ndarray, " E"],
    areas: Areas,
    scene: Scene,
    rng: Generator,
) -> Float[np.ndarray, "E 3 2"]:
    """Start, goal and place of a stop of each person."""
    places = _gaussians(PLACES_M, PLACE_SPREAD_M)
    middle = np.empty((len(area), 3, 2))
    points = np.empty((len(group), 3, 2))
    open_ = np.arange(len(area))
    for _ in range(_DRAWS):
        kinds = ((areas.spawn, area), (areas.goal, goal_area), (places, place))
        for k, (gaussians, of_group) in enumerate(kinds):
            middle[open_, k] = gaussians.draw(of_group[open_], scene, rng)
        way = middle[:, 1] - middle[:, 0]
        left = np.column_stack([-way[:, 1], way[:, 0]]) / np.linalg.norm(way, axis=1)[:, None]
        points = middle[group] + (aside_m[:, None] * left[group])[:, None]
        inside = scene.walkable(points.reshape(-1, 2)).reshape(-1, 3).all(axis=1)
        open_ = np.unique(group[~inside])
        if len(open_) == 0:
            return points
    # The largest groups are wider than their street: some of them stand at its walls.
    return scene.nearest_walkable(points.reshape(-1, 2)).reshape(-1, 3, 2)


def _gaussians(mean: Float[np.ndarray, "K 2"], spread: Float[np.ndarray, "K 2"]) -> Gaussians:
    return Gaussians(mean, np.stack([np.diag(sd**2) for sd in spread]))
