"""How `anticipate` and `guided-walker` walk in places that they were not trained on.

    python -m studies across > docs/across.md

For each scene, one network is trained on the others, and is scored on the held-out blocks of this
scene. So is the guided walker with the parameters that were found on the others, which are in the
scene's `guided-walker.json`. Beside them stand the policies that were trained there, and social
forces. Files of an earlier call of the same command and code are kept.
"""

import contextlib
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

from crowdbench import Scene, load_scene, registry
from crowdbench.baselines.packages import needs
from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError
from crowdbench.evaluation import evaluate
from crowdbench.policies.guided import ELSEWHERE, GuidedWalker, parameters_of
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
OTHERS = ("anticipate", "guided-walker", "social-force")
"""Policies for comparison: those trained on the scene, and social forces."""
GUIDED = "studies.across:GuidedElsewhere"

INTRODUCTION = """# Walking in other places

For each scene, the network `anticipate` is trained on the others, and so are the parameters of
`guided-walker` searched on the others: *elsewhere*. They are compared with those that were trained
on the scene itself, on the training blocks of each fold (*there*), and with social forces. All are
scored on the same held-out blocks under the recorded arrivals. The score is *walk*, the lesser of
motion and interaction; in brackets are 95 % intervals. The second table shows differences.
This page is the output of
"""


class GuidedElsewhere(GuidedWalker):
    """The guided walker with parameters that were found in other places."""

    name = "guided-walker-elsewhere"
    many_worlds: ClassVar[bool] = True

    def __init__(self, scene: Scene) -> None:
        super().__init__(parameters_of(scene, ELSEWHERE))


def files_of(command: Command) -> list[Path]:
    """The file that `write` writes."""
    return [command.path(SPLIT)]


def write(command: Command) -> None:
    """Train a policy and write its file, unless this command and code have written it."""
    if not command.has_written(SPLIT):
        use_one_thread()
        with contextlib.redirect_stdout(sys.stderr):
            learn(command, SPLIT, AnticipateSettings())


HEAD = (
    "scene", "anticipate, elsewhere", "guided-walker, elsewhere", "anticipate, there",
    "guided-walker, there", "social-force",
)  # fmt: skip
DIFFERENCES = (
    "scene", "anticipate: elsewhere − social-force", "guided-walker: elsewhere − social-force",
    "elsewhere: guided-walker − anticipate", "there: guided-walker − anticipate",
)  # fmt: skip


def lines_of(scene: str, found: Mapping[str, Row], elsewhere: str) -> tuple[list[str], list[str]]:
    """The rows of a scene in both tables; `elsewhere` is the network that was trained elsewhere."""
    network, guided, network_there, guided_there, forces = (
        found[name].walk for name in (elsewhere, GUIDED, *OTHERS)
    )
    scores = [interval(of) for of in (network, guided, network_there, guided_there, forces)]
    compared = (
        (network, forces), (guided, forces), (guided, network), (guided_there, network_there)
    )  # fmt: skip
    return [scene, *scores], [scene, *(difference(a, b) for a, b in compared)]


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
        for name in OTHERS:
            registry.policy(name, scene, SPLITS[1])
    tasks = [(command,) for command in commands]
    for done, _ in enumerate(call_each(write, tasks, workers, files=files_of), 1):
        print(f"{done} of {len(tasks)} policies trained", file=sys.stderr)
    lines, differences = [], []
    for scene, command in zip(scenes, commands, strict=False):
        elsewhere = str(command.path(SPLIT))
        card = evaluate(
            scene,
            spawn="replay",
            policy=[elsewhere, GUIDED, *OTHERS],
            protocol="heldout",
            workers=workers,
            out=out / "evaluation" / command.out.name,
            report=False,
        )
        found = {row.policy: row for row in rows(card) if row.kind == "entry"}
        scores, compared = lines_of(scene, found, elsewhere)
        lines.append(scores)
        differences.append(compared)
    asked = [] if tuple(scenes) == SCENES else scenes
    call = f"    {shlex.join(['python', '-m', 'studies', 'across', *asked])}"
    tables = [table(list(HEAD), lines), table(list(DIFFERENCES), differences)]
    return "\n".join([INTRODUCTION, f"{call}\n", *tables])
