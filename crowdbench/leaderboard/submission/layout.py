"""Which files a submission must hold, by what it declares, and which it must not."""

import os
import re
import stat
from dataclasses import dataclass, field
from pathlib import Path

from crowdbench.errors import CrowdbenchError
from crowdbench.leaderboard.submission.archive import wrong_name
from crowdbench.leaderboard.submission.errors import RefusedError
from crowdbench.leaderboard.submission.limits import LARGEST_SUBMISSION, MOST_FILES, MOST_ROLLOUTS
from crowdbench.leaderboard.submission.schema import FILE, Declared
from crowdbench.registry import WEIGHTS
from crowdbench.trajectories.blocks import PARTS

NOTES = "README.md"
"""May lie in a submission's folder, and is neither read nor packed."""
NETWORK = "policy.onnx"
"""A network that knows none of the scenes."""
_CROWD = re.compile(r"([^/]+)/trajectories/(0|[1-9][0-9]?)\.(parquet|csv)")


@dataclass
class Layout:
    """A submission's files by what they are, paths from its folder on."""

    networks: list[str] = field(default_factory=list)
    weights: dict[str, str] = field(default_factory=dict)
    """By scene."""
    crowds: dict[str, list[str]] = field(default_factory=dict)
    """By scene, in the order of their numbers."""


def files_in(folder: Path, problems: list[CrowdbenchError]) -> list[str]:
    """Paths of the regular files in a submission's folder; what else is there is a problem."""
    found: list[str] = []
    seen = size = 0
    folders = [folder]
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                path = Path(entry.path)
                name = path.relative_to(folder).as_posix()
                status = path.lstat()
                seen, size = seen + 1, size + status.st_size
                if seen > MOST_FILES or size > LARGEST_SUBMISSION:
                    problems.append(_too_much(folder))
                    return []
                if refused := wrong_name(os.fsencode(name).decode("ascii", "replace")):
                    problems.append(refused)
                elif stat.S_ISDIR(status.st_mode):
                    folders.append(path)
                elif not stat.S_ISREG(status.st_mode):
                    problems.append(
                        RefusedError(
                            name, got="a link or a device", expected="files", hint="Remove it."
                        )
                    )
                elif name != NOTES:
                    found.append(name)
    return sorted(found)


def _too_much(folder: Path) -> RefusedError:
    return RefusedError(
        folder.name,
        got=f"more than {MOST_FILES} files and folders, or {LARGEST_SUBMISSION / 1e6:.0f} MB",
        expected="less",
        hint="Is this the folder of the submission alone?",
    )


def lay_out(declared: Declared, names: list[str], problems: list[CrowdbenchError]) -> Layout:
    """Give each file its role; those that are missing or have none are added to `problems`."""
    layout = Layout()
    found = set(names) - {FILE}
    needs_policy = declared.track != "spawn" and not declared.shipped_policy
    needs_spawn = declared.track != "walk" and not declared.shipped_spawn
    if any("/trajectories/" in name for name in found):
        layout.crowds = _crowds(declared, found, problems)
    else:
        if needs_policy:
            layout.networks = _networks(declared, found, problems)
        if needs_spawn:
            layout.weights = _weights(declared, found, problems)
    used = {*layout.networks, *layout.weights.values()}.union(*layout.crowds.values())
    if surplus := sorted(found - used):
        problems.append(
            RefusedError(
                ", ".join(surplus),
                got="a file that has no place here"
                if len(surplus) == 1
                else "files that have no place here",
                expected=_places(declared, layout, needs_policy, needs_spawn),
                hint=f"Remove or rename what is surplus, or correct {FILE}.",
            )
        )
    return layout


def _places(declared: Declared, layout: Layout, policy: bool, spawn: bool) -> str:
    """Where files may lie, in words."""
    of_scene, alone = [], ""
    if layout.crowds:
        of_scene = ["trajectories/0.parquet or .csv, …"]
    else:
        if policy and layout.networks == [NETWORK]:
            alone = f"{NETWORK} in place of networks for each scene; "
        elif policy:
            of_scene.append("policy/" + ", ".join(f"{part}.onnx" for part in parts_of(declared)))
        if spawn:
            of_scene.append(f"one of spawn/{', '.join(WEIGHTS)}")
    if of_scene:
        folders = ", ".join(declared.scenes)
        return f"{alone}in a folder for each of {folders}: {'; '.join(of_scene)}"
    return alone.rstrip("; ") or f"{FILE} alone, since it names what comes with crowdbench"


def parts_of(declared: Declared) -> tuple[str, ...]:
    """The parts of a recording for which a submission holds a network each."""
    return PARTS[:1] if declared.training.protocol == "full" else PARTS[1:]


def _networks(declared: Declared, found: set[str], problems: list[CrowdbenchError]) -> list[str]:
    if NETWORK in found:
        return [NETWORK]
    names: list[str] = []
    for scene in declared.scenes:
        of_scene = {f"{scene}/policy/{part}.onnx" for part in parts_of(declared)}
        if lacking := sorted(of_scene - found):
            problems.append(
                RefusedError(
                    f"{scene}/policy",
                    got=f"no {', '.join(Path(name).name for name in lacking)}",
                    expected=f"{', '.join(f'{part}.onnx' for part in parts_of(declared))}, as "
                    f"training.protocol {declared.training.protocol} has it",
                    hint="Write it with `crowdbench policy export`, or name a policy that comes "
                    "with crowdbench as shipped_policy.",
                )
            )
        names += sorted(of_scene & found)
    return names


def _weights(
    declared: Declared, found: set[str], problems: list[CrowdbenchError]
) -> dict[str, str]:
    weights = {}
    for scene in declared.scenes:
        names = [f"{scene}/spawn/{file}" for file in WEIGHTS]
        there = [name for name in names if name in found]
        if len(there) == 1:
            weights[scene] = there[0]
        elif there:
            problems.append(
                RefusedError(
                    f"{scene}/spawn",
                    got=", ".join(Path(name).name for name in there),
                    expected="one of them",
                    hint="A submission has one spawn model.",
                )
            )
            found -= set(there)
        else:
            problems.append(
                RefusedError(
                    f"{scene}/spawn",
                    got="no fits",
                    expected=f"one of {', '.join(WEIGHTS)}",
                    hint=f"Write it with `crowdbench fit {scene} --out FOLDER`, or name a spawn "
                    "model that comes with crowdbench as shipped_spawn.",
                )
            )
    return weights


def _crowds(
    declared: Declared, found: set[str], problems: list[CrowdbenchError]
) -> dict[str, list[str]]:
    """The rollouts of each scene, numbered from 0; on track walk one may be enough."""
    least = 1 if declared.track == "walk" else 2
    crowds: dict[str, list[str]] = {}
    for scene in declared.scenes:
        matches = [m for name in found if (m := _CROWD.fullmatch(name)) and m[1] == scene]
        crowds[scene] = [m[0] for m in sorted(matches, key=lambda m: int(m[2]))]
        numbers = sorted(int(m[2]) for m in matches)
        if not least <= len(numbers) <= MOST_ROLLOUTS or numbers != list(range(len(numbers))):
            problems.append(
                RefusedError(
                    f"{scene}/trajectories",
                    got="files " + ", ".join(map(str, numbers)) if numbers else "no files",
                    expected=f"{least} to {MOST_ROLLOUTS} rollouts, a file each, numbered 0, 1, …",
                    hint="A score needs several rollouts." if len(numbers) < least else "",
                )
            )
    for name in ("shipped_policy", "shipped_spawn"):
        if getattr(declared, name):
            problems.append(
                RefusedError(
                    f"{FILE}, {name}",
                    got="trajectories besides",
                    expected="either trajectories or models",
                    hint="Remove the one or the other.",
                )
            )
    return crowds
