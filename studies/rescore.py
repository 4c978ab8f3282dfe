"""`python -m studies rescore`: score entries again; earlier scores are kept, with the reason."""

from pathlib import Path

import msgspec

from crowdbench.errors import SettingError
from crowdbench.files import write_json
from crowdbench.leaderboard.sandbox.parent import Limits
from crowdbench.leaderboard.scores import View, scores
from crowdbench.leaderboard.submission.submission import check
from crowdbench.leaderboard.verification.entry import SCORER, Earlier, Entry, find_entry, read_entry
from crowdbench.leaderboard.verification.verify import DEFAULT, entry_of, write_run


def rescore(
    entry_id: str,
    root: Path,
    *,
    reason: str,
    out: Path,
    workers: int | None = None,
    limits: Limits = DEFAULT,
) -> Entry:
    """Verify the submission of an entry again, and move its earlier scores to its `history`.

    `root` contains `entries/ID.json.gz`, which is replaced, and `submissions/ID/`. Rollouts and
    `ID.run.json` are written to `out`.

    Raises:
        SettingError: the entry or the reason is missing, the submission has another id, or neither
            scorer nor artefacts have changed.
        CrowdbenchError: any error of `verify`.
    """
    if not reason.strip() or not reason.isprintable():
        raise SettingError(
            "reason", got=repr(reason), expected="one line that says why it is scored again"
        )
    path = find_entry(entry_id, root / "entries")
    old = read_entry(path)
    submission = root / "submissions" / entry_id
    same = check(submission).artefacts == old.artefacts
    if old.scorer == SCORER and same:
        raise SettingError(
            f"entry {old.id}",
            got=f"scorer {SCORER} and files that it has already scored",
            expected="a newer scorer or a changed submission",
            hint="The scores would be the same.",
        )
    examined = old.exam is not None
    key = old.key if same else ""  # who changes networks may know the old one
    new, ran = entry_of(submission, out / "work", workers, limits, exam=examined, key=key)
    if new.id != entry_id:
        raise SettingError(
            submission, got=f"a submission with the id {new.id}", expected=f"the id {entry_id}"
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
