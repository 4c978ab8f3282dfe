"""Summaries of rollouts: all that scores need of them."""

import io
from dataclasses import dataclass

import numpy as np

from crowdbench.code import code_hash
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.files import sha256
from crowdbench.metrics import Metric, Statistics
from crowdbench.run.resolved import MODELS
from crowdbench.scoring.reference import Reference, summarise


@dataclass(frozen=True, eq=False)
class RolloutSummary:
    """The statistics of a rollout, stored sparsely, and its outcomes."""

    statistics: dict[str, dict[str, tuple[np.ndarray, np.ndarray, int]]]
    """By metric and name: indices of non-zero columns, their values, number of all columns."""
    outcomes: np.ndarray
    """Number of persons by index in `OUTCOMES`."""

    @classmethod
    def of_crowd(cls, crowd: Trajectories, reference: Reference) -> "RolloutSummary":
        """Summarise a crowd in the time blocks of the reference."""
        statistics: dict[str, dict[str, tuple[np.ndarray, np.ndarray, int]]] = {}
        for metric, of_metric in summarise(
            crowd, reference.blocks, reference.place, reference.metrics
        ).items():
            statistics[metric] = {}
            for name, values in of_metric.items():
                columns = np.flatnonzero(values.any(axis=0))
                statistics[metric][name] = (columns, values[:, columns], values.shape[1])
        return cls(statistics, np.bincount(crowd.outcome, minlength=len(OUTCOMES)))

    def of(self, metric: Metric) -> Statistics:
        """The statistics of a metric, as dense arrays."""
        dense = {}
        for name, (columns, values, size) in self.statistics[metric.name].items():
            dense[name] = np.zeros((len(values), size), dtype=np.int64)
            dense[name][:, columns] = values
        return dense

    def encoded(self) -> bytes:
        """The summary as the content of an npz file."""
        arrays = {"outcomes": self.outcomes}
        for metric, of_metric in self.statistics.items():
            for name, (columns, values, size) in of_metric.items():
                for part, array in (("columns", columns), ("values", values), ("size", size)):
                    arrays[f"{metric}/{name}/{part}"] = np.asarray(array)
        file = io.BytesIO()
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        return file.getvalue()

    @classmethod
    def decoded(cls, data: bytes) -> "RolloutSummary":
        """The summary in the content of such a file."""
        statistics: dict[str, dict[str, tuple[np.ndarray, np.ndarray, int]]] = {}
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            for key in arrays.files:
                metric, _, rest = key.partition("/")
                name, _, part = rest.rpartition("/")
                if part == "columns":
                    values, size = (arrays[f"{metric}/{name}/{p}"] for p in ("values", "size"))
                    of_metric = statistics.setdefault(metric, {})
                    of_metric[name] = (arrays[key], values, int(size))
            return cls(statistics, arrays["outcomes"])


def summary_key(rollout: str, reference: Reference) -> str | None:
    """Hash of all that the summary of a rollout depends on; None with metrics of other people.

    `rollout` is the hash of all that the rollout depends on.
    """
    if any(not type(metric).__module__.startswith("crowdbench.") for metric in reference.metrics):
        return None
    blocks = reference.blocks
    names = [metric.name for metric in reference.metrics]
    code = code_hash("crowdbench.scoring.reference", __name__, cut=MODELS)
    what = f"{rollout} {names} {reference.place!r} {blocks.dt_s!r} {blocks.grid_s!r} {code}"
    return sha256(what.encode() + blocks.frames.tobytes() + blocks.since.tobytes())[:32]
