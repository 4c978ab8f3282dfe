"""`read_submission`: check an untrusted folder, so that it can be verified."""

import re
import unicodedata
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from crowdbench.files import sha256
from crowdbench.leaderboard.sandbox.parent import Limits, call
from crowdbench.leaderboard.submission.errors import Problems, SubmissionError
from crowdbench.leaderboard.submission.layout import NETWORK, Layout, files_in, lay_out
from crowdbench.leaderboard.submission.models import check_models, shipped_class, shipped_files
from crowdbench.leaderboard.submission.parse import read_declared
from crowdbench.leaderboard.submission.schema import FILE, Declared
from crowdbench.leaderboard.submission.trajectories import check_crowds
from crowdbench.leaderboard.verification.entry import Status

LIMITS = Limits(memory_bytes=6 * 2**30, wall_s=600.0, cpu_s=600)
"""Limits of a check. Reading thirty rollouts of Grand Central takes a minute."""
RESERVED = ("replay", "block-replay", "random", "straight", "poisson-gmm", "poisson-gmm-straight")
"""Ids of the references. Only they may have them."""
_LONGEST_ID = 60
_COPYING_MODELS = ("replay", "block-replay")
_UNFITTED_POLICIES = ("replay", "random")


@dataclass(frozen=True)
class Submission:
    """A valid submission."""

    folder: str
    declared: Declared
    layout: Layout
    artefacts: dict[str, str]
    """SHA-256 of each file, including `submission.toml`, by its path in the submission; and of each
    file of the shipped models that it names, by its path in crowdbench."""

    @property
    def id(self) -> str:
        """Id made from its name: a-z, 0-9 and single hyphens, at most 60 characters."""
        return slug(self.declared.name)

    @property
    def status(self) -> Status:
        """Whether it is ranked, listed, or an unranked reference."""
        return self.judged[0]

    @property
    def judged(self) -> tuple[Status, str]:
        """Its status, and the reason for it as a clause."""
        declared = self.declared
        if self.layout.crowds:
            return "listed", "trajectories may be copied from the public recording"
        if declared.training.protocol == "full":
            return "listed", "it was trained on the recordings that it is scored on"
        spawn, policy = declared.shipped_spawn, declared.shipped_policy
        of_anchor = {
            "walk": policy == "straight",
            "spawn": spawn == "poisson-gmm",
            "crowd": (spawn, policy) == ("poisson-gmm", "straight"),
        }[declared.track]
        if of_anchor or spawn in _COPYING_MODELS or policy in _UNFITTED_POLICIES:
            return "reference", "it is an unranked reference for comparison"
        return "ranked", "crowdbench runs the rollouts and scores them on held-out data"

    @property
    def protocol(self) -> Literal["full", "heldout"]:
        """How it is scored: on the whole recording if listed, else on held-out time blocks."""
        return "full" if self.status == "listed" else "heldout"

    def policy_of(self, scene: str) -> str:
        """The policy on a scene, as an argument of `registry.policy`."""
        if self.declared.track == "spawn":
            return "straight"
        if self.declared.shipped_policy:
            return shipped_class(self.declared.shipped_policy)
        one = self.layout.networks == [NETWORK]
        return str(Path(self.folder, NETWORK if one else f"{scene}/policy"))

    def spawn_of(self, scene: str) -> str:
        """The spawn model on a scene, as an argument of `registry.spawn_model`."""
        if self.declared.track == "walk":
            return "replay"
        return self.declared.shipped_spawn or str(Path(self.folder, scene, "spawn"))

    def trajectories_of(self, scene: str) -> list[Path]:
        """Paths of the rollouts submitted for a scene; empty if models were submitted."""
        return [Path(self.folder, name) for name in self.layout.crowds.get(scene, [])]


def check(folder: Path, limits: Limits = LIMITS) -> Submission:
    """Read an untrusted folder in a sandbox: a network may run forever or use all memory.

    Raises:
        SubmissionError: the submission is invalid; the error lists all its problems.
        SandboxError: the check crashed or exceeded a limit.
    """
    target = f"{__name__}:read_submission"
    asked: dict[str, object] = {"path": f"{folder}"}
    return call(target, asked, Submission, where=folder, limits=limits, reads=[folder])[0]


def read_submission(path: Path | str) -> Submission:
    """Read and check a submission's folder.

    This runs the networks on some observations. `check` does it in a sandbox.

    Raises:
        SubmissionError: the submission is invalid; the error lists all its problems.
    """
    folder, problems, layout, declared = Path(path), Problems(), Layout(), None
    try:
        names = _names_of(folder, problems)
        if not problems:
            declared = read_declared(folder / FILE, problems)
        if declared is not None:
            layout = lay_out(declared, names, problems)
            check_models(folder, declared, layout, problems)
            check_crowds(folder, declared.track, layout.crowds, problems)
            if not problems:
                files = {name: folder / name for name in names} | shipped_files(declared)
                hashes = {name: sha256(file.read_bytes()) for name, file in files.items()}
                found = Submission(f"{folder}", declared, layout, hashes)
                if found.id not in RESERVED or found.status == "reference":
                    return found
                problems.refuse(
                    f"{FILE}, name",
                    got=f"{declared.name!r}, the name of a reference",
                    expected="a name of its own",
                    hint="Choose another name.",
                )
    except OSError as error:
        problems = Problems()
        got = f"{error.filename}: {error.strerror}"
        problems.refuse(f"{folder}", got=got, expected="readable files")
    raise SubmissionError(folder, problems)


def _names_of(folder: Path, problems: Problems) -> list[str]:
    """The files of a submission, which must have a declaration at the top."""
    if not folder.is_dir():
        there = folder.exists()
        got = "a file" if there else "no such folder"
        hint = "Unpack it, and name the folder." if there else ""
        problems.refuse(folder.name, got=got, expected="a submission's folder", hint=hint)
        return []
    names = files_in(folder, problems)
    if not problems and FILE not in names:
        inside = [name for name in names if name.endswith(f"/{FILE}")]
        got = f"only {inside[0]}" if inside else "no such file"
        expected = "the file at the top level, next to the scene folders"
        hint = "Name that folder instead." if inside else "Create it with `crowdbench submit init`."
        problems.refuse(FILE, got=got, expected=expected, hint=hint)
    return names


def slug(name: str) -> str:
    """The id for a name, for files and URLs: a-z, 0-9 and single hyphens, at most 60 characters."""
    letters = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    plain = re.sub(r"[^a-z0-9]+", "-", letters)[:_LONGEST_ID].strip("-")
    return plain or f"submission-{sha256(name.encode())[:8]}"
