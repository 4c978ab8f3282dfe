"""What docs/scenes.md says runs, from its made-up recording to an evaluation."""

import shlex
from pathlib import Path

import pages
import pytest

from crowdbench.cli import main
from crowdbench.data.recordings.formats import FORMATS

pytestmark = pytest.mark.long

PAGE = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text()
SMALL = ["--fits", "1", "--rollouts-per-fit", "2", "--workers", "1"]


@pytest.mark.usefixtures("no_report", "unadjusted", "brief_networks")
def test_every_command_runs_in_the_order_of_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = pages.blocks(PAGE, "python")
    exec(compile(example, "passage.py", "exec"), {})
    for command in pages.commands(PAGE):
        arguments = shlex.split(command)[1:]
        if arguments[:2] == ["scene", "create"]:  # the whole protocol takes minutes
            arguments += SMALL
        if arguments[0] == "evaluate":  # test_authoring.py looks at scores
            arguments += ["--seeds", "1"]
        assert main(arguments) == 0, f"{command}: {capsys.readouterr().err}"
    printed = capsys.readouterr().out
    (shown,) = pages.blocks(PAGE, "text")
    for line in shown.splitlines():
        if not line.strip().startswith("ntpp-gmm"):  # one fit here, five on the page
            assert line in printed


def test_every_format_is_told_of() -> None:
    assert all(f"| `{layout}` |" in PAGE for layout in FORMATS)
