"""Shared code of the training scripts: options, checks before training, and export."""

import argparse
import math
import os
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import torch
from torch import nn

from crowdbench import load_scene, spawn_model
from crowdbench.errors import SettingError, WeightsError
from crowdbench.files import revision, unwritable
from crowdbench.policies import OnnxPolicy, PolicyCard
from crowdbench.policies.export import export_policy
from crowdbench.policies.network import read_card
from crowdbench.registry import DEFAULT_SPAWN
from crowdbench.run.executor import call_each, checked_workers, engine, is_local
from crowdbench.run.processes import LOCAL
from crowdbench.scene import Scene
from crowdbench.spawn.fits import check_split

from .progress import Progress
from .walked import Walked, walked

WITHOUT_EFFECT = ("--out", "--workers", "--engine")
"""Options with one value that do not change the policy."""
MAX_FRAME_RATIO = 1.15
"""Largest ratio of the frame lengths of scenes that one policy is trained on. The ratio of the
Forum (0.444 s) and the others (0.4 s) is 1.11."""
WALKED_S = 600.0
"""Length of the rollout that tests a trained policy."""


def use_one_thread() -> None:
    """Let torch use one thread, unless `OMP_NUM_THREADS` is set.

    Several threads do not speed up such small networks. On a busy machine they are many times
    slower, because they wait for each other.
    """
    if "OMP_NUM_THREADS" not in os.environ:
        torch.set_num_threads(1)


def check_numbers(
    settings: Any, *, or_zero: Sequence[str] = (), prefixed: Sequence[str] = (), prefix: str = ""
) -> None:
    """Check that all numbers of a dataclass are positive; those named in `or_zero` may be 0.

    The options of the settings in `prefixed` begin with `prefix`.

    Raises:
        SettingError: a number is out of range.
    """
    for name in (f.name for f in fields(settings)):
        value = getattr(settings, name)
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, str):
                continue
            if not math.isfinite(number) or number < 0 or (number == 0 and name not in or_zero):
                least = "0 or more" if name in or_zero else "above 0"
                option = f"{prefix if name in prefixed else ''}{name.replace('_', '-')}"
                raise SettingError(option, got=f"{number:g}", expected=f"a number, {least}")


def new_parser(
    name: str, description: str | None, *, several: bool = False
) -> argparse.ArgumentParser:
    """Argument parser of `python -m crowdbench.baselines.NAME` with the options of all scripts.

    With `several`, it also has `--scenes` and `--leave-out`.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m {_module(name)}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--scene", help="id of a scene, or its folder")
    if several:
        where.add_argument(
            "--scenes", nargs="+", metavar="SCENE", help="train one policy on all these scenes"
        )
        parser.add_argument(
            "--leave-out",
            metavar="SCENE",
            help="one of --scenes: do not train on it, and validate the policy on it",
        )
    parser.add_argument(
        "--splits",
        nargs="+",
        default=["full"],
        metavar="SPLIT",
        help="splits of the recording; one policy is trained on each. full: the whole recording; "
        "fold0, fold1, fold2: two thirds of it, for --protocol heldout (default: full)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="random seed (default: %(default)s)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help=f"output folder (default: results/{name}-SCENE)"
    )
    add_engine(parser, "1, or one per core of a cluster; more train several splits at once")
    return parser


def add_engine(parser: argparse.ArgumentParser, default: str = "one per core") -> None:
    """Add the options `--workers`, whose absence means `default`, and `--engine`."""
    parser.add_argument(
        "--workers", type=int, metavar="N", help=f"worker processes (default: {default})"
    )
    parser.add_argument(
        "--engine",
        default=LOCAL,
        help="where they run: local, ray, or the address ray://HOST:PORT of a Ray cluster "
        "(default: local)",
    )


def train_each(
    learn: Callable[..., str],
    command: "Command",
    asked: argparse.Namespace,
    *settings: object,
    also: Sequence[str] = (),
) -> None:
    """Call `learn(split, command, *settings)` for each split and print the lines that it returns.

    The calls run on the engine that the command line names, and torch uses one thread in each.
    `also` are suffixes of files that `learn` writes beside that of the policy.

    Raises:
        CrowdbenchError: any error of `learn`.
    """
    with engine(asked.engine):
        tasks = [(split, command) for split in asked.splits]
        done = call_each(
            _learned,
            tasks,
            1 if asked.workers is None and is_local() else checked_workers(asked.workers),
            common=(learn, settings),
            name=lambda split, command: f"the training on {split}",
            files=lambda split, command: [
                command.path(split).with_suffix(suffix) for suffix in (".onnx", *also)
            ],
        )
        with closing(done):
            for k, told in done:
                for line in told.splitlines():
                    print(f"{command.path(asked.splits[k])}: {line}", flush=True)


def _learned(
    split: str, command: "Command", learn: Callable[..., str], settings: Sequence[object]
) -> str:
    use_one_thread()
    return learn(split, command, *settings)


def check_device(device: str) -> None:
    """Check that torch can use a device.

    Raises:
        SettingError: torch does not know it, or has no access to it.
    """
    try:
        torch.zeros(1, device=device)
    except Exception as error:  # torch raises many kinds
        told = str(error).splitlines()[0]
        raise SettingError(
            "device", got=f"{device!r} ({told})", expected="cpu, or cuda with a GPU"
        ) from error


def _module(name: str) -> str:
    return f"crowdbench.baselines.{name.replace('-', '_')}"


def add_settings(
    parser: argparse._ActionsContainer, default: Any, told: Mapping[str, str], prefix: str = ""
) -> None:
    """Add an option for each setting in `told`, which maps names of settings to help texts."""
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
    """A call of `python -m crowdbench.baselines.NAME` whose arguments have been checked."""

    name: str
    scene: Scene
    out: Path
    given: Sequence[str]
    further: Sequence[Scene] = ()
    """Other scenes that the same policy is trained on."""
    revision: str = field(default_factory=lambda: revision(Path(__file__).parent))
    """That of the code, which is not under version control on the nodes of a cluster."""

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """All scenes that it trains on."""
        return (self.scene, *self.further)

    @classmethod
    def of(
        cls,
        name: str,
        scene: str,
        splits: Sequence[str],
        out: Path | None,
        arguments: Sequence[str] | None,
    ) -> "Command":
        """Load the scene and create the output folder, by default `results/NAME-SCENE`.

        Raises:
            SceneError, SettingError: the scene or a split does not exist.
            OutputError: the folder cannot be created.
        """
        place = load_scene(scene)
        return cls._checked(name, [place], splits, out, f"{name}-{place.id}", arguments)

    @classmethod
    def of_asked(
        cls, name: str, asked: argparse.Namespace, arguments: Sequence[str] | None
    ) -> "Command":
        """The command of a parser with `several`.

        Raises:
            SceneError, SettingError, OutputError: see `of` and `of_several`.
        """
        if asked.scenes is not None:
            return cls.of_several(
                name, asked.scenes, asked.leave_out, asked.splits, asked.out, arguments
            )
        if asked.leave_out is not None:
            raise SettingError(
                "--leave-out",
                got="--scene",
                expected="--scenes with several scenes, of which it is one",
            )
        return cls.of(name, asked.scene, asked.splits, asked.out, arguments)

    @classmethod
    def of_several(
        cls,
        name: str,
        scenes: Sequence[str],
        left_out: str | None,
        splits: Sequence[str],
        out: Path | None,
        arguments: Sequence[str] | None,
    ) -> "Command":
        """Load all scenes but the one left out; the policy is called NAME-any.

        The output folder is by default `results/NAME-any` or `results/NAME-any-without-SCENE`.

        Raises:
            SceneError, SettingError: a scene or a split does not exist, the scenes have different
                maximum speeds, or there are none but the one left out.
            OutputError: the folder cannot be created.
        """
        places = list({place.id: place for place in map(load_scene, scenes)}.values())
        folder = f"{name}-any"
        if left_out is not None:
            other = load_scene(left_out).id
            if other not in [place.id for place in places]:
                raise SettingError(
                    "--leave-out", got=other, expected="one of the scenes named in --scenes"
                )
            places = [place for place in places if place.id != other]
            folder = f"{folder}-without-{other}"
        if len(places) < 2:
            raise SettingError(
                "--scenes",
                got=f"{len(places)} to train on",
                expected="two or more",
                hint="Use --scene to train on one.",
            )
        fastest = {place.id: place.motion.max_speed_mps for place in places}
        if len(set(fastest.values())) > 1:
            raise SettingError(
                "--scenes",
                got=", ".join(f"{scene} with {speed:g} m/s" for scene, speed in fastest.items()),
                expected="scenes with the same maximum speed",
            )
        frames_s = {place.id: place.dt_s for place in places}
        if max(frames_s.values()) > MAX_FRAME_RATIO * min(frames_s.values()):
            raise SettingError(
                "--scenes",
                got=", ".join(f"{scene} with {dt_s:.3g} s" for scene, dt_s in frames_s.items()),
                expected="scenes whose frames are about equally long",
                hint="A network decides every few frames, in each scene the same number.",
            )
        return cls._checked(f"{name}-any", places, splits, out, folder, arguments)

    @classmethod
    def _checked(
        cls,
        name: str,
        places: Sequence[Scene],
        splits: Sequence[str],
        out: Path | None,
        usual: str,
        arguments: Sequence[str] | None,
    ) -> "Command":
        for split in splits:
            check_split(split, 0)
        folder = out or Path("results") / usual
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise unwritable(folder, error) from error
        given = sys.argv[1:] if arguments is None else arguments
        return cls(name, places[0], folder, given, places[1:])

    @property
    def line(self) -> str:
        """The command line of this call, without the options that do not change the policy."""
        kept, skipped = [], False
        for argument in self.given:
            if skipped:  # the value of the option before it
                skipped = False
            elif argument.partition("=")[0] in WITHOUT_EFFECT:
                skipped = "=" not in argument
            else:
                kept.append(argument)
        return f"python -m {self.program} {shlex.join(kept)}"

    @property
    def program(self) -> str:
        """What `python -m` runs."""
        return _module(self.name.removesuffix("-any"))

    def path(self, split: str) -> Path:
        """The policy file of a split."""
        return self.out / f"{split}.onnx"

    def has_written(self, split: str) -> bool:
        """Whether the file of a split is there, written by the same command and code.

        Without git or with changes that are not committed, the code is not known.
        """
        if self.revision == "" or self.revision.endswith("-dirty"):
            return False
        try:
            card = read_card(self.path(split))
        except WeightsError:
            return False
        return (card.revision, card.command) == (self.revision, self.line)

    def write(
        self,
        split: str,
        network: nn.Module,
        *,
        observation: str,
        noise: int,
        interval: int = 1,
    ) -> Path:
        """Export the policy of a split and return its path; see `export_policy`.

        The card contains the command line of this call.
        """
        card = PolicyCard(
            name=self.name,
            observation=observation,
            interval=interval,
            scene="+".join(place.id for place in self.scenes),
            split=split,
            max_speed_mps=self.scene.motion.max_speed_mps if self.further else None,
            command=self.line,
            revision=self.revision,
        )
        return export_policy(network, self.path(split), card, noise=noise)

    def progress(self, run: str, total: int, unit: str, counted: str) -> Progress:
        """Progress of a training, whose log is `tensorboard/RUN` in the output folder.

        See `Progress` for the other arguments.
        """
        return Progress(total, unit, counted, self.out / "tensorboard" / run)

    def walk(self, path: Path, spawn: str = DEFAULT_SPAWN) -> Walked:
        """Figures of a rollout of ten minutes with an exported policy."""
        crowd = spawn_model(spawn, self.scene)
        return walked(self.scene, crowd, OnnxPolicy(path), horizon_s=WALKED_S)
