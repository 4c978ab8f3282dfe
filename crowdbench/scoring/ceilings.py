"""What a right model would score in walking: less than 1, because people act by chance, too.

Two rollouts of a model differ, the more so the less there is to count. So a perfect model with
random numbers scores less than 1 in motion and interaction. The ceiling is an estimate of its
score: what a policy would get if the recording were one of its own rollouts.
`python -m studies ceilings` measures it.
"""

from pathlib import Path

import msgspec

from crowdbench.errors import WeightsError
from crowdbench.files import read_struct
from crowdbench.scene import Scene

FILE = "ceilings.json"


class Ceiling(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The scores of a right model under one kind of arrivals."""

    metrics: dict[str, float]
    """By metric, of the scored ones."""
    families: dict[str, float]
    """Motion and interaction, the means of their metrics."""
    walk: float
    """The lesser of motion and interaction."""


class Ceilings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The content of a scene's `ceilings.json`."""

    command: str
    """The command that writes the file."""
    policy: str
    """The policy whose rollouts stand for the recording."""
    recorded: Ceiling
    """With people who enter as recorded."""
    perturbed: Ceiling
    """With people who enter a little earlier or later and beside their recorded places."""


def read_ceilings(scene: Scene) -> Ceilings | None:
    """The ceilings of a scene; None if they are not measured.

    Raises:
        WeightsError: the file is broken.
    """
    path: Path = scene.folder / FILE
    if not path.is_file():
        return None
    hint = f"Run `python -m studies ceilings {scene.asked}`."
    return read_struct(path, Ceilings, WeightsError, hint)
