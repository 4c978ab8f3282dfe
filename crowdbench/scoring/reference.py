"""A scene's reference statistics, which allow comparisons without the recording itself.

They are the metrics' statistics per time block. Distances computed from them equal those computed
from the recording. Paths, arrival times and per-frame series cannot be reconstructed from them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories, from_rows
from crowdbench.errors import RecordingError, SceneError, WeightsError, did_you_mean
from crowdbench.files import read_bytes, read_struct, write_json
from crowdbench.metrics import (
    METRICS,
    Metric,
    MetricResult,
    Place,
    Statistics,
    all_metrics,
    blamed,
    metrics_for,
)
from crowdbench.scene import Scene, Walking
from crowdbench.spawn.areas import Areas, read_areas
from crowdbench.spawn.events import blocks_of

SCHEMA = 3


@dataclass(frozen=True, eq=False)
class Reference:
    """The statistics of a scene's recording."""

    blocks: TimeBlocks
    place: Place
    statistics: dict[str, Statistics]
    """Statistics per block by name of metric, for the metrics that apply to these blocks."""

    @classmethod
    def of(cls, recording: Trajectories, scene: Scene, areas: Areas) -> "Reference":
        """Summarise a recording in the time blocks of the scene's protocol."""
        blocks = blocks_of(recording, scene)
        place = place_of(scene, areas)
        return cls(blocks, place, summarise(recording, blocks, place))

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """The metrics that have statistics here, crowdbench's own first."""
        return tuple(metric for metric in all_metrics() if metric.name in self.statistics)

    def score(self, crowd: Trajectories) -> dict[str, MetricResult]:
        """Compare a crowd with the recording; the results by name of metric."""
        seen = summarise(crowd, self.blocks, self.place, self.metrics)
        return {
            m.name: m.compare(self.statistics[m.name], seen[m.name], self.blocks)
            for m in self.metrics
        }


def place_of(scene: Scene, areas: Areas) -> Place:
    """The properties of a scene that metrics use."""
    b = scene.bounds
    return Place(
        spawn_areas=len(areas.spawn),
        goal_areas=len(areas.goal),
        bounds_m=(b.x_min_m, b.x_max_m, b.y_min_m, b.y_max_m),
        radius_m=scene.motion.person_radius_m,
        walls=tuple(wall.corners_m for wall in scene.walls),
        walking=scene.walking,
    )


def summarise(
    crowd: Trajectories, blocks: TimeBlocks, place: Place, metrics: Sequence[Metric] | None = None
) -> dict[str, Statistics]:
    """Statistics of a crowd by name of metric.

    `metrics` are by default all of crowdbench's own that apply to these blocks.
    """
    metrics = metrics_for(blocks) if metrics is None else metrics
    statistics = {}
    for metric in metrics:
        with blamed(metric):
            statistics[metric.name] = metric.summarise(crowd, blocks, place)
    return statistics


def score_against(
    reference: Reference, scene: Scene, crowd: Trajectories, against: Trajectories | None = None
) -> dict[str, MetricResult]:
    """The result of `crowdbench.score`, given the scene's reference.

    The crowd is compared with the scene's recording, or with the crowd `against`.

    Raises:
        RecordingError: a crowd belongs to another scene, or has another time step or length.
    """
    areas = read_areas(scene)
    check_fits(crowd, scene)
    if against is not None:
        check_fits(against, scene)
        blocks, place = reference.blocks, reference.place
        there = summarise(areas.assign(against), blocks, place, applicable(blocks))
        reference = replace(reference, statistics=there)
    return reference.score(areas.assign(crowd))


def applicable(blocks: TimeBlocks) -> list[Metric]:
    """All metrics, including registered ones, that apply to time blocks of this length."""
    return [metric for metric in all_metrics() if metric.applies(blocks)]


def check_fits(crowd: Trajectories, scene: Scene, where: object = None) -> None:
    """Check that a crowd can be compared in the scene's time blocks.

    `where` names the crowd in messages.

    Raises:
        RecordingError: it belongs to another scene, has another time step or length, or is mostly
            outside the scene.
    """
    wrong = partial(RecordingError, f"crowd scored on {scene.id}" if where is None else where)
    if not np.isclose(crowd.dt_s, scene.dt_s):
        got = f"frames of {crowd.dt_s:g} s"
        hint = "Resample the trajectories to the scene's time step."
        raise wrong(got=got, expected=f"frames of {scene.dt_s:g} s", hint=hint)
    if crowd.scene not in (scene.id, scene.recording.name):
        raise wrong(got=f"a crowd of {crowd.scene}", expected=scene.id)
    needed = scene.recording.frames
    if abs(crowd.frames - needed) > scene.frames(scene.protocol.block_s):
        raise wrong(
            got=f"{crowd.frames} frames ({crowd.duration_s:.1f} s)",
            expected=f"{needed} frames ({needed * scene.dt_s:.1f} s), as long as the recording",
            hint="Both crowds are compared in the same time blocks: simulate for as long as the "
            "recording, and check the time step.",
        )
    b = scene.bounds
    low, high = np.array([b.x_min_m, b.y_min_m]) - 1.0, np.array([b.x_max_m, b.y_max_m]) + 1.0
    outside = np.any((crowd.xy < low) | (crowd.xy > high), axis=1)
    if len(crowd.xy) and outside.mean() > 0.5:
        x, y = f"x from {b.x_min_m:g} to {b.x_max_m:g}", f"y from {b.y_min_m:g} to {b.y_max_m:g}"
        got = f"{outside.mean():.0%} of the positions outside {scene.id}"
        expected = f"{x} and {y}"
        raise wrong(got=got, expected=expected, hint="Use metres, and the scene's axes and origin.")


_Count = Annotated[int, msgspec.Meta(ge=0)]
_Column = Annotated[int, msgspec.Meta(ge=0, lt=10**6)]  # histograms have that many columns


class _ReferenceFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    scene: str
    recording: str
    dt_s: float
    grid_s: float
    block_s: float
    """Value of `protocol.block_s` in `scene.toml` when the statistics were computed."""
    blocks: Annotated[list[tuple[_Count, _Count]], msgspec.Meta(min_length=1)]
    opens: list[bool]
    walking: Walking
    """`[walking]` of `scene.toml` when the statistics were computed, like the radius below."""
    person_radius_m: float
    spawn_areas: int
    goal_areas: int
    statistics: dict[str, dict[str, tuple[int, list[list[tuple[_Column, int]]]]]]
    """By metric and statistic: the number of columns, and per block the pairs (column, value).
    Values may be negative: some are sums of products."""


def _settings(scene: Scene, place: Place) -> dict[str, Any]:
    """The fields of a file that its scene must agree with."""
    return {
        "schema": SCHEMA,
        "scene": scene.id,
        "dt_s": scene.dt_s,
        "grid_s": scene.grid_s,
        "block_s": scene.protocol.block_s,
        "walking": scene.walking,
        "person_radius_m": scene.motion.person_radius_m,
        "spawn_areas": place.spawn_areas,
        "goal_areas": place.goal_areas,
    }


def write_reference(reference: Reference, scene: Scene) -> Path:
    """Write the statistics into the scene's folder."""
    path = scene.folder / "reference.json.gz"
    file = _ReferenceFile(
        **_settings(scene, reference.place),
        recording=scene.recording.name,
        blocks=[(int(a), int(b)) for a, b in reference.blocks.frames],
        opens=reference.blocks.opens.tolist(),
        statistics={
            metric: {name: sparse(counts) for name, counts in statistics.items()}
            for metric, statistics in reference.statistics.items()
        },
    )
    write_json(path, file)
    return path


def read_reference(scene: Scene) -> Reference:
    """Read the statistics that a scene ships (`reference.json.gz`).

    Raises:
        WeightsError: the file is missing or broken, or belongs to another scene.
        SceneError: `protocol.scored` names a metric that does not exist.
    """
    names = [metric.name for metric in METRICS]
    if unknown := [name for name in scene.protocol.scored if name not in names]:
        raise SceneError(
            scene.folder / "scene.toml",
            got=f"protocol.scored with {', '.join(unknown)}",
            expected=f"names of metrics: {', '.join(names)}",
            hint=did_you_mean(unknown[0], names),
        )
    path = scene.folder / "reference.json.gz"
    hint = f"Run `crowdbench scene fit {scene.asked}`."
    wrong = partial(WeightsError, path, hint=hint)
    file = read_struct(path, _ReferenceFile, WeightsError, hint)
    place = place_of(scene, read_areas(scene))
    stated = _settings(scene, place)
    computed = {name: getattr(file, name) for name in stated}
    for settings in (stated, computed):
        settings |= msgspec.structs.asdict(settings.pop("walking"))
    for name, value in computed.items():
        if value != stated[name]:
            raise wrong(
                got=f"statistics computed with {name} = {value}",
                expected=f"{name} = {stated[name]}, as in the scene's files",
            )
    within, frames = np.array(file.blocks), scene.recording.frames
    order = "ascending" if (np.diff(within.ravel()) >= 0).all() and np.diff(within).all() else "no"
    if (order, len(file.opens)) != ("ascending", len(within)) or within[-1, 1] > frames:
        raise wrong(
            got=f"{len(within)} blocks in {order} order, up to frame {within[-1, 1]}, with "
            f"{len(file.opens)} values of opens",
            expected="non-empty blocks in ascending order, with a value of opens each, in the "
            f"{frames} frames of the recording",
        )
    since = np.maximum.accumulate(np.where(file.opens, within[:, 0], 0))
    blocks = TimeBlocks(within, since, scene.dt_s, scene.grid_s)
    nobody = summarise(_nobody(scene), blocks, place)
    # A metric that is not scored may have no statistics; see `crowdbench.run.references`.
    known = {name for name in nobody if name in file.statistics or name in scene.protocol.scored}
    for name in sorted(known):
        expected = set(nobody[name])
        got = file.statistics.get(name, {})
        rows = {len(rows) for _, rows in got.values()}
        if set(got) != expected or rows != {len(blocks)}:
            raise wrong(
                got=f"{name} with {', '.join(got) or 'nothing'} in {sorted(rows)} blocks",
                expected=f"{', '.join(sorted(expected))} in {len(blocks)} blocks",
            )
    statistics = {
        metric: {n: dense(columns, rows) for n, (columns, rows) in file.statistics[metric].items()}
        for metric in nobody
        if metric in known
    }
    return Reference(blocks, place, statistics)


class _RawStatistics(msgspec.Struct, frozen=True):
    blocks: msgspec.Raw
    opens: msgspec.Raw
    statistics: dict[str, msgspec.Raw]


def scored_statistics(scene: Scene) -> bytes:
    """The time blocks and the statistics of the scored metrics, as bytes of `reference.json.gz`.

    Raises:
        WeightsError: the file is missing or broken, or lacks a scored metric.
    """
    path, hint = scene.folder / "reference.json.gz", f"Run `crowdbench scene fit {scene.asked}`."
    try:
        file = msgspec.json.decode(read_bytes(path, WeightsError, hint), type=_RawStatistics)
    except msgspec.DecodeError as error:
        raise WeightsError(
            path, got=str(error), expected="the fields of reference.json.gz", hint=hint
        ) from error
    scored = sorted(scene.protocol.scored)
    if lacking := [name for name in scored if name not in file.statistics]:
        got = f"no statistics of {', '.join(lacking)}"
        raise WeightsError(path, got=got, expected="statistics of all scored metrics", hint=hint)
    of_scored = [part for n in scored for part in (n.encode(), bytes(file.statistics[n]))]
    return b"\n".join([bytes(file.blocks), bytes(file.opens), *of_scored])


def _nobody(scene: Scene) -> Trajectories:
    """A crowd of one person for one frame; its statistics show which fields each metric has."""
    return from_rows(
        scene=scene.id,
        dt_s=scene.dt_s,
        grid_s=scene.grid_s,
        frames=1,
        person_id=np.zeros(1, np.int64),
        frame=np.zeros(1, np.int64),
        xy=np.array([[scene.bounds.x_min_m, scene.bounds.y_min_m]]),
        where=scene.id,
    )


Sparse = tuple[int, list[list[tuple[int, int]]]]
"""The number of columns, and per row the pairs (column, value) that are not zero."""


def sparse(counts: np.ndarray) -> Sparse:
    """A statistic in the sparse form that files hold."""
    return counts.shape[1], [[(int(v), int(row[v])) for v in np.flatnonzero(row)] for row in counts]


def dense(columns: int, rows: list[list[tuple[int, int]]]) -> np.ndarray:
    """A statistic as a dense array, from the sparse form that files hold."""
    size = 1 + max((value for row in rows for value, _ in row), default=0)
    counts = np.zeros((len(rows), max(size, columns)), dtype=np.int64)
    for b, row in enumerate(rows):
        for value, count in row:
            counts[b, value] = count
    return counts
