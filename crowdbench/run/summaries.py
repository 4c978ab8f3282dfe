"""Summaries of rollouts: all that scores need of them."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import msgspec
import numpy as np

from crowdbench.code import code_hash
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.files import sha256
from crowdbench.metrics import Metric, Statistics
from crowdbench.run.resolved import MODELS
from crowdbench.scoring.reference import Reference, summarise

_Array = tuple[str, tuple[int, ...], bytes]
"""Data type, shape and content of an array."""


@dataclass(frozen=True, eq=False)
class RolloutSummary:
    """The statistics of a rollout, stored sparsely, and its outcomes."""

    arrays: dict[str, np.ndarray]
    """`outcomes`, each number that was `measured`, and for each statistic, as `metric/name/part`:
    `columns` (indices of those that are not zero), their `values`, and the `size`, the number of
    all columns."""

    @classmethod
    def of_crowd(
        cls,
        crowd: Trajectories,
        reference: Reference,
        measured: Mapping[str, float] = MappingProxyType({}),
    ) -> "RolloutSummary":
        """Summarise a crowd in the time blocks of the reference; `measured` are more numbers."""
        arrays = {"outcomes": np.bincount(crowd.outcome, minlength=len(OUTCOMES))}
        arrays |= {f"measured/{name}": np.asarray(value) for name, value in measured.items()}
        for metric, statistics in summarise(
            crowd, reference.blocks, reference.place, reference.metrics
        ).items():
            for name, values in statistics.items():
                columns, of = np.flatnonzero(values.any(axis=0)), f"{metric}/{name}"
                arrays[f"{of}/columns"], arrays[f"{of}/values"] = columns, values[:, columns]
                arrays[f"{of}/size"] = np.asarray(values.shape[1])
        return cls(arrays)

    @property
    def outcomes(self) -> np.ndarray:
        """Number of persons by index in `OUTCOMES`."""
        return self.arrays["outcomes"]

    def measured(self, name: str) -> float:
        """A number that was measured besides the metrics; NaN if it is undefined."""
        return float(self.arrays[f"measured/{name}"])

    def of(self, metric: Metric) -> Statistics:
        """The statistics of a metric, as dense arrays."""
        start, end, dense = f"{metric.name}/", "/columns", {}
        for key, columns in self.arrays.items():
            if key.startswith(start) and key.endswith(end):
                of = key.removesuffix(end)
                values, size = (self.arrays[f"{of}/{part}"] for part in ("values", "size"))
                name = of.removeprefix(start)
                dense[name] = np.zeros((len(values), int(size)), dtype=np.int64)
                dense[name][:, columns] = values
        return dense

    def encoded(self) -> bytes:
        """The summary as compressed bytes."""
        parts = {n: (a.dtype.str, a.shape, a.tobytes()) for n, a in self.arrays.items()}
        return zlib.compress(msgspec.msgpack.encode(parts), 1)

    @classmethod
    def decoded(cls, data: bytes) -> "RolloutSummary":
        """The summary in such bytes."""
        parts = msgspec.msgpack.decode(zlib.decompress(data), type=dict[str, _Array])
        return cls(
            {n: np.frombuffer(raw, of).reshape(shape) for n, (of, shape, raw) in parts.items()}
        )


def code_of_summaries(reference: Reference) -> str | None:
    """Hash of all that summaries depend on, but their rollouts; None with metrics of others."""
    if any(not type(metric).__module__.startswith("crowdbench.") for metric in reference.metrics):
        return None
    blocks = reference.blocks
    names = [metric.name for metric in reference.metrics]
    code = code_hash("crowdbench.scoring.reference", __name__, cut=MODELS)
    what = f"{names} {reference.place!r} {blocks.dt_s!r} {blocks.grid_s!r} {code}"
    return sha256(what.encode() + blocks.frames.tobytes() + blocks.since.tobytes())[:32]
