"""Files with the fits of a model for each split, in a scene's folder.

Models with few parameters per area store them as JSON, with one fit per split.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError, WeightsError
from crowdbench.files import read_struct, write_json
from crowdbench.scene import Scene
from crowdbench.spawn.areas import as_array

SCHEMA = 2

M = TypeVar("M")
Fits = Mapping[str, Sequence[M]]
"""The fits of a model: one for each of `SPLITS`, or several that differ in their random seed."""


class _AnySchema(msgspec.Struct, frozen=True):
    schema: int


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    model: str
    scene: str
    splits: dict[str, dict[str, list[float]]]


def hint(scene: Scene) -> str:
    """The hint of errors about missing or broken weights: how to fit them again."""
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


def check_origin(
    path: Path, got: tuple[str, str, int], expected: tuple[str, str, int], hint: str
) -> None:
    """Check the model, scene and schema that a file states.

    Raises:
        WeightsError: they differ from the expected ones.
    """
    if got != expected:
        raise WeightsError(
            path,
            got="{} of {}, schema {}".format(*got),
            expected="{} of {}, schema {}".format(*expected),
            hint=hint,
        )


def write_splits(
    path: Path, model: str, scene: str, splits: Mapping[str, Mapping[str, np.ndarray]]
) -> None:
    """Write one fit per split; a fit has, for each name, one number per area."""
    plain = {p: {name: x.tolist() for name, x in fit.items()} for p, fit in splits.items()}
    write_json(path, _File(schema=SCHEMA, model=model, scene=scene, splits=plain))


def read_split(
    scene: Scene, model: str, names: Sequence[str], areas: int, split: str
) -> dict[str, np.ndarray]:
    """The fit for one split: an array of shape (areas,) for each of `names`.

    Raises:
        WeightsError: the file is missing or broken, has another schema, or belongs to another
            scene.
    """
    path = scene.folder / f"{model}.json"
    how = hint(scene)
    schema = read_struct(path, _AnySchema, WeightsError, how).schema
    if schema != SCHEMA:
        raise WeightsError(
            path, got=f"schema {schema}", expected=f"schema {SCHEMA}, with fits per fold", hint=how
        )
    file = read_struct(path, _File, WeightsError, how)
    check_origin(path, (file.model, file.scene, schema), (model, scene.id, SCHEMA), how)
    for got, expected, where in (
        (set(file.splits), set(SPLITS), "splits"),
        *((set(fit), set(names), f"splits.{p}") for p, fit in file.splits.items()),
    ):
        if got != expected:
            raise WeightsError(
                f"{path}, {where}",
                got=", ".join(sorted(got)) or "nothing",
                expected=", ".join(sorted(expected)),
                hint=how,
            )
    arrays = {}
    for p, fit in file.splits.items():
        for name, values in fit.items():
            array = as_array(values, (areas,), f"{path}, splits.{p}.{name}", how)
            if p == split:
                arrays[name] = array
    return arrays


def check_numbers(scene: Scene, model: str, numbers: Mapping[str, tuple[bool, str]]) -> None:
    """Check conditions on the values of a fit.

    `numbers` holds, for each parameter, whether its condition is met, and the condition as text.

    Raises:
        WeightsError: a condition is not met.
    """
    for name, (holds, expected) in numbers.items():
        if not holds:
            path = scene.folder / f"{model}.json"
            raise WeightsError(
                f"{path}, {name}", got="invalid values", expected=expected, hint=hint(scene)
            )
