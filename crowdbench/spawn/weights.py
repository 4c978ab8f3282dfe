"""Files with a model's fits: per part (the whole recording, and each fold), in a scene's folder.

Models with few numbers per area keep them as JSON, one fit per part.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from crowdbench.errors import SettingError, WeightsError
from crowdbench.files import read_struct, write_json
from crowdbench.scene import Scene
from crowdbench.spawn.areas import as_array
from crowdbench.trajectories.blocks import PARTS

SCHEMA = 2

M = TypeVar("M")
Fits = Mapping[str, Sequence[M]]
"""The fits of a model: for each of `PARTS` one, or several that differ in their seed."""


class _AnySchema(msgspec.Struct, frozen=True):
    schema: int


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    model: str
    scene: str
    parts: dict[str, dict[str, list[float]]]


def hint(scene: Scene) -> str:
    """How to mend weights that are missing or broken, in a scene's folder or in another."""
    if (scene.folder / "scene.toml").is_file():
        return f"Run `crowdbench fit {scene.asked}`."
    return f"Make them with `crowdbench fit {scene.id} --out FOLDER`."


def check_part(part: str, fit: int) -> None:
    """Refuse a part or a fit that no model has.

    Raises:
        SettingError: `part` is none of `PARTS`, or `fit` is negative.
    """
    if part not in PARTS:
        raise SettingError("part", got=repr(part), expected=f"one of {', '.join(PARTS)}")
    if fit < 0:
        raise SettingError("fit", got=str(fit), expected="0 or more")


def check_origin(
    path: Path, got: tuple[str, str, int], expected: tuple[str, str, int], hint: str
) -> None:
    """Compare model, scene and schema of a file.

    Raises:
        WeightsError: they differ.
    """
    if got != expected:
        raise WeightsError(
            path,
            got="{} of {}, schema {}".format(*got),
            expected="{} of {}, schema {}".format(*expected),
            hint=hint,
        )


def write_parts(
    path: Path, model: str, scene: str, parts: Mapping[str, Mapping[str, np.ndarray]]
) -> None:
    """Write one fit per part: for each name one number per area."""
    plain = {p: {name: x.tolist() for name, x in fit.items()} for p, fit in parts.items()}
    write_json(path, _File(schema=SCHEMA, model=model, scene=scene, parts=plain))


def read_part(
    scene: Scene, model: str, names: Sequence[str], areas: int, part: str
) -> dict[str, np.ndarray]:
    """The numbers of one part, an array of shape (areas,) for each of `names`.

    Raises:
        WeightsError: the file is missing or broken, of an earlier schema, or another scene's.
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
        (set(file.parts), set(PARTS), "parts"),
        *((set(fit), set(names), f"parts.{p}") for p, fit in file.parts.items()),
    ):
        if got != expected:
            raise WeightsError(
                f"{path}, {where}",
                got=", ".join(sorted(got)) or "nothing",
                expected=", ".join(sorted(expected)),
                hint=how,
            )
    arrays = {}
    for p, fit in file.parts.items():
        for name, values in fit.items():
            array = as_array(values, (areas,), f"{path}, parts.{p}.{name}", how)
            if p == part:
                arrays[name] = array
    return arrays


def check_numbers(scene: Scene, model: str, numbers: Mapping[str, tuple[bool, str]]) -> None:
    """Refuse numbers of the right shape that mean nothing.

    Raises:
        WeightsError: one of `numbers` (whether it holds, and what is expected) does not hold.
    """
    for name, (holds, expected) in numbers.items():
        if not holds:
            path = scene.folder / f"{model}.json"
            raise WeightsError(
                f"{path}, {name}", got="other numbers", expected=expected, hint=hint(scene)
            )
