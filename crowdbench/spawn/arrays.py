"""Arrays in the files of a scene: their shapes, and what must hold for them."""

from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import msgspec
import numpy as np
from msgspec import structs

from crowdbench.errors import WeightsError
from crowdbench.scene import Scene

DEFINITE = "symmetric, positive definite matrices"
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


def dtype_of(annotation: Any) -> str:
    """Kind of number of an annotated array in a file; of `Float`, it is float64."""
    kinds = ("float64", "int64", "float32", "float16")
    return next(name for name in kinds if name in annotation.dtypes)


def hint(scene: Scene) -> str:
    """The hint of errors about missing or broken fits: how to make them again."""
    if (scene.folder / "scene.toml").is_file():
        return f"Run `crowdbench scene fit {scene.asked}`."
    return f"Create them with `crowdbench scene fit {scene.id} --out FOLDER`."


def are_definite(matrices: np.ndarray) -> bool:
    """Whether matrices are symmetric and positive definite."""
    symmetric = np.allclose(matrices, matrices.swapaxes(-1, -2))
    return symmetric and bool((np.linalg.eigvalsh(matrices) > 0).all() if matrices.size else True)


def check_origin(
    header: dict[str, Any], what: object, expected: list[object], path: Path, how: str
) -> None:
    """Check what a file is of, its scene and its schema; the latter two are taken out of it."""
    origin = [what, header.pop("scene", None), header.pop("schema", None)]
    if origin != expected:
        got = "{} of {}, schema {}".format(*origin)
        raise WeightsError(
            path, got=got, expected="{} of {}, schema {}".format(*expected), hint=how
        )


def checked(raw: Any, kind: type[F], scene: Scene, sizes: Mapping[str, int], where: str) -> F:
    """The fit in a file; raises WeightsError if a shape or a value is wrong."""
    how = hint(scene)
    fit: F = _read(raw, kind, sizes, where, how)
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
        got = f"missing or unknown: {', '.join(wrong)}"
        expected = f"exactly {', '.join(names.values())}"
        raise WeightsError(where, got=got, expected=expected, hint=how)
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
    dims, dtype = of.dim_str.split(), dtype_of(of)
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
        got = f"{array.dtype} of shape {array.shape}"
        raise WeightsError(where, got=got, expected=f"{dtype} of shape ({wanted})", hint=how)
    if not np.isfinite(array).all():
        raise WeightsError(where, got="NaN or infinity", expected="finite numbers", hint=how)
    sizes |= zip(dims, array.shape, strict=True)
    return array
