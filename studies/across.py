"""How `anticipate` walks in places that it was not trained on.

    python -m studies across > docs/across.md

For each scene, one network is trained on the others, and is scored on the held-out blocks of this
scene beside the policies that were trained there and beside social forces. Files of an earlier call
of the same command and code are kept.
"""

import contextlib
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from crowdbench import load_scene, registry
from crowdbench.baselines.packages import needs
from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError
from crowdbench.evaluation import evaluate
from crowdbench.report.text.words import interval
from crowdbench.run.executor import call_each, checked_workers
from crowdbench.scoring.ranking import Row, rows
from studies.markdown import table

with needs("fit", __name__):
    from crowdbench.baselines.anticipate import AnticipateSettings, learn
    from crowdbench.baselines.command import Command, use_one_thread
    from studies.ablation import difference

SCENES = ("eth-v0", "hotel-v0", "zara1-v0", "gc-v0", "forum-v0")
SPLIT = "full"
OUT = Path("results/across")
"""Default folder of the policies and rollouts."""
OTHERS = ("anticipate", "social-force")
"""Policies for comparison: the one trained on the scene comes first."""

INTRODUCTION = """# Walking in other places

For each scene, `anticipate` is trained on the others: *elsewhere*. It is compared with the
`anticipate` that was trained on the scene itself, on the training blocks of each fold (*there*),
and with social forces. All are scored on the same held-out blocks under the recorded arrivals. The
score is *walk*, the lesser of motion and interaction; both are shown for the policy trained
elsewhere. The last two columns are its score minus those of the other two policies. Brackets are
95 % intervals. This page is the output of
"""


def files_of(command: Command) -> list[Path]:
    """The file that `write` writes."""
    return [command.path(SPLIT)]


def write(command: Command) -> None:
    """Train a policy and write its file, unless this command and code have written it."""
    if not command.has_written(SPLIT):
        use_one_thread()
        with contextlib.redirect_stdout(sys.stderr):
            learn(command, SPLIT, AnticipateSettings())


def line(scene: str, found: Mapping[str, Row], elsewhere: str) -> list[str]:
    """The row of a scene, whose policy from elsewhere has this name."""
    other, forces = found[elsewhere], found[OTHERS[1]].walk
    there = found[OTHERS[0]]
    families = [interval(other.families.get(family)) for family in ("motion", "interaction")]
    walks = [interval(row.walk) for row in (there, found[OTHERS[1]])]
    return [
        scene,
        interval(other.walk),
        *families,
        *walks,
        difference(other.walk, there.walk),
        difference(other.walk, forces),
    ]


HEAD = (
    "scene", "elsewhere", "motion", "interaction", "there", "social-force",
    "elsewhere − there", "elsewhere − social-force",
)  # fmt: skip


def commands_of(scenes: Sequence[str], out: Path) -> list[Command]:
    """The trainings without each scene, and the one with all."""
    if len(set(scenes)) < len(scenes):
        raise SettingError("scenes", got=" ".join(scenes), expected="each scene once")
    if len(scenes) < 3:
        raise SettingError(
            "scenes",
            got=" ".join(scenes),
            expected="three or more: two to train on, and one that is left out",
        )
    found = []
    for left_out in (*scenes, None):
        given = ["--scenes", *scenes] + ([] if left_out is None else ["--leave-out", left_out])
        folder = out / (f"without-{left_out}" if left_out else registry.ANY_PLACE)
        found.append(Command.of_several("anticipate", scenes, left_out, [SPLIT], folder, given))
    return found


def write_across(
    scenes: Sequence[str] = SCENES, *, out: Path = OUT, workers: int | None = None
) -> str:
    """Train and score all policies; return the page.

    Policies and rollouts are kept in `out`.

    Raises:
        SceneError, RecordingError, WeightsError, SettingError: a scene, its recording or its
            policy `anticipate` does not exist, there are fewer than three scenes, or `workers` is
            not positive.
        OutputError: `out` cannot be written.
    """
    workers = checked_workers(workers)
    commands = commands_of(scenes, out)
    for scene in scenes:  # what is missing is said before the trainings
        registry.recording_of(load_scene(scene))
        registry.policy(OTHERS[0], scene, SPLITS[1])
    tasks = [(command,) for command in commands]
    for done, _ in enumerate(call_each(write, tasks, workers, files=files_of), 1):
        print(f"{done} of {len(tasks)} policies trained", file=sys.stderr)
    lines = []
    for scene, command in zip(scenes, commands, strict=False):
        elsewhere = str(command.path(SPLIT))
        card = evaluate(
            scene,
            spawn="replay",
            policy=[elsewhere, *OTHERS],
            protocol="heldout",
            workers=workers,
            out=out / "evaluation" / command.out.name,
            report=False,
        )
        found = {row.policy: row for row in rows(card) if row.kind == "entry"}
        lines.append(line(scene, found, elsewhere))
    asked = [] if tuple(scenes) == SCENES else scenes
    call = f"    {shlex.join(['python', '-m', 'studies', 'across', *asked])}"
    return "\n".join([INTRODUCTION, f"{call}\n", table(list(HEAD), lines)])
