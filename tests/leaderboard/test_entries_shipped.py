"""What stands in leaderboard/entries: all that is shipped, as verification makes it today."""

import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from crowdbench.cli import main
from crowdbench.files import sha256
from crowdbench.leaderboard.submission.submission import read_submission
from crowdbench.leaderboard.verification.entry import SCHEMA, SCORER, entry_paths, read_entry
from crowdbench.leaderboard.verification.verify import verify
from crowdbench.registry import import_recording, trained_policies
from crowdbench.scene import load_scene
from crowdbench.scoring.scorecard import files_of, unpack

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2] / "leaderboard"
ENTRIES = entry_paths(ROOT / "entries")
SUBMISSIONS = sorted(folder for folder in (ROOT / "submissions").iterdir() if folder.is_dir())


def test_all_that_is_shipped_is_an_entry() -> None:
    entries = [read_entry(path) for path in ENTRIES.values()]
    submitted = {entry.id for entry in entries if entry.status != "external"}
    assert submitted == {folder.name for folder in SUBMISSIONS}
    declared = [entry.declared for entry in entries]
    assert {d.shipped_spawn for d in declared} >= {
        *("poisson-gmm", "renewal-gmm", "ntpp-gmm", "block-replay")
    }
    networks = {
        (scene, name)
        for scene in ("eth-v0", "gc-v0", "forum-v0")
        for name in trained_policies(load_scene(scene))
    }
    walked = {
        (scene, d.shipped_policy) for d in declared if d.track == "walk" for scene in d.scenes
    }
    assert networks <= walked


@pytest.mark.parametrize("path", ENTRIES.values(), ids=list(ENTRIES))
def test_an_entry_is_of_the_present_files(path: Path) -> None:
    """Who adds one by hand, or changes it or its submission, is found out; and what was trained
    anew is to be verified anew."""
    entry = read_entry(path)
    assert (entry.schema, entry.scorer) == (SCHEMA, SCORER)
    protocol = "heldout"
    if entry.status == "external":  # not submitted: models of other simulators, in examples
        made_from = {name: sha256((ROOT.parent / name).read_bytes()) for name in entry.artefacts}
        assert entry.artefacts == made_from
    else:
        submission = read_submission(ROOT / "submissions" / entry.id)
        protocol = submission.protocol
        assert entry.declared == submission.declared
        assert entry.status == submission.status
        assert entry.artefacts == submission.artefacts
    assert set(entry.scenes) == set(entry.declared.scenes)
    for scene, of_scene in entry.scenes.items():
        assert of_scene.made_from == files_of(load_scene(scene))
        assert of_scene.protocol == protocol


def numbers(found: object) -> list[float]:
    """All numbers in an entry, in its order; resamples too."""
    match found:
        case bool() | str() | None:
            return []
        case int() | float():
            return [found]
        case bytes():
            return unpack(0.0, found).tolist()
        case dict():
            return [x for value in found.values() for x in numbers(value)]
        case list() | tuple():
            return [x for value in found for x in numbers(value)]
    raise TypeError(found)


def words(found: Any) -> Any:
    """An entry without its numbers."""
    if isinstance(found, dict):
        return {key: words(value) for key, value in found.items()}
    if isinstance(found, list | tuple):
        return [words(value) for value in found]
    return 0 if isinstance(found, int | float | bytes) else found


def test_a_shipped_baseline_gives_its_entry_again(opentraj: Path, tmp_path: Path) -> None:
    """On one of its scenes, because the others take minutes."""
    import_recording("eth", opentraj)
    submission = (ROOT / "submissions/ppo/submission.toml").read_text("utf-8")
    on_eth, replaced = re.subn("(?m)^scenes = .*$", 'scenes = ["eth-v0"]', submission)
    assert replaced == 1
    (tmp_path / "ppo").mkdir()
    (tmp_path / "ppo/submission.toml").write_text(on_eth, "utf-8")
    committed = read_entry(ROOT / "entries/ppo.json.gz")
    verify(tmp_path / "ppo", tmp_path, workers=1, key=committed.key)
    entry = read_entry(tmp_path / "ppo.json.gz")
    assert entry.flags == committed.flags == []
    made, expected = (
        msgspec.to_builtins(e.scenes["eth-v0"], builtin_types=(bytes,)) for e in (entry, committed)
    )
    assert words(made) == words(expected)
    # The same bytes on the same machine. Another processor rounds otherwise, and crowds are
    # chaotic: not to the last digit.
    np.testing.assert_allclose(
        np.array(numbers(made)), np.array(numbers(expected)), rtol=0.02, atol=0.03
    )


def test_an_entry_is_shown_by_its_id_or_its_file(capsys: pytest.CaptureFixture[str]) -> None:
    for asked in ("bc", str(ENTRIES["bc"])):
        assert main(["leaderboard", "show", asked]) == 0
        out = capsys.readouterr().out
        assert "bc (ranked)" in out
        assert "acceleration" in out
    assert main(["leaderboard", "show", "bcc"]) == 2
    assert "Did you mean `bc`?" in capsys.readouterr().err


def test_a_file_that_is_no_entry_is_said_to_be_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, text in (("mine.json", '{"a": 1}'), ("notes.md", "# Notes"), ("x.json", "[")):
        (tmp_path / name).write_text(text)
        assert main(["leaderboard", "show", str(tmp_path / name)]) == 2
        assert (
            f"{name}: got a file that is no entry of the leaderboard (" in capsys.readouterr().err
        )
