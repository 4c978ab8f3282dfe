"""What each part of `anticipate` contributes: it is trained and scored without it, held out.

    python -m studies ablation eth-v0 > docs/ablation.md

For each variant and fold, the network is trained and its guide chosen anew, on the training blocks
of the fold. Then all variants are scored together, so that their differences have intervals. Files
of an earlier call of the same command and code are kept.
"""

import contextlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from crowdbench.baselines.packages import needs
from crowdbench.data.blocks import SPLITS
from crowdbench.evaluation import evaluate
from crowdbench.report.text.words import interval
from crowdbench.run.executor import call_each, checked_workers
from crowdbench.run.validation import Validator
from crowdbench.scene import Scene
from crowdbench.scoring.ranking import Row, rows
from crowdbench.scoring.score import Score
from crowdbench.simulation import social
from studies.markdown import table

with needs("fit", __name__):
    import torch
    from torch import Tensor

    from crowdbench.baselines.anticipate import (
        AnticipateSettings,
        decision_frames,
        frames_ahead,
        guided,
        train,
    )
    from crowdbench.baselines.anticipation import (
        NOISE,
        OBSERVATION,
        PLAIN,
        Guide,
        Perception,
        Sampler,
        Walker,
    )
    from crowdbench.baselines.command import Command, use_one_thread

NEIGHBOURS = np.arange(social.NEIGHBOURS.start, social.NEIGHBOURS.stop).reshape(
    social.NEAREST, social.FEATURES
)


USUAL = AnticipateSettings()


def _columns(*parts: slice) -> tuple[int, ...]:
    return tuple(k for part in parts for k in range(part.start, part.stop))


def _of_neighbours(*parts: slice) -> tuple[int, ...]:
    return tuple(int(k) for part in parts for k in NEIGHBOURS[:, part].ravel())


@dataclass(frozen=True)
class Variant:
    """`anticipate` with one part changed."""

    name: str
    what: str
    """Description in the table."""
    settings: AnticipateSettings = USUAL
    unseen: tuple[int, ...] = ()
    """Columns of the observation that the network sees as zeros."""
    interval: int = 1
    """Time between two decisions, as a multiple of the usual one."""
    ahead: int = 1
    """Time over which the network learns the mean velocity, as a multiple of the usual one."""
    guide: bool = True
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Settings of the guide that are not chosen."""


VARIANTS = (
    Variant("all", "all parts"),
    Variant("no-guide", "one candidate, no guide", guide=False),
    Variant("no-plan", "no candidate that the plan asks for", fixed={"resume": PLAIN.resume}),
    Variant(
        "no-others",
        "the network sees nobody else (the guide does)",
        unseen=_columns(social.NEIGHBOURS),
    ),
    Variant(
        "no-velocities",
        "it sees where others are, not how they move",
        unseen=_of_neighbours(social.APPROACH, social.PASS_TIME, social.PASS_DISTANCE),
    ),
    Variant(
        "no-memory",
        "it remembers neither age, distance walked nor time stood",
        unseen=_columns(social.AGE, social.WALKED, social.STOOD),
    ),
    Variant(
        "no-smoothing", "cloned on recorded paths as they are", AnticipateSettings(smoothing_s=0.0)
    ),
    Variant("no-jitter", "cloned without jitter", AnticipateSettings(jitter_mps=0.0)),
    Variant("ahead", "it learns the velocity over twice the time", ahead=2),
    Variant(
        "slower",
        "it learns the velocity over twice the time, and decides half as often",
        ahead=2,
        interval=2,
    ),
)
"""The first one is compared with the others."""

INTRODUCTION = """# What each part of anticipate contributes

`anticipate` is trained and scored on {scene} with one part changed at a time. For each variant and
fold, the network is trained and its guide chosen anew on the training blocks. The scores are those
of walking under the recorded arrivals on held-out blocks, with 95 % intervals. The last column is
the difference of *walk* to the first row. Its interval is narrower than those of the scores,
because all variants are compared on the same resampled blocks. This page is the output of
"""


class Training(Command):
    """The trainings of this study."""

    @property
    def program(self) -> str:
        """What `python -m` runs."""
        return "studies ablation"


class Blind(Perception):
    """A perception that sees some columns of the observation as zeros."""

    visible: Tensor

    def __init__(self, max_speed_mps: float, unseen: Sequence[int]) -> None:
        super().__init__(max_speed_mps)
        visible = torch.ones(social.SIZE)
        visible[list(unseen)] = 0
        self.register_buffer("visible", visible)

    def forward(self, seen: Tensor, jitter: Tensor) -> Tensor:
        """Features of what it sees."""
        return super().forward(seen * self.visible, jitter)


def walker_of(variant: Variant, scene: Scene) -> Walker:
    """A new network of a variant."""
    walker = Walker(scene.motion.max_speed_mps, variant.settings.hidden)
    if variant.unseen:
        walker.perception = Blind(scene.motion.max_speed_mps, variant.unseen)
    return walker


def write(variant: Variant, split: str, command: Command) -> None:
    """Train a variant and write its file, unless this command and code have written it."""
    if command.has_written(split):
        return
    use_one_thread()
    with contextlib.redirect_stdout(sys.stderr):
        validators = [Validator(command.scene, split)]
        ahead = variant.ahead * frames_ahead(command.scene)
        every = variant.interval * decision_frames(command.scene)
        torch.manual_seed(variant.settings.seed)
        walker = walker_of(variant, command.scene)
        train(command, split, variant.settings, ahead, walker)
        sampler = Sampler(walker, Guide())
        chosen = PLAIN
        if variant.guide:
            chosen = guided(sampler, validators, every, variant.settings, variant.fixed)
        sampler.weights.copy_(chosen.tensor())
        command.write(split, sampler, observation=OBSERVATION, noise=NOISE, interval=every)


def files_of(variant: Variant, split: str, command: Command) -> list[Path]:
    """The file that `write` writes."""
    return [command.path(split)]


def lines(found: Sequence[Row]) -> list[list[str]]:
    """The table: one row per variant, in the order of `VARIANTS`."""
    first = found[0].walk
    return [
        [
            variant.what,
            *(interval(score) for score in (row.walk, row.families.get("motion"))),
            interval(row.families.get("interaction")),
            "" if row.walk is first else difference(row.walk, first),
        ]
        for variant, row in zip(VARIANTS, found, strict=True)
    ]


def difference(one: Score | None, other: Score | None) -> str:
    """The difference of two scores of the same resampled blocks, with its interval."""
    if one is None or other is None:
        return "–"
    return interval(
        replace(one, value=one.value - other.value, resampled=one.resampled - other.resampled)
    )


def write_ablation(scene: str, *, out: Path | None = None, workers: int | None = None) -> str:
    """Train and score all variants on a scene; return the page.

    Policies and rollouts are kept in `out`, by default `results/ablation-SCENE`.

    Raises:
        SceneError, RecordingError, SettingError: the scene or its recording does not exist, or
            `workers` is not positive.
        OutputError: `out` cannot be written.
    """
    folds = SPLITS[1:]
    workers = checked_workers(workers)
    whole = Training.of("ablation", scene, folds, out, [scene])
    commands = [
        Training.of("ablation", scene, folds, whole.out / v.name, [scene]) for v in VARIANTS
    ]
    tasks = [
        (variant, fold, command)
        for fold in folds
        for variant, command in zip(VARIANTS, commands, strict=True)
    ]
    for done, _ in enumerate(call_each(write, tasks, workers, files=files_of), 1):
        print(f"{done} of {len(tasks)} policies trained", file=sys.stderr)
    folders = [str(command.out) for command in commands]
    card = evaluate(
        scene,
        spawn="replay",
        policy=folders,
        protocol="heldout",
        workers=workers,
        out=whole.out / "evaluation",
        report=False,
    )
    by_policy = {row.policy: row for row in rows(card) if row.kind == "entry"}
    head = ["variant", "walk", "motion", "interaction", "difference"]
    return "\n".join(
        [
            INTRODUCTION.format(scene=whole.scene.id),
            f"    {whole.line}\n",
            table(head, lines([by_policy[folder] for folder in folders])),
        ]
    )
