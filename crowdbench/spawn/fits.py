"""Files with the fits of a spawn model for each split, in a scene's folder.

A model declares a `Fit`: arrays with their shapes, numbers, and what must hold for them. A
`FitFile` writes and reads them. Small fits are JSON, one for each split. Those of networks are
safetensors, one or several for each split, which differ in their random seed; what is not an array
is the same in all of them and stands in the header.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, TypeVar, cast

import msgspec
import numpy as np
from msgspec import structs

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError, WeightsError
from crowdbench.files import read_bytes, read_struct, replacing, write_json
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.arrays import Fit, check_origin, checked, hint
from crowdbench.spawn.model import Start

F = TypeVar("F", bound=Fit)
Model = TypeVar("Model", bound="Fitted")


@dataclass(frozen=True)
class FitFile(Generic[F]):
    """The kind of file with the fits of one model."""

    model: str
    schema: int
    kind: type[F]
    suffix: Literal[".json", ".safetensors"] = ".json"
    compact: bool = False
    """Whether JSON is on one line."""

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.model + self.suffix

    def write(self, folder: Path, scene: str, fits: Mapping[str, Sequence[F]]) -> None:
        """Write the fits of all splits into a scene's folder; of JSON, the first of each split."""
        header: dict[str, Any] = {"schema": self.schema, "model": self.model, "scene": scene}
        one = structs.asdict(fits["full"][0])
        if self.suffix == ".json":
            splits = {split: each[0] for split, each in sorted(fits.items())}
            encoded = msgspec.json.encode({**header, "splits": splits}, enc_hook=np.ndarray.tolist)
            write_json(folder / self.name, msgspec.Raw(encoded), compact=self.compact)
            return
        from safetensors.numpy import save

        header["fits"] = len(fits["full"])
        header |= {name: x for name, x in one.items() if not isinstance(x, np.ndarray)}
        tensors = {
            f"{split}.{k}.{name}": np.ascontiguousarray(getattr(fit, name))
            for split, each in fits.items()
            for k, fit in enumerate(each)
            for name in one
            if name not in header
        }
        # A single entry, because the order of several entries differs between runs.
        metadata = {"crowdbench": msgspec.json.encode(header).decode()}
        with replacing(folder / self.name) as temporary:
            temporary.write_bytes(save(tensors, metadata=metadata))

    def read(self, scene: Scene, areas: Areas, split: str, fit: int = 0) -> F:
        """A fit for a split; `fit` is taken modulo the number of fits. All of them are checked.

        Raises:
            SettingError: the split or fit does not exist.
            WeightsError: the file is missing or broken, has another schema, or belongs to another
                scene.
        """
        check_split(split, fit)
        path, how = scene.folder / self.name, hint(scene)
        header, tensors = _content(path, how)
        check_origin(
            header, header.pop("model", None), [self.model, scene.id, self.schema], path, how
        )
        fits: dict[str, F] = {}
        for which, raw in _by_fit(header, tensors, path, how).items():
            sizes = {"K": len(areas.spawn), "G": len(areas.goal)}
            fits[which] = checked(raw, self.kind, scene, sizes, f"{path}, splits.{which}")
        of_split = [found for which, found in fits.items() if which.partition(".")[0] == split]
        return of_split[fit % len(of_split)]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A spawn model whose fits are in files: a dataclass with the fields of its `Fit`."""

    areas: Areas
    file: ClassVar[FitFile[Any]]
    start: ClassVar[Start] = "stationary"

    @classmethod
    def write(cls, folder: Path, fits: Mapping[str, Sequence["Fitted"]]) -> None:
        """Write the fits of all splits into a scene's folder.

        `fits` has one for each of `SPLITS`, or several that differ in their random seed.
        """
        scene = fits["full"][0].areas.scene
        cls.file.write(
            folder, scene, {p: [model._fit() for model in each] for p, each in fits.items()}
        )

    @classmethod
    def read(
        cls: type[Model], scene: Scene, areas: Areas, split: str = "full", fit: int = 0
    ) -> Model:
        """The fit that a scene ships for a split; `fit` is taken modulo the number of fits.

        Raises:
            SettingError: the split or fit does not exist.
            WeightsError: the file is missing or broken, or belongs to another scene.
        """
        model: Model = cls._of_fit(cls.file.read(scene, areas, split, fit), areas, scene)
        return model

    def _fit(self) -> Any:
        kind = self.file.kind
        return kind(**{name: getattr(self, name) for name in kind.__struct_fields__})

    @classmethod
    def _of_fit(cls, fit: Any, areas: Areas, scene: Scene, **more: Any) -> Any:
        """The model with what was read, and `more` of its fields."""
        of_scene = {"areas": areas, "grid_s": scene.grid_s, "frame_s": scene.dt_s}
        known, own = {**of_scene, **structs.asdict(fit), **more}, cast("Any", cls)
        return cls(**{f.name: known[f.name] for f in fields(own) if f.name in known})


def check_split(split: str, fit: int) -> None:
    """Check the name of a split and the number of a fit.

    Raises:
        SettingError: `split` is not one of `SPLITS`, or `fit` is negative.
    """
    if split not in SPLITS:
        raise SettingError("split", got=repr(split), expected=f"one of {', '.join(SPLITS)}")
    if fit < 0:
        raise SettingError("fit", got=str(fit), expected="0 or more")


def _content(path: Path, how: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The JSON of a file, or that of its header and its tensors."""
    if path.suffix == ".json":
        return read_struct(path, dict, WeightsError, how), {}
    from safetensors import SafetensorError
    from safetensors.numpy import load

    data = read_bytes(path, WeightsError, how)
    try:
        tensors = load(data)
        # The file begins with eight bytes that give the length of a JSON header.
        raw = msgspec.json.decode(data[8 : 8 + int.from_bytes(data[:8], "little")])
        return msgspec.json.decode(raw["__metadata__"]["crowdbench"], type=dict[str, Any]), tensors
    except (SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        got = f"unreadable weights ({error})"
        expected = "safetensors with crowdbench's header"
        raise WeightsError(path, got=got, expected=expected, hint=how) from error


def _by_fit(
    header: dict[str, Any], tensors: dict[str, np.ndarray], path: Path, how: str
) -> dict[str, Any]:
    """What a file has on each fit: by split if there is one for each, or by split and number."""
    found: dict[str, Any] = {}
    if tensors:
        count = header.pop("fits", None)
        for key, tensor in tensors.items():
            which, _, name = key.rpartition(".")
            found.setdefault(which, dict(header))[name] = tensor
        several = range(min(count, len(tensors)) if isinstance(count, int) else 0)
        expected = [f"{split}.{k}" for split in SPLITS for k in several]
    else:
        found, expected = header.pop("splits", {}), list(SPLITS)
        found = found if isinstance(found, dict) and not header else {**header, "splits": found}
    if set(found) != set(expected) or not found:
        raise WeightsError(
            f"{path}, splits",
            got=", ".join(sorted(found)) or "nothing",
            expected=", ".join(sorted(expected)) or "one or more fits",
            hint=how,
        )
    return {which: found[which] for which in expected}
