"""How `anticipate` walks in places that it was not trained on.

    python -m crowdbench.baselines.across > across.md

For each scene, one network is trained on the others, and is scored on the held-out blocks of this
scene beside the policies that were trained there and beside social forces. Files of an earlier call
of the same command and code are kept.
"""

import argparse
import contextlib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from crowdbench import load_scene, registry
from crowdbench.cli.workers import add_engine
from crowdbench.data.blocks import SPLITS
from crowdbench.errors import CrowdbenchError, SettingError
from crowdbench.report.text.markdown import table
from crowdbench.report.text.words import interval
from crowdbench.run.evaluate import evaluate  # without its report
from crowdbench.run.parallel import call_each, checked_workers, engine
from crowdbench.scoring.scorecard import Row, rows

from .packages import needs

with needs("fit", __name__):
    from .ablation import difference
    from .anticipate import Settings, learn
    from .command import Command, use_one_thread

SCENES = ("eth-v0", "hotel-v0", "zara1-v0", "gc-v0", "forum-v0")
SPLIT = "full"
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
            learn(command, SPLIT, Settings())


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


def command_line() -> argparse.ArgumentParser:
    """Argument parser of this script."""
    parser = argparse.ArgumentParser(
        prog="python -m crowdbench.baselines.across",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--scenes", nargs="+", default=SCENES, metavar="SCENE", help="scenes with one maximum speed"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("results/across"), metavar="DIR", help="output folder"
    )
    add_engine(parser)
    return parser


def commands_of(scenes: Sequence[str], out: Path) -> list[Command]:
    """The trainings without each scene, and the one with all."""
    if len(set(scenes)) < len(scenes):
        raise SettingError("--scenes", got=" ".join(scenes), expected="each scene once")
    if len(scenes) < 3:
        raise SettingError(
            "--scenes",
            got=" ".join(scenes),
            expected="three or more: two to train on, and one that is left out",
        )
    found = []
    for left_out in (*scenes, None):
        given = ["--scenes", *scenes] + ([] if left_out is None else ["--leave-out", left_out])
        folder = out / (f"without-{left_out}" if left_out else registry.ANY_PLACE)
        found.append(Command.of_several("anticipate", scenes, left_out, [SPLIT], folder, given))
    return found


def page(asked: argparse.Namespace, given: list[str]) -> str:
    """Train and score all policies; return the page."""
    workers = checked_workers(asked.workers)
    commands = commands_of(asked.scenes, asked.out)
    for scene in asked.scenes:  # what is missing is said before the trainings
        registry.recording_of(load_scene(scene))
        registry.policy(OTHERS[0], scene, SPLITS[1])
    tasks = [(command,) for command in commands]
    for done, _ in enumerate(call_each(write, tasks, workers, files=files_of), 1):
        print(f"{done} of {len(tasks)} policies trained", file=sys.stderr)
    lines = []
    for scene, command in zip(asked.scenes, commands, strict=False):
        elsewhere = str(command.path(SPLIT))
        card = evaluate(
            scene,
            spawn="replay",
            policy=[elsewhere, *OTHERS],
            protocol="heldout",
            workers=workers,
            out=asked.out / "evaluation" / command.out.name,
        )
        found = {row.policy: row for row in rows(card) if row.kind == "entry"}
        lines.append(line(scene, found, elsewhere))
    call = f"    python -m crowdbench.baselines.across {' '.join(given)}".rstrip()
    return "\n".join([INTRODUCTION, f"{call}\n", table(list(HEAD), lines)])


def main(arguments: list[str] | None = None) -> int:
    """Train and score all policies and print the page; return the exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    asked = command_line().parse_args(given)
    try:
        with engine(asked.engine):
            print(page(asked, given))
    except CrowdbenchError as error:
        print(f"crowdbench.baselines.across: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    # Worker processes find functions in modules that they can import, which `__main__` is not.
    from .across import main as imported_main

    sys.exit(imported_main())
