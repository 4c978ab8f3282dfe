"""The fits of the study, which are kept in files: on Grand Central they take hours.

A fit is made again only if its arrivals, its settings or the code of its training have changed.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from crowdbench.code import code_hash
from crowdbench.errors import WeightsError
from crowdbench.files import read_bytes, replacing, sha256
from crowdbench.run.executor import call_each
from crowdbench.run.rollout_jobs import Progress
from crowdbench.scene import Scene
from crowdbench.spawn import Areas, Arrivals, NtppGMM, SpawnModel
from crowdbench.spawn.paper.model import NtppPaper

WINDOWS_FRAMES = (100, 500, 1000)
STRIDES_FRAMES = (5, 50)
"""The paper's windows and strides; its text calls the strides overlaps."""
CHOSEN = (1000, 50)
"""Window and stride of the published code, with which models are compared."""
SAMPLES = 5
"""Samples of each model. The paper makes them from one fit; those of `ntpp-gmm` are from fits with
seeds 0, 1, …, as everywhere in crowdbench."""


@dataclass(frozen=True)
class Configuration:
    """A spawn model and how it is trained."""

    spawn: str
    window_frames: int = 0
    stride_frames: int = 0
    """0 for models without windows, and for the fits that a scene ships."""
    code: bool = False
    """Whether `ntpp-paper` is trained as in the published code."""

    @property
    def model(self) -> str:
        """Name of the model without window and stride: `ntpp-paper (code)`."""
        return self.spawn + " (code)" * self.code

    @property
    def label(self) -> str:
        """Name of the model, with window and stride if it has them: `ntpp-gmm 100/5`."""
        windows = f" {self.window_frames}/{self.stride_frames}" if self.window_frames else ""
        return self.model + windows

    @property
    def stem(self) -> str:
        """The label as a part of file names."""
        return self.label.translate(str.maketrans(" /", "--", "()"))

    def at(self, window: int, stride: int) -> "Configuration":
        """The same model with another window and stride."""
        return replace(self, window_frames=window, stride_frames=stride)


POISSON = Configuration("poisson-gmm")
POISSON_CODE = Configuration("poisson-paper")
SHIPPED = Configuration("ntpp-gmm")
LITERAL = Configuration("ntpp-paper", *CHOSEN)
CODE = Configuration("ntpp-paper", *CHOSEN, code=True)
RECORDED = Configuration("replay")
COMPARED = (POISSON, POISSON_CODE, LITERAL, CODE, SHIPPED)
"""The models that are compared with the recording."""
_TRAINED_BY = {
    "ntpp-paper": "crowdbench.spawn.paper.training",
    "ntpp-gmm": "crowdbench.spawn.ntpp.training",
}
"""Modules that train a model. Fits depend on the arrivals themselves, not on how they are read."""
_ARRIVALS = ("crowdbench.data", "crowdbench.scene", "crowdbench.spawn.areas")


def windowed() -> list[Configuration]:
    """The configurations that differ in window and stride, in the order of the page."""
    return [
        one.at(window, stride)
        for one in (LITERAL, CODE, SHIPPED)
        for window in WINDOWS_FRAMES
        for stride in STRIDES_FRAMES
    ]


@dataclass(frozen=True)
class Fit:
    """A fit that is needed, and its file."""

    configuration: Configuration
    seed: int
    settings: Any
    """`NtppSettings` or `PaperSettings`."""
    path: Path
    made_from: str
    """Hash of everything that the fit depends on."""


class _Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    made_from: str
    training_s: float


def fit_of(
    configuration: Configuration, seed: int, scene: Scene, arrivals: Arrivals, folder: Path
) -> Fit:
    """The fit of a configuration with windows; fits of the paper's model have the seed 0."""
    window, stride = configuration.window_frames, configuration.stride_frames
    settings: Any
    if configuration.spawn == LITERAL.spawn:
        from crowdbench.spawn.paper import training as ntpp_paper_training

        settings = replace(
            ntpp_paper_training.DEFAULT,
            window_frames=window,
            stride_frames=stride,
            published_code=configuration.code,
            learning_rate=0.0,
        )
        seed = 0
    else:
        from crowdbench.spawn.ntpp import training as ntpp_training

        settings = replace(ntpp_training.DEFAULT, window_frames=window, stride_frames=stride)
    lengths_s = f"{scene.dt_s} {arrivals.grid_s} {scene.protocol.block_s}"
    what = f"{settings} {seed} {arrivals.areas} {lengths_s}".encode()
    data = [arrivals.tick, arrivals.area, arrivals.windows]
    code = code_hash(_TRAINED_BY[configuration.spawn], cut=_ARRIVALS).encode()
    made_from = sha256(b"".join([what, code, *(a.tobytes() for a in data)]))[:16]
    path = folder / f"{configuration.stem}_{seed}.safetensors"
    return Fit(configuration, seed, settings, path, made_from)


def make_fits(
    fits: Sequence[Fit],
    scene: Scene,
    arrivals: Arrivals,
    areas: Areas,
    workers: int,
    progress: Progress,
) -> None:
    """Train the missing fits; `progress(done, total)` is called before the first and after each."""
    missing = [fit for fit in fits if not _known(fit)]
    progress(len(fits) - len(missing), len(fits))
    # The longest first, so that all processes end at about the same time.
    missing.sort(key=_cost, reverse=True)
    tasks = [(fit,) for fit in missing]
    done = len(fits) - len(missing)
    for _ in call_each(
        _train,
        tasks,
        workers,
        common=(scene, arrivals, areas),
        name=lambda fit: f"fit {fit.path.stem}",
        files=lambda fit: [fit.path],
    ):
        done += 1
        progress(done, len(fits))


def read_fit(fit: Fit, scene: Scene, arrivals: Arrivals, areas: Areas) -> tuple[SpawnModel, float]:
    """The model of a fit, and the CPU time of its training in seconds.

    Raises:
        WeightsError: the file is missing or broken.
    """
    from safetensors.numpy import load

    header, data = _header(fit.path)
    weights = load(data)
    settings = asdict(fit.settings)
    if fit.configuration.spawn == LITERAL.spawn:
        return NtppPaper(areas, weights, scene.dt_s, arrivals.grid_s, settings), header.training_s
    memory = int(weights.pop("memory")[0])
    return NtppGMM(areas, weights, arrivals.grid_s, memory, settings), header.training_s


def _train(fit: Fit, scene: Scene, arrivals: Arrivals, areas: Areas) -> None:
    from safetensors.numpy import save

    began = time.process_time()
    if fit.configuration.spawn == LITERAL.spawn:
        from crowdbench.spawn.paper import training as ntpp_paper_training

        model = ntpp_paper_training.fit(
            arrivals, areas, scene, seed=fit.seed, settings=fit.settings
        )
        weights = dict(model.weights)
    else:
        from crowdbench.spawn.ntpp import training as ntpp_training

        own = ntpp_training.fit(arrivals, areas, scene, seed=fit.seed, settings=fit.settings)
        weights = {**own.weights, "memory": np.array([own.memory])}
    header = _Header(made_from=fit.made_from, training_s=round(time.process_time() - began, 1))
    metadata = {"crowdbench": msgspec.json.encode(header).decode()}
    tensors = {name: np.ascontiguousarray(array) for name, array in weights.items()}
    with replacing(fit.path) as temporary:
        temporary.write_bytes(save(tensors, metadata=metadata))


def _known(fit: Fit) -> bool:
    try:
        return _header(fit.path)[0].made_from == fit.made_from
    except WeightsError:  # missing or broken: it is made again
        return False


def _header(path: Path) -> tuple[_Header, bytes]:
    data = read_bytes(path, WeightsError, "")
    try:
        raw = msgspec.json.decode(data[8 : 8 + int.from_bytes(data[:8], "little")])
        return msgspec.json.decode(raw["__metadata__"]["crowdbench"], type=_Header), data
    except (ValueError, KeyError, TypeError) as error:
        raise WeightsError(
            path, got=f"an unreadable file ({error})", expected="a fit of `python -m studies paper`"
        ) from error


def _cost(fit: Fit) -> tuple[bool, float, int]:
    of = fit.configuration
    paper = of.spawn == LITERAL.spawn
    return paper, of.window_frames / max(1, of.stride_frames), of.window_frames
