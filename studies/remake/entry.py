"""`python -m studies.remake.entry ID`: verify a submission, and replace all but its history."""

import sys
from pathlib import Path

import msgspec

from crowdbench.cli.printing import progress_bar
from crowdbench.files import write_json
from crowdbench.leaderboard.sandbox.parent import Limits
from crowdbench.leaderboard.verification.entry import entry_path, read_entry
from crowdbench.leaderboard.verification.verify import entry_of, write_run

ROOT, OUT = Path("leaderboard"), Path("results/leaderboard")


def main(entry_id: str) -> None:
    """Verify the submission of an entry, and write the entry."""
    path = entry_path(ROOT / "entries", entry_id)
    history = read_entry(path).history if path.exists() else []
    submission = ROOT / "submissions" / entry_id
    with progress_bar(entry_id):
        entry, ran = entry_of(submission, OUT / "work", None, Limits())
    write_json(path, msgspec.structs.replace(entry, history=history))
    write_run(OUT / f"{entry_id}.run.json", ran)


if __name__ == "__main__":
    main(sys.argv[1])
