"""The models with calibrated parameters: `crowdbench evaluate eth-v0 --protocol heldout --policy
examples.peers.calibrated:CollisionFreeSpeedV2`.

`calibrated.json` has the parameters of each model by scene and split. It is written by `python -m
examples.peers calibrate`.
"""

import json
from collections.abc import Mapping
from pathlib import Path

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError
from crowdbench.scene import Scene

from .models import MODELS, Peer

FILE = Path(__file__).parent / "calibrated.json"


def known_parameters() -> dict[str, dict[str, dict[str, dict[str, float]]]]:
    """All calibrated parameters by model, scene and split."""
    return json.loads(FILE.read_text())["parameters"] if FILE.exists() else {}


def is_calibrated(model: str, scene: str) -> bool:
    """Whether a model has calibrated parameters for all folds of a scene."""
    return set(SPLITS[1:]) <= set(known_parameters().get(model, {}).get(scene, ()))


def parameters_of(model: str, scene: str, split: str) -> Mapping[str, float]:
    """The calibrated parameters of a model.

    Raises:
        SettingError: it was not calibrated for this scene and split.
    """
    try:
        return known_parameters()[model][scene][split]
    except KeyError as error:
        raise SettingError(
            f"{model} on {scene}, {split}",
            got="no calibrated parameters",
            expected=f"some in {FILE}",
            hint=f"Run `python -m examples.peers calibrate {scene} --model {model}`; "
            "`crowdbench evaluate` needs --protocol heldout.",
        ) from error


def _calibrated(kind: type[Peer]) -> type[Peer]:
    def __init__(self: Peer, scene: Scene, split: str) -> None:  # noqa: N807
        kind.__init__(self, parameters_of(kind.name, scene.id, split))

    own = {"__init__": __init__, "__module__": __name__, "__doc__": kind.__doc__}
    return type(kind.__name__, (kind,), own)


for _kind in MODELS.values():
    globals()[_kind.__name__] = _calibrated(_kind)
