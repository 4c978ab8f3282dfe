"""`python -m studies.remake.entry ID`: score a submission, and replace all but its history.

Submissions in the repository are trusted: their rollouts go into the store, where pages find them.
Scenes on which nothing has changed since `results.lock` was written keep their results.
"""

import secrets
import sys
from collections.abc import Iterable
from pathlib import Path

import msgspec

from crowdbench.cli.printing import progress_bar
from crowdbench.files import write_json
from crowdbench.leaderboard.verification.entry import (
    Entry,
    Flag,
    SceneEntry,
    entry_path,
    read_entry,
)
from crowdbench.leaderboard.verification.flags import flags_of
from crowdbench.leaderboard.verification.make_entry import make_entry
from crowdbench.scene import load_scene
from studies.remake.declared import LIMITS, scenes_and_entries
from studies.remake.graph import Result
from studies.remake.lock import LOCK, Line, read_lock

ROOT, WORK = Path("leaderboard"), Path("results/leaderboard/work")


def main(entry_id: str) -> None:
    """Score the submission of an entry, and write the entry."""
    path, name = entry_path(ROOT / "entries", entry_id), f"entries/{entry_id}"
    old = read_entry(path) if path.exists() else None
    declared = next(result for result in scenes_and_entries() if result.name == name)
    unchanged = unchanged_scenes(declared, read_lock(LOCK).get(name), old.scenes if old else ())
    known = {scene: known_scene(old, scene) for scene in unchanged} if old else {}
    with progress_bar(entry_id):
        submission = str(ROOT / "submissions" / entry_id)
        key = (old.key if old else "") or secrets.token_hex(16)
        entry = make_entry(submission, str(WORK), None, examine=True, known=known, key=key)
    write_json(path, msgspec.structs.replace(entry, history=old.history if old else []))


def unchanged_scenes(declared: Result, line: Line | None, scenes: Iterable[str]) -> list[str]:
    """The scenes of an entry on which only its limit of copied trips may have changed.

    A changed input belongs to the scene that its name contains, and otherwise to all.
    """
    if line is None or declared.made() != line.outputs:
        return []
    now, then = declared.inputs(), line.inputs
    changed = {name for name in now | then if now.get(name) != then.get(name)} - {LIMITS}
    names = {s: (s, f"recording {load_scene(s).recording.name}") for s in scenes}
    touched = {s: {n for n in changed if scene in n or n == of} for s, (scene, of) in names.items()}
    if changed - set().union(*touched.values()):
        return []
    return [scene for scene, inputs in touched.items() if not inputs]


def known_scene(entry: Entry, scene: str) -> tuple[SceneEntry, list[Flag]]:
    """The result of an entry on a scene, with the flags by today's limit of copied trips."""
    known = entry.scenes[scene]
    of_scores = [f for f in entry.flags if f.scene == scene and f.what in ("too good", "too even")]
    return known, of_scores + flags_of(scene, None, None, known.copy)


if __name__ == "__main__":
    main(sys.argv[1])
