"""Networks of `joint-gmm` that have learned from several places, and are fitted to one later.

The file `joint-trunks.safetensors` in the folder of the scenes has them: for each recorded scene,
those that have learned from the others, and for every other place, those that have learned from
all. Those of a place differ in their random seeds.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from crowdbench.errors import WeightsError
from crowdbench.files import read_bytes, replacing
from crowdbench.scene import scenes_folder
from crowdbench.spawn.joint.model import SHARED

FILE = "joint-trunks.safetensors"
ANYWHERE = "anywhere"
"""The trunk of places that have none of their own."""
SEEDS = 5
Trunk = Mapping[str, Float32[np.ndarray, "..."]]
"""Weights of a network by name, and raw `followers`; without those of areas."""
NAMES = (*SHARED, "followers")
_HINT = "Make it with `python -m crowdbench.baselines.joint`."


def read_trunk(place: str, seed: int, folder: Path | None = None) -> Trunk:
    """The trunk for a place; `seed` is taken modulo the number of trunks.

    Raises:
        WeightsError: the file is missing or broken.
    """
    path = (folder or scenes_folder()) / FILE
    trunks = _read(path)
    places = {key.split("/")[0] for key in trunks}
    at = f"{place if place in places else ANYWHERE}/{seed % SEEDS}"
    found = {name: trunks.get(f"{at}/{name}") for name in NAMES}
    missing = [name for name, array in found.items() if array is None]
    if missing:
        got = f"nothing for {at}: {', '.join(missing)}"
        raise WeightsError(path, got=got, expected="all weights", hint=_HINT)
    return {name: array for name, array in found.items() if array is not None}


def write_trunks(trunks: Mapping[str, list[Trunk]], folder: Path) -> Path:
    """Write `SEEDS` trunks for each place."""
    from safetensors.numpy import save

    tensors = {
        f"{place}/{seed}/{name}": np.ascontiguousarray(trunk[name], np.float32)
        for place, several in sorted(trunks.items())
        for seed, trunk in enumerate(several)
        for name in NAMES
    }
    with replacing(folder / FILE) as temporary:
        temporary.write_bytes(save(tensors))
    return folder / FILE


@cache
def _read(path: Path) -> dict[str, np.ndarray]:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        return load(read_bytes(path, WeightsError, _HINT))
    except SafetensorError as error:
        got = f"unreadable weights ({error})"
        raise WeightsError(path, got=got, expected="safetensors", hint=_HINT) from error
