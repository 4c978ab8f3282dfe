"""Scoring entries anew: what an earlier scorer found is kept, with the reason."""

from collections.abc import Callable
from pathlib import Path

import msgspec

from crowdbench.errors import SettingError
from crowdbench.files import write_json
from crowdbench.leaderboard.pages.standings import View, scores
from crowdbench.leaderboard.sandbox.parent import Limits
from crowdbench.leaderboard.verification.check import check
from crowdbench.leaderboard.verification.entry import SCORER, Earlier, Entry, read_entry
from crowdbench.leaderboard.verification.verify import DEFAULT, entry_of, write_run


def entry_ids(root: Path) -> list[str]:
    """Ids of the entries of a leaderboard."""
    stems = {path.stem for path in (root / "entries").glob("*.json")}
    return sorted(stem for stem in stems if "." not in stem)  # ID.run.json may lie beside


def rescore(
    entry_id: str,
    root: Path,
    *,
    reason: str,
    out: Path,
    workers: int | None = None,
    limits: Limits = DEFAULT,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Entry:
    """Verify the submission of an entry anew; what it had before goes to the entry's `history`.

    `root` holds `entries/ID.json`, which is replaced, and `submissions/ID/`. Rollouts and
    `ID.run.json` go to `out`.

    Raises:
        SettingError: there is no such entry or no reason, the submission bears another name, or
            neither scorer nor artefacts have changed.
        CrowdbenchError: as `verify` does.
    """
    if not reason.strip() or not reason.isprintable():
        raise SettingError(
            "reason", got=repr(reason), expected="a line that says why it is scored anew"
        )
    if entry_id not in entry_ids(root):
        known = ", ".join(entry_ids(root)) or "none yet"
        raise SettingError("entry", got=repr(entry_id), expected=f"one of {root}/entries ({known})")
    path = root / "entries" / f"{entry_id}.json"
    old = read_entry(path)
    submission = root / "submissions" / entry_id
    _check_changed(old, submission)
    new, ran = entry_of(submission, out / "work", workers, limits, progress)
    if new.id != entry_id:
        raise SettingError(
            submission, got=f"a submission whose id is {new.id}", expected=f"the entry {entry_id}"
        )
    values = {view: score.value for view, score in scores(old).items()}
    earlier = Earlier(
        scorer=old.scorer,
        crowdbench=old.crowdbench,
        overall=values.get(View()),
        scenes={name: values.get(View(scene=name)) for name in old.scenes},
        reason=reason.strip(),
    )
    entry = msgspec.structs.replace(new, history=[*old.history, earlier])
    write_json(path, entry)
    write_run(out / f"{entry_id}.run.json", ran)
    return entry


def _check_changed(old: Entry, submission: Path) -> None:
    if old.scorer != SCORER:
        return
    if check(submission).artefacts == old.artefacts:
        raise SettingError(
            f"entry {old.id}",
            got=f"the scorer {SCORER} and the files that it was scored with",
            expected="a newer scorer, or a submission that changed",
            hint="The scores would be the same.",
        )
