"""Files with the fits of a spawn model for each split, in a scene's folder.

A model declares a `Fit`: arrays with their shapes, numbers, and what must hold for them. A
`FitFile` writes and reads them. Small fits are JSON, one for each split. Those of networks are
safetensors, one or several for each split, which differ in their random seed; what is not an array
is the same in all of them and stands in the header.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, TypeVar, cast, get_type_hints

import msgspec
import numpy as np
from msgspec import structs

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError, WeightsError
from crowdbench.files import read_bytes, read_struct, replacing, write_json
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas

Rule = tuple[str, Any, str]
"""A condition on a field: its name, whether the condition is met, and the condition as text."""


class Fit(msgspec.Struct, frozen=True, forbid_unknown_fields=True, eq=False):
    """What a model learned from one split.

    Annotations of arrays, such as `Float[np.ndarray, "K 2"]`, are checked when a file is read. K
    and G are the numbers of spawn and goal areas. Another letter is the same number in all arrays
    of an object.
    """

    def rules(self, scene: Scene) -> Iterable[Rule]:
        """Conditions on the values on this scene, of arrays that have the right shapes."""
        return ()


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
        origin = [header.pop(name, None) for name in ("model", "scene", "schema")]
        expected = [self.model, scene.id, self.schema]
        if origin != expected:
            raise WeightsError(
                path,
                got="{} of {}, schema {}".format(*origin),
                expected="{} of {}, schema {}".format(*expected),
                hint=how,
            )
        fits: dict[str, F] = {}
        for which, raw in _by_fit(header, tensors, path, how).items():
            where = f"{path}, splits.{which}"
            fits[which] = _checked(raw, self.kind, scene, areas, where)
        of_split = [found for which, found in fits.items() if which.partition(".")[0] == split]
        return of_split[fit % len(of_split)]


class Fitted:
    """A spawn model whose fits are in files: a dataclass with the fields of its `Fit`."""

    areas: Areas
    file: ClassVar[FitFile[Any]]

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
        """What is written."""
        kind = self.file.kind
        return kind(**{name: getattr(self, name) for name in kind.__struct_fields__})

    @classmethod
    def _of_fit(cls, fit: Any, areas: Areas, scene: Scene, **more: Any) -> Any:
        """The model with what was read, and `more` of its fields."""
        of_scene = {"areas": areas, "grid_s": scene.grid_s, "frame_s": scene.dt_s}
        known, own = {**of_scene, **structs.asdict(fit), **more}, cast("Any", cls)
        return cls(**{f.name: known[f.name] for f in fields(own) if f.name in known})


def hint(scene: Scene) -> str:
    """The hint of errors about missing or broken fits: how to make them again."""
    if (scene.folder / "scene.toml").is_file():
        return f"Run `crowdbench scene fit {scene.asked}`."
    return f"Create them with `crowdbench scene fit {scene.id} --out FOLDER`."


def check_split(split: str, fit: int) -> None:
    """Check the name of a split and the number of a fit.

    Raises:
        SettingError: `split` is not one of `SPLITS`, or `fit` is negative.
    """
    if split not in SPLITS:
        raise SettingError("split", got=repr(split), expected=f"one of {', '.join(SPLITS)}")
    if fit < 0:
        raise SettingError("fit", got=str(fit), expected="0 or more")


def are_definite(matrices: np.ndarray) -> bool:
    """Whether matrices are symmetric and positive definite."""
    symmetric = np.allclose(matrices, matrices.swapaxes(-1, -2))
    return symmetric and bool((np.linalg.eigvalsh(matrices) > 0).all() if matrices.size else True)


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
        raise WeightsError(
            path,
            got=f"unreadable weights ({error})",
            expected="safetensors with crowdbench's header",
            hint=how,
        ) from error


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


def _checked(raw: Any, kind: type[F], scene: Scene, areas: Areas, where: str) -> F:
    """The fit in a file; raises WeightsError if a shape or a value is wrong."""
    how = hint(scene)
    fit: F = _read(raw, kind, {"K": len(areas.spawn), "G": len(areas.goal)}, where, how)
    for name, holds, expected in fit.rules(scene):
        if not holds:
            value = getattr(fit, name, None)
            got = f"{value:g}" if isinstance(value, float) else "invalid values"
            raise WeightsError(f"{where}.{name}", got=got, expected=expected, hint=how)
    return fit


def _read(raw: Any, kind: Any, known: Mapping[str, int], where: str, how: str) -> Any:
    """An object of a dataclass or struct, whose arrays have the sizes that are known by letter."""
    types = get_type_hints(kind, include_extras=True)
    names = {name: name for name in types}
    if issubclass(kind, msgspec.Struct):
        names = {field.name: field.encode_name for field in structs.fields(kind)}
    wrong = sorted(raw.keys() ^ set(names.values())) if isinstance(raw, dict) else ["all fields"]
    if wrong:
        raise WeightsError(
            where,
            got=f"missing or unknown: {', '.join(wrong)}",
            expected=f"exactly {', '.join(names.values())}",
            hint=how,
        )
    sizes, found = dict(known), {}
    for name, key in names.items():
        of, value, at = types[name], raw[key], f"{where}.{key}"
        if hasattr(of, "dim_str"):
            found[name] = _array(value, of, sizes, at, how)
        elif is_dataclass(of) or (isinstance(of, type) and issubclass(of, msgspec.Struct)):
            found[name] = _read(value, of, known, at, how)
        else:
            try:
                found[name] = msgspec.convert(value, of)
            except (msgspec.ValidationError, OverflowError) as error:
                raise WeightsError(
                    at, got=str(error), expected="a valid value", hint=how
                ) from error
    return kind(**found)


def _array(value: Any, of: Any, sizes: dict[str, int], where: str, how: str) -> np.ndarray:
    """An array as its annotation `of` says; sizes that were not known are added to `sizes`."""
    dims = of.dim_str.split()
    dtype = next(name for name in ("float64", "int64", "float32") if name in of.dtypes)
    shape = tuple(int(d) if d.isdigit() else sizes.get(d) for d in dims)
    array = value
    if not isinstance(value, np.ndarray):
        try:
            array = np.array(value)
        except ValueError:  # rows of different lengths
            array = np.array(str(value))
        if array.shape == (0,):  # JSON tells neither the other dimensions nor the kind
            array = np.zeros([n or 0 for n in (0, *shape[1:])], dtype)
        elif array.dtype == np.int64:
            array = array.astype(dtype)
    sized = zip(shape, array.shape, strict=False)
    right = array.ndim == len(shape) and all(n in (None, size) for n, size in sized)
    if not right or array.dtype != dtype:
        wanted = ", ".join(d if n is None else str(n) for d, n in zip(dims, shape, strict=True))
        raise WeightsError(
            where,
            got=f"{array.dtype} of shape {array.shape}",
            expected=f"{dtype} of shape ({wanted})",
            hint=how,
        )
    if not np.isfinite(array).all():
        raise WeightsError(where, got="NaN or infinity", expected="finite numbers", hint=how)
    sizes |= zip(dims, array.shape, strict=True)
    return array
