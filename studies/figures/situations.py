"""Figure `situations`: windows of the recording and the most similar windows of rollouts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.colours import COLOURS
from crowdbench.data.companions import groups_of
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError
from crowdbench.report.plots import panels
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from studies.figures.maps import Map, maps
from studies.figures.ways import Numbers
from studies.figures.windows import GROUP_S, WINDOW_S, Windows, situations

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = 2
"""Number of windows shown of the first spawn model; of others, one is shown."""
_WIDTH_IN = 2.3
_OTHERS = "0.55"
_BEFORE = "0.82"


@dataclass(frozen=True, eq=False)
class Match:
    """A window of a rollout and its distance from a recorded window."""

    rollout: int
    window: int
    apart: np.ndarray
    """Distances by routes, groups and presence, in people."""

    @property
    def distance(self) -> float:
        """Sum of the three distances, in people."""
        return float(self.apart.sum())


@dataclass(frozen=True, eq=False)
class Search:
    """Windows of one spawn model's rollouts that are similar to one recorded window."""

    best: list[Match]
    """The most similar windows, sorted by distance; none overlap."""
    median: float
    """Median distance of all windows."""
    each: list[float]
    """Smallest distance in each rollout; a rollout is as long as the recording."""


def search(rollouts: Sequence[Windows], recorded: Windows, k: int, wanted: int) -> Search:
    """Find the `wanted` windows of `rollouts` that are most similar to recorded window `k`."""
    apart = [windows.apart(recorded, k) for windows in rollouts]
    distance = [a.sum(axis=1) for a in apart]
    best: list[Match] = []
    free = [np.ones(len(windows), dtype=bool) for windows in rollouts]
    for _ in range(wanted):
        left = [np.where(f, d, np.inf) for f, d in zip(free, distance, strict=True)]
        r = int(np.argmin([d.min() for d in left]))
        w = int(left[r].argmin())
        if np.isinf(left[r][w]):
            break
        best.append(Match(r, w, apart[r][w]))
        free[r] &= rollouts[r].away_from(w)
    return Search(
        best, float(np.median(np.concatenate(distance))), [float(d.min()) for d in distance]
    )


def draw_situations(
    scene: Scene,
    areas: Areas,
    recording: Trajectories,
    rollouts: Mapping[str, Sequence[Trajectories]],
    policy: str,
) -> tuple[bytes, Numbers]:
    """The picture and its numbers; `rollouts` are by spawn model, all with policy `policy`.

    Raises:
        RecordingError: the observed time is too short to compare windows.
    """
    recorded = Windows.of(recording, areas)
    if not len(recorded) or np.ptp(recorded.start) < 2 * recorded.frames:  # some have no other
        raise RecordingError(
            f"situations of {scene.id}",
            got=f"{len(recorded)} observed windows of {WINDOW_S:g} s",
            expected=f"windows from {3 * WINDOW_S:g} s or more of observed time",
            hint="Request other figures with --figure.",
        )
    windows = {model: [Windows.of(c, areas) for c in crowds] for model, crowds in rollouts.items()}
    wanted = {model: SHOWN if n == 0 else 1 for n, model in enumerate(rollouts)}
    shown: list[Map] = []
    numbers: list[Numbers] = []
    for kind, (k, people) in situations(recorded, areas).items():
        own = recorded.apart(recorded, k).sum(axis=1)[recorded.away_from(k)]
        found = {m: search(each, recorded, k, wanted[m]) for m, each in windows.items()}
        colours = _colours(recorded, k, areas)
        drawn = partial(_map, scene=scene, colours=colours, frames=recorded.frames)
        title = (
            f"{kind}: {people} of {recorded.entered[k]} who enter\n"
            f"others: nearest {own.min():.3g}, median {np.median(own):.3g}"
        )
        shown.append((title, partial(drawn, crowd=recording, start=int(recorded.start[k]))))
        numbers.append(_of_recording(kind, k, people, recorded, own, scene))
        for model, of_model in found.items():
            for match in of_model.best:
                start = int(windows[model][match.rollout].start[match.window])
                crowd = rollouts[model][match.rollout]
                shown.append((_title(model, match), partial(drawn, crowd=crowd, start=start)))
        numbers[-1]["simulated"] = {
            m: _of_model(of_model, windows[m], own, scene) for m, of_model in found.items()
        }
    picture = maps(scene, shown, width=_WIDTH_IN, columns=1 + sum(wanted.values()),
                   handles=_key(policy), legend_columns=2)  # fmt: skip
    return picture, {
        "window_s": WINDOW_S,
        "group_s": GROUP_S,
        "recorded_windows": len(recorded),
        "simulated_windows": {m: [len(w) for w in each] for m, each in windows.items()},
        "situations": numbers,
    }


def _title(model: str, match: Match) -> str:
    ways, groups, presence = match.apart
    parts = f"ways {ways:.0f}, groups {groups:.0f}, N {presence:.3g}"
    return f"{model}: {match.distance:.3g} apart\n{parts}"


def _colours(recorded: Windows, k: int, areas: Areas) -> dict[tuple[int, int], str]:
    """A colour for each of the most common routes of a window, by spawn and goal area."""
    goals = len(areas.goal) + 1
    order = np.argsort(-recorded.ways[k], kind="stable")[: len(COLOURS)]
    common = [divmod(int(way), goals) for way in order if recorded.ways[k, way]]
    return dict(zip(common, COLOURS, strict=False))


def _map(
    axis: "Axes",
    scene: Scene,
    crowd: Trajectories,
    start: int,
    frames: int,
    colours: Mapping[tuple[int, int], str],
) -> None:
    """Draw the paths within a window; people who enter in it are coloured by route."""
    panels.place(axis, scene)
    stop = start + frames
    starts: dict[int, list[np.ndarray]] = {}
    group = groups_of(crowd)  # by the same rule in recordings and rollouts
    for p in np.flatnonzero((crowd.first < stop) & (crowd.last >= start)).tolist():
        first = int(crowd.first[p])
        path = crowd.path(p)[max(0, start - first) : stop - first]
        if first < start or not crowd.entered[p]:
            axis.plot(*path.T, color=_BEFORE, linewidth=0.6, zorder=1.5)
            continue
        way = (int(crowd.spawn_area[p]), int(crowd.goal_area[p]))
        colour = colours.get(way, _OTHERS)
        axis.plot(*path.T, color=colour, linewidth=0.9, zorder=2 + (way in colours))
        axis.plot(*path[0], "o", color=colour, markersize=3.5, markeredgewidth=0, zorder=4)
        if group[p] >= 0:
            starts.setdefault(int(group[p]), []).append(path[0])
    for members in starts.values():
        axis.plot(*np.array(members).T, color="black", linewidth=0.7, zorder=3.5)


def _key(policy: str) -> list[Any]:
    from matplotlib.lines import Line2D

    way: dict[str, Any] = {"linewidth": 0.9, "marker": "o", "markersize": 3.5}
    return [
        Line2D([], [], color=COLOURS[0], **way, label="enters (dot); colour: spawn and goal area"),
        Line2D([], [], color=_OTHERS, **way, label="enters, by none of its row's six ways"),
        Line2D([], [], color=_BEFORE, linewidth=0.9, label="was there before"),
        Line2D([], [], color="black", linewidth=0.7, label="companions, at their entries"),
        Line2D([], [], linestyle="", label=f"simulated people are walked by {policy}"),
    ]


def _of_recording(
    kind: str, k: int, people: int, recorded: Windows, own: np.ndarray, scene: Scene
) -> Numbers:
    """Numbers of a recorded window: counts only, to publish no recorded path or arrival."""
    return {
        "situation": kind,
        "start_s": round(float(recorded.start[k] * scene.dt_s), 1),
        "entered": int(recorded.entered[k]),
        "show_it": people,
        "groups_by_size": _groups_by_size(recorded, k),
        "mean_present": round(float(recorded.present[k].mean()), 2),
        "nearest_recorded": round(float(own.min()), 2),
        "median_recorded": round(float(np.median(own)), 2),
    }


def _of_model(found: Search, windows: Sequence[Windows], own: np.ndarray, scene: Scene) -> Numbers:
    return {
        "nearest": [
            {
                "rollout": match.rollout,
                "start_s": round(float(windows[match.rollout].start[match.window] * scene.dt_s), 1),
                "distance": round(match.distance, 2),
                "ways": float(match.apart[0]),
                "groups": float(match.apart[1]),
                "presence": round(float(match.apart[2]), 2),
                "closer_than_recorded_windows": round(float((own > match.distance).mean()), 4),
            }
            for match in found.best
        ],
        "nearest_of_each_rollout": [round(d, 2) for d in found.each],
        "median": round(found.median, 2),
    }


def _groups_by_size(windows: Windows, k: int) -> dict[str, int]:
    """Number of groups of each size that enter in a window."""
    members = windows.members[k].astype(np.int64)
    exactly = members - np.r_[members[1:], 0]
    return {str(size + 1): int(n) for size, n in enumerate(exactly) if n}
