"""`python -m studies.remake.entry ID`: score a submission, and replace all but its history.

Submissions in the repository are trusted: their rollouts go into the store, where pages find them.
"""

import sys
from pathlib import Path

import msgspec

from crowdbench.cli.printing import progress_bar
from crowdbench.files import write_json
from crowdbench.leaderboard.verification.entry import entry_path, read_entry
from crowdbench.leaderboard.verification.make_entry import make_entry

ROOT, WORK = Path("leaderboard"), Path("results/leaderboard/work")


def main(entry_id: str) -> None:
    """Score the submission of an entry, and write the entry."""
    path = entry_path(ROOT / "entries", entry_id)
    history = read_entry(path).history if path.exists() else []
    with progress_bar(entry_id):
        entry = make_entry(str(ROOT / "submissions" / entry_id), str(WORK), None, examine=True)
    write_json(path, msgspec.structs.replace(entry, history=history))


if __name__ == "__main__":
    main(sys.argv[1])
