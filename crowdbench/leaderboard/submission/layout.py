"""Which files a submission must and may contain, given what it declares."""

import os
import re
import stat
from dataclasses import dataclass, field
from pathlib import Path

from crowdbench.data.blocks import SPLITS
from crowdbench.leaderboard.submission import limits
from crowdbench.leaderboard.submission.errors import Problems, RefusedError
from crowdbench.leaderboard.submission.schema import FILE, Declared
from crowdbench.registry import WEIGHTS

NOTES = "README.md"
"""Allowed in a submission's folder, but not read."""
NETWORK = "policy.onnx"
"""One network for all scenes, trained on none of their recordings."""
_NAME = re.compile(r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*(/[A-Za-z0-9_+-][A-Za-z0-9._+-]*)*/?")
_CROWD = re.compile(r"([^/]+)/trajectories/(0|[1-9][0-9]?)\.(parquet|csv)")


@dataclass
class Layout:
    """A submission's files by role; paths are relative to its folder."""

    networks: list[str] = field(default_factory=list)
    weights: dict[str, str] = field(default_factory=dict)
    """The spawn model's file, by scene."""
    crowds: dict[str, list[str]] = field(default_factory=dict)
    """The trajectory files in the order of their numbers, by scene."""


def files_in(folder: Path, problems: Problems) -> list[str]:
    """Relative paths of a folder's regular files; anything else is added to `problems`."""
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
                if seen > limits.MOST_FILES or size > limits.LARGEST_SUBMISSION:
                    problems.refuse(
                        folder.name,
                        got=f"more than {limits.MOST_FILES} files and folders, or "
                        f"{limits.LARGEST_SUBMISSION / 1e6:.0f} MB",
                        expected="fewer or smaller files",
                        hint="Does the folder contain only the submission?",
                    )
                    return []
                if refused := wrong_name(os.fsencode(name).decode("ascii", "replace")):
                    problems.append(refused)
                elif stat.S_ISDIR(status.st_mode):
                    folders.append(path)
                elif not stat.S_ISREG(status.st_mode):
                    got, expected = "a link or a device", "a regular file"
                    problems.refuse(name, got=got, expected=expected, hint="Remove it.")
                elif name != NOTES:
                    found.append(name)
    return sorted(found)


def lay_out(declared: Declared, names: list[str], problems: Problems) -> Layout:
    """Assign each file its role; missing and unexpected files are added to `problems`."""
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
        got = "an unexpected file" if len(surplus) == 1 else "unexpected files"
        expected = _places(declared, layout, needs_policy, needs_spawn)
        hint = f"Remove or rename unexpected files, or correct {FILE}."
        problems.refuse(", ".join(surplus), got=got, expected=expected, hint=hint)
    return layout


def _places(declared: Declared, layout: Layout, policy: bool, spawn: bool) -> str:
    """The files that a submission may contain, in words."""
    of_scene, alone = [], ""
    if layout.crowds:
        of_scene = ["trajectories/0.parquet or .csv, …"]
    else:
        if policy and layout.networks == [NETWORK]:
            alone = f"{NETWORK} instead of networks for each scene; "
        elif policy:
            of_scene.append("policy/" + ", ".join(f"{split}.onnx" for split in splits_of(declared)))
        if spawn:
            of_scene.append(f"one of {', '.join(WEIGHTS)} in spawn/")
    if of_scene:
        folders = ", ".join(declared.scenes)
        return f"{alone}in the folder of each scene ({folders}): {'; '.join(of_scene)}"
    return alone.rstrip("; ") or f"only {FILE}, since its models come with crowdbench"


def splits_of(declared: Declared) -> tuple[str, ...]:
    """The splits of a recording for which a submission contains one network each."""
    return SPLITS[:1] if declared.training.protocol == "full" else SPLITS[1:]


def _networks(declared: Declared, found: set[str], problems: Problems) -> list[str]:
    if NETWORK in found:
        return [NETWORK]
    files = [f"{split}.onnx" for split in splits_of(declared)]
    names: list[str] = []
    for scene in declared.scenes:
        folder = f"{scene}/policy"
        if lacking := [file for file in files if f"{folder}/{file}" not in found]:
            problems.refuse(
                folder,
                got=f"no {', '.join(lacking)}",
                expected=f"{', '.join(files)} for training.protocol {declared.training.protocol}",
                hint="Create the file with `crowdbench policy export`, or set shipped_policy "
                "to a policy that comes with crowdbench.",
            )
        names += [f"{folder}/{file}" for file in files if file not in lacking]
    return names


def _weights(declared: Declared, found: set[str], problems: Problems) -> dict[str, str]:
    weights = {}
    for scene in declared.scenes:
        folder, known = f"{scene}/spawn", ", ".join(WEIGHTS)
        there = [file for file in WEIGHTS if f"{folder}/{file}" in found]
        if len(there) == 1:
            weights[scene] = f"{folder}/{there[0]}"
        elif there:
            hint = "A submission has one spawn model."
            problems.refuse(folder, got=", ".join(there), expected="one of them", hint=hint)
            found -= {f"{folder}/{file}" for file in there}
        else:
            hint = (
                f"Create the file with `crowdbench scene fit {scene} --out FOLDER`, or set "
                "shipped_spawn to a spawn model that comes with crowdbench."
            )
            problems.refuse(folder, got="no fits", expected=f"one of {known}", hint=hint)
    return weights


def _crowds(declared: Declared, found: set[str], problems: Problems) -> dict[str, list[str]]:
    """The trajectory files of each scene, numbered from 0; track walk needs only one."""
    least = 1 if declared.track == "walk" else 2
    crowds: dict[str, list[str]] = {}
    for scene in declared.scenes:
        matches = [m for name in found if (m := _CROWD.fullmatch(name)) and m[1] == scene]
        matches.sort(key=lambda m: int(m[2]))
        crowds[scene] = [m[0] for m in matches]
        numbers = [int(m[2]) for m in matches]
        if not least <= len(numbers) <= limits.MOST_ROLLOUTS or numbers != list(
            range(len(numbers))
        ):
            got = "files " + ", ".join(map(str, numbers)) if numbers else "no files"
            expected = f"{least} to {limits.MOST_ROLLOUTS} rollouts, one per file, numbered 0, 1, …"
            hint = "A score needs at least two rollouts." if len(numbers) < least else ""
            problems.refuse(f"{scene}/trajectories", got=got, expected=expected, hint=hint)
    for name in ("shipped_policy", "shipped_spawn"):
        if getattr(declared, name):
            got = "a model together with trajectories"
            expected = "either trajectories or models"
            hint = "Remove one of them."
            problems.refuse(f"{FILE}, {name}", got=got, expected=expected, hint=hint)
    return crowds


def wrong_name(name: str) -> RefusedError | None:
    """The problem with a file's path in a submission; None if it is valid."""
    problems = (
        (name.startswith("/"), "an absolute path"),
        ("\\" in name, "a backslash in a path"),
        (re.match(r"[A-Za-z]:", name), "a drive letter in a path"),
        (".." in name.split("/"), "a path that leads out of the folder"),
        (len(name) > limits.LONGEST_PATH, f"a path of {len(name)} characters"),
        (not _NAME.fullmatch(name), "a hidden path or invalid characters"),
    )
    for wrong, got in problems:
        if wrong:
            return RefusedError(
                ascii(name[: limits.LONGEST_PATH]),
                got=got,
                expected=f"up to {limits.LONGEST_PATH} letters, digits and ._+-, with / between "
                "folders",
                hint="Remove or rename the file.",
            )
    return None
