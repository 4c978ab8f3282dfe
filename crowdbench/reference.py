"""A scene's reference statistics: what its recording is compared by, without the recording.

They are the metrics' histograms per time block. Distances computed from them equal those
computed from the recording, and no path, no arrival time and no per-frame series can be read
back from them.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from crowdbench.blocks import TimeBlocks, cut
from crowdbench.errors import RecordingError, WeightsError
from crowdbench.files import read_struct, write_json
from crowdbench.metrics import METRICS, Histograms, MetricResult
from crowdbench.scene import Scene, load_scene
from crowdbench.trajectories import Trajectories

SCHEMA = 1


@dataclass(frozen=True, eq=False)
class Reference:
    """The recording of a scene, as its metrics see it."""

    blocks: TimeBlocks
    statistics: dict[str, Histograms]
    """Histograms per block, by name of metric."""

    @classmethod
    def of(cls, recording: Trajectories, scene: Scene) -> "Reference":
        """Summarise a recording in the time blocks of the scene's protocol."""
        blocks = cut(
            recording.observed,
            block_s=scene.protocol.block_s,
            dt_s=scene.dt_s,
            grid_s=scene.grid_s,
        )
        return cls(blocks, {m.name: m.summarise(recording, blocks) for m in METRICS})

    def score(self, crowd: Trajectories) -> dict[str, MetricResult]:
        """All metrics of a crowd against the recording, by name."""
        return {
            m.name: m.compare(self.statistics[m.name], m.summarise(crowd, self.blocks), self.blocks)
            for m in METRICS
        }


def score(scene: str | Path | Scene, crowd: Trajectories) -> dict[str, MetricResult]:
    """Score any simulator's crowd against a scene's recording.

    The crowd is a continuous run as long as the recording, its first frame being frame 0: it is
    looked at in the same time blocks. A table does not tell an empty scene at its end from an
    end that came early; up to one time block is taken for empty. More than a block shorter or
    longer is refused.

    Raises:
        SceneError: there is no such scene.
        WeightsError: the scene has no reference statistics.
        RecordingError: the crowd is another scene's, or its time step or length is not the
            scene's.
    """
    scene = load_scene(scene)
    reference = read_reference(scene)
    if not np.isclose(crowd.dt_s, scene.dt_s):
        raise RecordingError(
            f"crowd scored on {scene.id}",
            got=f"frames of {crowd.dt_s:g} s",
            expected=f"frames of {scene.dt_s:g} s",
            mend="Resample the trajectories to the scene's time step.",
        )
    if crowd.scene not in (scene.id, scene.recording.name):
        raise RecordingError(
            f"crowd scored on {scene.id}", got=f"a crowd of {crowd.scene}", expected=scene.id
        )
    needed = scene.recording.frames
    if abs(crowd.frames - needed) > scene.frames(scene.protocol.block_s):
        raise RecordingError(
            f"crowd scored on {scene.id}",
            got=f"{crowd.frames} frames ({crowd.duration_s:.1f} s)",
            expected=f"{needed} frames ({needed * scene.dt_s:.1f} s), as long as the recording",
            mend="Both sides are looked at in the same time blocks: simulate as long, and "
            "check the time step.",
        )
    return reference.score(crowd)


_Count = Annotated[int, msgspec.Meta(ge=0)]
_Value = Annotated[int, msgspec.Meta(ge=0, lt=10**6)]  # histograms are as long as their values


class _ReferenceFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    scene: str
    recording: str
    dt_s: float
    grid_s: float
    block_s: float
    """What the scene's file said when the statistics were computed."""
    blocks: Annotated[list[tuple[_Count, _Count]], msgspec.Meta(min_length=1)]
    opens: list[bool]
    statistics: dict[str, dict[str, list[list[tuple[_Value, _Count]]]]]
    """By metric and histogram: per block the pairs (value, count)."""


def write_reference(reference: Reference, scene: Scene) -> Path:
    """Write the statistics into the scene's folder."""
    path = scene.folder / "reference.json"
    file = _ReferenceFile(
        schema=SCHEMA,
        scene=scene.id,
        recording=scene.recording.name,
        dt_s=scene.dt_s,
        grid_s=scene.grid_s,
        block_s=scene.protocol.block_s,
        blocks=[(int(a), int(b)) for a, b in reference.blocks.frames],
        opens=reference.blocks.opens.tolist(),
        statistics={
            metric: {name: _sparse(counts) for name, counts in histograms.items()}
            for metric, histograms in reference.statistics.items()
        },
    )
    write_json(path, file)
    return path


def read_reference(scene: Scene) -> Reference:
    """Read the statistics that a scene ships (`reference.json`).

    Raises:
        WeightsError: the file is missing, broken or another scene's.
    """
    path = scene.folder / "reference.json"
    mend = f"Run `crowdbench fit {scene.asked}`."
    file = read_struct(path, _ReferenceFile, WeightsError, mend)
    if (file.scene, file.schema) != (scene.id, SCHEMA):
        raise WeightsError(
            path,
            got=f"statistics of {file.scene}, schema {file.schema}",
            expected=f"statistics of {scene.id}, schema {SCHEMA}",
            mend=mend,
        )
    frames = max((stop for _, stop in file.blocks), default=0)
    for name, computed, stated in (
        ("dt_s", file.dt_s, scene.dt_s),
        ("grid_s", file.grid_s, scene.grid_s),
        ("protocol.block_s", file.block_s, scene.protocol.block_s),
        ("recording.frames", max(frames, scene.recording.frames), scene.recording.frames),
    ):
        if computed != stated:
            raise WeightsError(
                path,
                got=f"statistics computed with {name} = {computed:g}",
                expected=f"{name} = {stated:g}, as in scene.toml",
                mend=mend,
            )
    missing = {m.name for m in METRICS} - set(file.statistics)
    lengths = {len(rows) for h in file.statistics.values() for rows in h.values()}
    if missing or lengths | {len(file.opens)} != {len(file.blocks)}:
        raise WeightsError(
            path,
            got=f"statistics of {', '.join(file.statistics)} in {sorted(lengths)} blocks",
            expected=f"{', '.join(m.name for m in METRICS)} in {len(file.blocks)} blocks",
            mend=mend,
        )
    blocks = TimeBlocks(np.array(file.blocks), np.array(file.opens), scene.dt_s, scene.grid_s)
    if (np.diff(blocks.frames.ravel()) < 0).any() or (np.diff(blocks.frames) == 0).any():
        raise WeightsError(
            path, got="blocks that are empty or overlap", expected="ascending blocks", mend=mend
        )
    statistics = {
        metric: {name: _dense(rows) for name, rows in histograms.items()}
        for metric, histograms in file.statistics.items()
    }
    for m in METRICS:
        try:  # only the metric knows which histograms it needs
            m.compare(statistics[m.name], statistics[m.name], blocks)
        except KeyError as error:
            raise WeightsError(
                path,
                got=f"{m.name} without the histogram {error}",
                expected="all histograms of each metric",
                mend=mend,
            ) from error
    return Reference(blocks, statistics)


def _sparse(counts: np.ndarray) -> list[list[tuple[int, int]]]:
    return [[(int(v), int(row[v])) for v in np.flatnonzero(row)] for row in counts]


def _dense(rows: list[list[tuple[int, int]]]) -> np.ndarray:
    size = 1 + max((value for row in rows for value, _ in row), default=0)
    counts = np.zeros((len(rows), size), dtype=np.int64)
    for b, row in enumerate(rows):
        for value, count in row:
            counts[b, value] = count
    return counts
