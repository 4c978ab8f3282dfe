"""What the baselines' commands share: what is checked before training, a policy's file, and how it
walks.
"""

import argparse
import math
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from crowdbench import load_scene, rollout
from crowdbench.errors import SettingError
from crowdbench.files import unwritable
from crowdbench.policies import OnnxPolicy, PolicyCard
from crowdbench.policies.export import export_policy, revision
from crowdbench.registry import DEFAULT_SPAWN
from crowdbench.scene import Scene
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.weights import check_part
from crowdbench.trajectories.table import OUTCOMES

WALKED_S = 600.0


def use_one_thread() -> None:
    """Let torch train on one thread, unless `OMP_NUM_THREADS` says otherwise.

    Networks this small gain nothing by several, and threads that wait for each other on a busy
    machine take many times as long.
    """
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(1)


def check_numbers(settings: Any, *, or_zero: Sequence[str] = ()) -> None:
    """Raise where a number of a dataclass is not positive, or not at least 0 if it may be that.

    Raises:
        SettingError: one is not.
    """
    for name in (f.name for f in fields(settings)):
        value = getattr(settings, name)
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, str):
                continue
            if not math.isfinite(number) or number < 0 or (number == 0 and name not in or_zero):
                least = "0 or more" if name in or_zero else "above 0"
                raise SettingError(
                    name.replace("_", "-"), got=f"{number:g}", expected=f"a number, {least}"
                )


def new_parser(name: str, description: str | None) -> argparse.ArgumentParser:
    """A parser of `python -m baselines.NAME` with the options that all of them have."""
    parser = argparse.ArgumentParser(
        prog=f"python -m baselines.{name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--scene", required=True, help="id of a scene, or its folder")
    parser.add_argument(
        "--parts",
        nargs="+",
        default=["full"],
        metavar="PART",
        help="what to train on, a policy for each: full is all of the recording, fold0, fold1 and "
        "fold2 are two thirds of it, for --protocol heldout (default: full)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of all chance (default: %(default)s)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help=f"folder (default: results/{name}-SCENE)"
    )
    return parser


def add_settings(
    parser: argparse._ActionsContainer, default: Any, told: Mapping[str, str], prefix: str = ""
) -> None:
    """Give a parser options for some settings of a dataclass, by name with what is told of them."""
    for name, what in told.items():
        value = getattr(default, name)
        parser.add_argument(
            f"--{prefix}{name.replace('_', '-')}",
            type=type(value),
            default=value,
            metavar={int: "N", float: "X"}.get(type(value), "NAME"),
            help=f"{what} (default: %(default)s)",
        )


@dataclass(frozen=True)
class Command:
    """A call of `python -m baselines.NAME`, all of which can be done as far as one can tell."""

    name: str
    scene: Scene
    out: Path
    given: Sequence[str]

    @classmethod
    def of(
        cls,
        name: str,
        scene: str,
        parts: Sequence[str],
        out: Path | None,
        arguments: Sequence[str] | None,
    ) -> "Command":
        """Find the scene and make the folder, by default `results/NAME-SCENE`.

        Raises:
            SceneError, SettingError: there is no such scene or part.
            OutputError: the folder cannot be made.
        """
        place = load_scene(scene)
        for part in parts:
            check_part(part, 0)
        folder = out or Path("results") / f"{name}-{place.id}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise unwritable(folder, error) from error
        return cls(name, place, folder, sys.argv[1:] if arguments is None else arguments)

    def write(self, part: str, network: nn.Module, *, observation: str, noise: int) -> Path:
        """Write the policy of a part, with this call in its card; see `export_policy`."""
        card = PolicyCard(
            name=self.name,
            observation=observation,
            scene=self.scene.id,
            part=part,
            command=f"python -m baselines.{self.name} {shlex.join(self.given)}",
            revision=revision(Path(__file__).parent),
        )
        return export_policy(network, self.out / f"{part}.onnx", card, noise=noise)

    def walk(self, path: Path, spawn: str = DEFAULT_SPAWN) -> str:
        """Walk a crowd for ten minutes by a policy's file, and say how fast and how many arrive.

        Speeds are means over persons of what they walked per time, as `Trajectories.mean_speeds`.
        """
        crowd = rollout(self.scene, spawn, OnnxPolicy(path), seed=0, horizon_s=WALKED_S)
        over = crowd.left & (crowd.last > crowd.first)
        if not over.any():
            return f"nobody's way ended in {WALKED_S:.0f} s"
        recorded = float(np.mean(read_areas(self.scene).speed_quantiles))
        arrived = crowd.outcome[over] == OUTCOMES.index("goal")
        return (
            f"walked for {WALKED_S:.0f} s: mean speed {crowd.mean_speeds()[over].mean():.2f} m/s "
            f"(recorded {recorded:.2f}), {arrived.mean():.1%} of {len(arrived)} persons arrive"
        )
