"""`open_submission`: check an untrusted folder, so that it can be verified."""

import re
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from crowdbench.errors import CrowdbenchError
from crowdbench.files import sha256
from crowdbench.leaderboard.submission.errors import RefusedError, SubmissionError
from crowdbench.leaderboard.submission.layout import NETWORK, Layout, files_in, lay_out
from crowdbench.leaderboard.submission.models import check_models, shipped_class, shipped_files
from crowdbench.leaderboard.submission.parse import read_declared
from crowdbench.leaderboard.submission.schema import FILE, Declared
from crowdbench.leaderboard.submission.trajectories import check_crowds
from crowdbench.leaderboard.verification.entry import Status

_LONGEST_ID = 60
_LINES_OF_SPAWN = ("replay", "block-replay")
_LINES_OF_POLICY = ("replay", "random")


@dataclass(frozen=True)
class Submission:
    """A valid submission. Its paths exist only while it is open."""

    folder: Path
    declared: Declared
    layout: Layout
    artefacts: dict[str, str]
    """SHA-256 of each file, by its path in the submission; includes `submission.toml`."""
    shipped: dict[str, str]
    """SHA-256 of each file of the shipped models that it names, by its path in crowdbench."""

    @property
    def id(self) -> str:
        """Id made from its name: a-z, 0-9 and single hyphens, at most 60 characters."""
        return slug(self.declared.name)

    @property
    def status(self) -> Status:
        """Whether it is ranked, listed, or an unranked reference."""
        return self._judged()[0]

    @property
    def why(self) -> str:
        """The reason for its status, as a clause."""
        return self._judged()[1]

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
        return str(self.folder / NETWORK if one else self.folder / scene / "policy")

    def spawn_of(self, scene: str) -> str:
        """The spawn model on a scene, as an argument of `registry.spawn_model`."""
        if self.declared.track == "walk":
            return "replay"
        return self.declared.shipped_spawn or str(self.folder / scene / "spawn")

    def trajectories_of(self, scene: str) -> list[Path]:
        """Paths of the rollouts submitted for a scene; empty if models were submitted."""
        return [self.folder / name for name in self.layout.crowds.get(scene, [])]

    def _judged(self) -> tuple[Status, str]:
        declared = self.declared
        if self.layout.crowds:
            return "listed", "trajectories may be copied from the public recording"
        if declared.training.protocol == "full":
            return "listed", "it was trained on the recordings that it is scored on"
        spawn, policy = declared.shipped_spawn, declared.shipped_policy
        if {
            "walk": policy == "straight" or policy in _LINES_OF_POLICY,
            "spawn": spawn == "poisson-gmm" or spawn in _LINES_OF_SPAWN,
            "crowd": (spawn, policy) == ("poisson-gmm", "straight")
            or spawn in _LINES_OF_SPAWN
            or policy in _LINES_OF_POLICY,
        }[declared.track]:
            return "reference", "it is an unranked reference for comparison"
        return "ranked", "crowdbench runs the rollouts and scores them on held-out data"


@contextmanager
def open_submission(path: Path) -> Iterator[Submission]:
    """Open and check a submission's folder.

    This runs the networks on some observations. Open untrusted submissions in a sandbox, as
    `verification.check.check` does.

    Raises:
        SubmissionError: the submission is invalid; the error lists all its problems.
    """
    if not path.is_dir():
        there = path.exists()
        missing = RefusedError(
            path.name,
            got="a file" if there else "no such folder",
            expected="a submission's folder",
            hint="Unpack it, and name the folder." if there else "",
        )
        raise SubmissionError(path, [missing])
    yield _read(path)


def _read(folder: Path) -> Submission:
    try:
        return _checked(folder)
    except OSError as error:
        got = f"{error.filename}: {error.strerror}"
        unreadable = RefusedError(folder, got=got, expected="readable files")
        raise SubmissionError(folder, [unreadable]) from error


def _checked(folder: Path) -> Submission:
    problems: list[CrowdbenchError] = []
    names = files_in(folder, problems)
    if not problems and FILE not in names:
        problems.append(_no_declaration(names))
    declared = read_declared(folder / FILE, problems) if not problems else None
    layout = Layout()
    if declared is not None:
        layout = lay_out(declared, names, problems)
        check_models(folder, declared, layout, problems)
        check_crowds(folder, declared.track, layout.crowds, problems)
    if problems or declared is None:
        raise SubmissionError(folder, problems)
    hashes = {name: sha256((folder / name).read_bytes()) for name in names}
    shipped = {name: sha256(file.read_bytes()) for name, file in shipped_files(declared).items()}
    return Submission(folder, declared, layout, hashes, shipped)


def _no_declaration(names: list[str]) -> RefusedError:
    inside = [name for name in names if name.endswith(f"/{FILE}")]
    return RefusedError(
        FILE,
        got=f"only {inside[0]}" if inside else "no such file",
        expected="the file at the top level, next to the scene folders",
        hint="Name that folder instead." if inside else "Create it with `crowdbench submit init`.",
    )


def slug(name: str) -> str:
    """The id for a name, for files and URLs: a-z, 0-9 and single hyphens, at most 60 characters."""
    letters = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    plain = re.sub(r"[^a-z0-9]+", "-", letters)[:_LONGEST_ID].strip("-")
    return plain or f"submission-{sha256(name.encode())[:8]}"
