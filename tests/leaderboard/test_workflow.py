"""The workflow that verifies pull requests of submissions: strangers get nothing from it."""

import os
import re
import subprocess
import textwrap
from pathlib import Path

import pytest

WORKFLOW = Path(__file__).parents[2] / ".github" / "workflows" / "leaderboard.yml"


def test_the_workflow_may_read_and_nothing_else() -> None:
    text = WORKFLOW.read_text()
    said = re.sub(r"^ *#.*$", "", text, flags=re.M)
    assert re.findall(r"^(?:permissions:\n(?:  .*\n)+)", said, flags=re.M) == [
        "permissions:\n  contents: read\n"
    ]
    assert "pull_request_target" not in said
    assert "secrets" not in said
    assert said.count("persist-credentials: false") == said.count("actions/checkout@")
    # What strangers chose is never pasted into a script.
    for script in re.findall(r"run: \|\n((?: {10}.*\n|\n)+)", said):
        assert "${{" not in script


def step(name: str) -> str:
    """The script of a step of the workflow."""
    text = WORKFLOW.read_text()
    (script,) = re.findall(rf"- name: {name}\n +run: \|\n((?: {{10}}.*\n|\n)+)", text)
    return textwrap.dedent(script)


def git(repository: Path, *arguments: str) -> None:
    who = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main")
    subprocess.run(["git", *who, *arguments], cwd=repository, check=True, capture_output=True)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (["leaderboard/submissions/mine/submission.toml"], ""),
        (
            ["leaderboard/submissions/mine/a", "crowdbench/scoring/energy.py"],
            "Other files than those",
        ),
        (["leaderboard/submissions/mine/a", ".github/workflows/leaderboard.yml"], "Other files"),
        (["leaderboard/submissions/mine/a", "leaderboard/entries/mine.json.gz"], "Other files"),
        (["leaderboard/submissions/mine"], "Other files than those"),  # as a link would be
        (["leaderboard/submissions/$(touch ran)/a"], "called by its id"),
        (["leaderboard/submissions/a\nb/c"], "called by its id"),
        (["leaderboard/submissions/-rf/a b", "leaderboard/submissions/mine/\u202e"], ""),
    ],
)
def test_a_pull_request_of_a_submission_changes_nothing_else(
    changed: list[str], told: str, tmp_path: Path
) -> None:
    sent, summary = tmp_path / "sent", tmp_path / "summary"
    sent.mkdir()
    git(sent, "init")
    git(sent, "commit", "--allow-empty", "-m", "before")
    git(sent, "checkout", "-b", "theirs")
    for name in changed:
        (sent / name).parent.mkdir(parents=True, exist_ok=True)
        (sent / name).write_text("x")
    git(sent, "add", "--force", ".")
    git(sent, "commit", "-m", "theirs")
    git(sent, "checkout", "main")
    (sent / "since").write_text("x")  # what the branch has got since is none of theirs
    git(sent, "add", ".")
    git(sent, "commit", "-m", "since")
    git(sent, "merge", "--no-ff", "theirs")
    ran = subprocess.run(
        ["bash", "-e", "-c", step("Nothing but submissions")],
        cwd=tmp_path,
        env=os.environ | {"GITHUB_STEP_SUMMARY": str(summary)},
        capture_output=True,
        text=True,
    )
    assert (ran.returncode, ran.stderr) == (1 if told else 0, "")
    assert told in (summary.read_text() if summary.exists() else "")
    if not told:
        names = {name.split("/")[2] for name in changed}
        assert set((tmp_path / "submissions").read_text().split()) == names
    assert not (tmp_path / "ran").exists()
