"""Safetensors files with the fits of a neural spawn model for each split, in a scene's folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import WeightsError
from crowdbench.files import read_bytes, replacing
from crowdbench.scene import Scene
from crowdbench.spawn.weights import check_origin, check_split, hint

Shapes = Mapping[str, tuple[int, ...]]
"""Shapes of the weights of one area, by name."""


class Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a file says about its fits."""

    schema: int
    model: str
    scene: str
    fits: int
    grid_s: float
    memory: int
    settings: dict[str, int | float | bool]


@dataclass(frozen=True)
class NetworkFile:
    """The kind of file of one model."""

    model: str
    schema: int
    shapes: Shapes

    def path(self, folder: Path) -> Path:
        """The file in a scene's folder."""
        return folder / f"{self.model}.safetensors"

    def write(
        self,
        folder: Path,
        scene: str,
        fits: Mapping[str, Sequence[Mapping[str, np.ndarray]]],
        *,
        grid_s: float,
        memory: int,
        settings: Mapping[str, int | float | bool],
    ) -> None:
        """Write the weights of all fits of all splits."""
        from safetensors.numpy import save

        tensors = {
            f"{split}.{fit}.{name}": np.ascontiguousarray(weights[name], dtype=np.float32)
            for split, each in fits.items()
            for fit, weights in enumerate(each)
            for name in self.shapes
        }
        header = Header(
            schema=self.schema,
            model=self.model,
            scene=scene,
            fits=len(fits["full"]),
            grid_s=grid_s,
            memory=memory,
            settings=dict(settings),
        )
        # A single entry, because the order of several entries differs between runs.
        text = msgspec.json.encode(header, order="deterministic").decode()
        with replacing(self.path(folder)) as temporary:
            temporary.write_bytes(save(tensors, metadata={"crowdbench": text}))

    def read(
        self, scene: Scene, areas: int, split: str, fit: int
    ) -> tuple[Header, dict[str, np.ndarray]]:
        """Header and weights of a fit; `fit` is taken modulo the number of fits.

        Raises:
            SettingError: the split or fit does not exist.
            WeightsError: the file is missing or broken, or belongs to another scene.
        """
        check_split(split, fit)
        path, how = self.path(scene.folder), hint(scene)
        header, tensors = _decode(path, read_bytes(path, WeightsError, how), how)
        origin = (header.model, header.scene, header.schema)
        check_origin(path, origin, (self.model, scene.id, self.schema), how)
        if header.memory < 1:
            raise WeightsError(
                path,
                got=f"a memory of {header.memory} grid steps",
                expected="1 or more",
                hint=how,
            )
        most = len(tensors) // len(self.shapes)
        if not 1 <= header.fits <= max(1, most) or not np.isclose(header.grid_s, scene.grid_s):
            raise WeightsError(
                path,
                got=f"{header.fits} fits on a grid of {header.grid_s:g} s",
                expected=f"the number of fits in the file, at least 1, on a grid of "
                f"{scene.grid_s:g} s",
                hint=how,
            )
        expected = {
            f"{p}.{f}.{name}": (areas, *shape)
            for p in SPLITS
            for f in range(header.fits)
            for name, shape in self.shapes.items()
        }
        _check(path, tensors, expected, how)
        prefix = f"{split}.{fit % header.fits}."
        return header, {name: tensors[prefix + name] for name in self.shapes}


def _decode(path: Path, data: bytes, how: str) -> tuple[Header, dict[str, np.ndarray]]:
    """Header and tensors of a safetensors file."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        tensors = load(data)
        # The file begins with eight bytes that give the length of a JSON header.
        raw = msgspec.json.decode(data[8 : 8 + int.from_bytes(data[:8], "little")])
        text = raw["__metadata__"]["crowdbench"]
        return msgspec.json.decode(text, type=Header), tensors
    except (SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise WeightsError(
            path,
            got=f"unreadable weights ({error})",
            expected="safetensors with crowdbench's header",
            hint=how,
        ) from error


def _check(
    path: Path,
    tensors: Mapping[str, Any],
    expected: Mapping[str, tuple[int, ...]],
    how: str,
) -> None:
    wrong = sorted(set(tensors) ^ set(expected))
    if wrong:
        raise WeightsError(
            path,
            got=f"{len(wrong)} tensors missing or unknown, among them {wrong[0]}",
            expected="one tensor per split, fit and weight",
            hint=how,
        )
    for name, array in tensors.items():
        where = f"{path}, {name}"
        if array.shape != expected[name] or array.dtype != np.float32:
            raise WeightsError(
                where,
                got=f"{array.dtype} of shape {array.shape}",
                expected=f"float32 of shape {expected[name]}",
                hint=how,
            )
        if not np.isfinite(array).all():
            raise WeightsError(where, got="NaN or infinity", expected="finite numbers", hint=how)
        if name.endswith("scaling") and (array[:, 1::2] <= 0).any():
            raise WeightsError(
                where,
                got="a standard deviation of 0 or less",
                expected="standard deviations > 0",
                hint=how,
            )
