"""The graph of results: what is stale is made, in order, and nothing twice."""

from pathlib import Path

import pytest

import crowdbench
from crowdbench.errors import SettingError
from studies.remake import graph
from studies.remake.__main__ import main
from studies.remake.entry import unchanged_scenes
from studies.remake.graph import Result, keep, make, plan
from studies.remake.lock import LOCK, Line, file_hash, read_lock
from studies.remake.pages import results

REPOSITORY = Path(crowdbench.__file__).parents[1]
COPY = """from pathlib import Path
Path('{to}').write_text({text} + '\\n')
Path('log').open('a').write('{to} ')"""


def copies(name: str, source: str, to: str, text: str = "", code: str = "1") -> Result:
    """A result that is the first word of a file."""
    text = text or f"Path('{source}').read_text().split()[0]"
    command = ("python", "-c", COPY.format(to=to, text=text))
    return Result(name, (to,), (command,), files=(source,), facts={"code": code})


def chain(code: str = "1") -> list[Result]:
    """`c` is made from `b`, which is made from `a.txt`; listed in the wrong order."""
    return [copies("c", "b.txt", "c.txt"), copies("b", "a.txt", "b.txt", code=code)]


@pytest.fixture(autouse=True)
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.txt").write_text("one two")
    return tmp_path


def made(declared: list[Result]) -> str:
    """The files that are made, in order."""
    Path("log").unlink(missing_ok=True)
    make(declared, LOCK, lambda text: None)
    return Path("log").read_text().strip() if Path("log").exists() else ""


def test_what_is_missing_is_made_in_order_and_never_twice() -> None:
    assert list(plan(chain(), {})) == ["b", "c"]
    assert made(chain()) == "b.txt c.txt"
    assert Path("c.txt").read_text() == "one\n"
    assert plan(chain(), read_lock(LOCK)) == {}
    assert made(chain()) == ""


def test_what_is_behind_is_made_only_if_bytes_changed() -> None:
    made(chain())
    Path("a.txt").write_text("one three")  # `b` stays the same
    assert plan(chain(), read_lock(LOCK)) == {"b": (["a.txt"], []), "c": ([], ["b"])}
    assert made(chain()) == "b.txt"
    Path("a.txt").write_text("four")
    assert made(chain()) == "b.txt c.txt"
    assert Path("c.txt").read_text() == "four\n"


def test_an_output_that_somebody_changed_is_made_again() -> None:
    made(chain())
    Path("b.txt").write_text("mine")
    assert plan(chain(), read_lock(LOCK)) == {
        "b": (["its outputs"], []),
        "c": (["b.txt"], ["b"]),
    }
    assert made(chain()) == "b.txt"
    Path("c.txt").unlink()
    assert plan(chain(), read_lock(LOCK)) == {"c": (["missing outputs"], [])}


def test_changes_of_code_can_be_kept_with_a_reason_and_no_others() -> None:
    made(chain())
    before = read_lock(LOCK)["b"]
    assert plan(chain("2"), read_lock(LOCK)) == {"b": (["code"], []), "c": ([], ["b"])}
    assert keep(chain("2"), LOCK, "Names alone") == ["b"]
    line = read_lock(LOCK)["b"]
    assert (line.kept, line.cpu_s, line.outputs) == ("Names alone", before.cpu_s, before.outputs)
    assert made(chain("2")) == ""
    Path("a.txt").write_text("three")
    with pytest.raises(SettingError, match=r"got other changes: b \(a\.txt\)"):
        keep(chain("3"), LOCK, "Names alone")
    assert read_lock(LOCK)["b"] == line


def test_some_results_can_be_made_or_kept_alone() -> None:
    make(chain(), LOCK, lambda text: None, only=["b"])
    assert list(read_lock(LOCK)) == ["b"]
    make(chain(), LOCK, lambda text: None, only=["c"])
    assert list(read_lock(LOCK)) == ["b", "c"]
    Path("c.txt").write_text("mine")  # the others may have any change
    assert keep(chain("2"), LOCK, "Names alone", only=["b"]) == ["b"]
    assert plan(chain("2"), read_lock(LOCK)) == {"c": (["its outputs"], [])}


def test_what_is_to_be_made_again_keeps_its_reason() -> None:
    made(chain())
    keep(chain("2"), LOCK, "Has other inputs; to be made again")
    keep(chain("3"), LOCK, "Names alone")
    assert read_lock(LOCK)["b"].kept == "Has other inputs; to be made again"
    Path("a.txt").write_text("three")
    made(chain("3"))
    assert read_lock(LOCK)["b"].kept == ""


def test_what_was_there_before_the_lock_is_kept_and_what_is_missing_is_not() -> None:
    for name in ("b.txt", "c.txt"):
        Path(name).write_text("one\n")
    assert keep(chain(), LOCK, "Made before") == ["c", "b"]
    assert read_lock(LOCK)["c"].kept == "Made before"
    assert read_lock(LOCK)["c"].cpu_s is None
    assert plan(chain(), read_lock(LOCK)) == {}
    LOCK.unlink()
    Path("c.txt").unlink()
    with pytest.raises(SettingError, match=r"c \(missing outputs\)"):
        keep(chain(), LOCK, "Made before")
    assert not LOCK.exists()


def test_two_that_do_not_need_each_other_are_made_at_once() -> None:
    meet = """import time
from pathlib import Path
Path('{me}').touch()
end = time.monotonic() + 60
while not Path('{other}').exists():
    assert time.monotonic() < end
    time.sleep(.01)"""
    pair = [
        Result(me, (me,), (("python", "-c", meet.format(me=me, other=other)),))
        for me, other in (("x", "y"), ("y", "x"))
    ]
    make(pair, LOCK, lambda text: None)
    assert sorted(read_lock(LOCK)) == ["x", "y"]
    assert all(line.cpu_s is not None for line in read_lock(LOCK).values())


def test_what_runs_beside_a_command_that_fails_is_finished() -> None:
    slow = ("python", "-c", "import time; time.sleep(1); open('x', 'w')")
    fails = Result("y", ("y",), (("python", "-c", "1 / 0"),))
    with pytest.raises(SettingError, match="exit code 1"):
        make([Result("x", ("x",), (slow,)), fails], LOCK, lambda text: None)
    assert Path("x").exists()
    assert list(read_lock(LOCK)) == ["x"]


def test_a_command_that_fails_leaves_what_was_made_before_it() -> None:
    broken = copies("c", "b.txt", "c.txt", text="1 / 0")
    with pytest.raises(SettingError, match="exit code 1 of python -c"):
        make([broken, chain()[1]], LOCK, lambda text: None)
    assert list(read_lock(LOCK)) == ["b"]
    assert made(chain()) == "c.txt"


def test_a_page_can_be_what_a_command_prints() -> None:
    page = Result("p", ("p.md",), (("python", "-c", "print('new')"),), stdout="p.md")
    make([page], LOCK, lambda text: None)
    assert Path("p.md").read_text() == "new\n"
    assert read_lock(LOCK)["p"].cpu_s is not None


def test_a_page_by_hand_is_asked_for_and_taken_when_its_tables_are_written() -> None:
    def page() -> list[Result]:
        return [Result("p", ("p.md",), (("python", "-V"),), by_hand=True, files=("a.txt",))]

    Path("p.md").write_text("Words.\n| 1 |\n")
    keep(page(), LOCK, "Made before")
    Path("p.md").write_text("Other words.\n| 1 |\n")
    assert plan(page(), read_lock(LOCK)) == {}
    Path("a.txt").write_text("two")
    told: list[str] = []
    with pytest.raises(SettingError, match="not made: p"):
        make(page(), LOCK, told.append)
    assert told == ["p: run python -V, and write its numbers into p.md"]
    Path("p.md").write_text("Other words.\n| 2 |\n")
    make(page(), LOCK, told.append)
    assert plan(page(), read_lock(LOCK)) == {}


def test_results_in_a_circle_are_an_error() -> None:
    with pytest.raises(SettingError, match="a circle among b, c"):
        plan([copies("b", "c.txt", "b.txt"), copies("c", "b.txt", "c.txt")], {})


def test_a_broken_lock_is_an_error() -> None:
    LOCK.write_text('{"name": 1}\n')
    with pytest.raises(SettingError, match=r"results\.lock: got Expected `str`"):
        read_lock(LOCK)


def test_an_entry_keeps_the_scenes_of_which_nothing_has_changed(desk: Path) -> None:
    Path("e.json").write_text("entry")
    then = {
        "settings of eth-v0": "1",
        "recording gc": "1",
        "scenes/gc-v0/policies/bc": "1",
        "crowdbench/leaderboard/verification/copy_limits.json": "1",
        "code": "1",
    }

    def unchanged(**changed: str) -> list[str]:
        result = Result("entries/e", ("e.json",), (), facts=then | changed)
        line = Line("entries/e", then, result.made())
        return unchanged_scenes(result, line, ["eth-v0", "gc-v0"])

    assert unchanged() == ["eth-v0", "gc-v0"]
    assert unchanged(**{"settings of eth-v0": "2"}) == ["gc-v0"]
    assert unchanged(**{"recording gc": "2"}) == ["eth-v0"]
    assert unchanged(**{"scenes/gc-v0/policies/bc": "2"}) == ["eth-v0"]
    assert unchanged(**{"crowdbench/leaderboard/verification/copy_limits.json": "2"}) == [
        "eth-v0",
        "gc-v0",
    ]
    assert unchanged(code="2") == []
    assert unchanged_scenes(Result("entries/e", ("e.json",), ()), None, ["gc-v0"]) == []


@pytest.fixture(scope="module")
def declared() -> list[Result]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(REPOSITORY)
        return results()


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)


@pytest.mark.usefixtures("here")
def test_the_lock_and_the_repository_agree(declared: list[Result]) -> None:
    lines = read_lock(LOCK)
    assert plan(declared, lines) == {}, "run `make results`, or record why a change changed nothing"
    assert set(lines) == {result.name for result in declared}


@pytest.mark.usefixtures("here")
def test_a_clone_has_nothing_to_make(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--plan"]) == 0
    assert capsys.readouterr().out == "nothing to make\n"


def touch(monkeypatch: pytest.MonkeyPatch, touched: str) -> None:
    def other(path: Path, tables_only: bool = False) -> str:
        return "other" if str(path) == touched else file_hash(path, tables_only)

    monkeypatch.setattr(graph, "file_hash", other)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("touched", "stale", "behind"),
    [
        (
            "scenes/eth-v0/policies/bc/fold0.onnx",
            {"entries/bc", "entries/ntpp-gmm-bc", "docs/walks", "clips/bc", "clips/ntpp-gmm-bc"},
            {"leaderboard"},
        ),
        (
            "scenes/gc-v0/policies/anticipate/fold1.onnx",
            {
                *("entries/anticipate", "entries/cox-plans-anticipate", "docs/walks"),
                *("docs/encounters/gc-v0", "docs/across", "docs/rollouts", "ceilings/gc-v0"),
            },
            {
                *("leaderboard", "docs/peers", "ceilings/eth-v0", "ceilings/hotel-v0"),
                *("ceilings/zara1-v0", "ceilings/forum-v0"),
            },
        ),
        (
            "leaderboard/submissions/orca/submission.toml",
            {"entries/orca", "clips/orca"},
            {"leaderboard", "docs/peers"},
        ),
        ("docs/paper/eth-v0/verdicts.json", {"docs/paper/eth-v0", "docs/paper"}, set()),
    ],
)
def test_after_a_change_of_one_file_only_what_reads_it_is_made(
    declared: list[Result],
    touched: str,
    stale: set[str],
    behind: set[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert Path(touched).exists()
    touch(monkeypatch, touched)
    steps = plan(declared, read_lock(LOCK))
    assert {name for name, (reasons, _) in steps.items() if reasons} == stale
    assert {name for name, (reasons, _) in steps.items() if not reasons} == behind


@pytest.mark.usefixtures("here")
def test_a_wrong_name_is_answered(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--only", "docs/walk"]) == 2
    assert "docs/walks" in capsys.readouterr().err


@pytest.mark.usefixtures("here")
def test_every_generated_file_of_the_leaderboard_and_the_pages_is_a_result(
    declared: list[Result],
) -> None:
    known = {str(p) for r in declared for pattern in r.outputs for p in Path().glob(pattern)}
    pictures = {str(p) for p in Path("docs").rglob("*") if p.suffix in (".png", ".gif", ".json")}
    by_hand = {"docs/scenes/place.png", "docs/viewer/eth-v0.png", "docs/viewer/gc-v0.png"}
    assert pictures - known == by_hand
    assert {str(p) for p in Path("leaderboard/entries").iterdir()} <= known
    assert {str(p) for p in Path("scenes").glob("*/*.json*")} <= known


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (["--keep", " "], "got no reason"),
        (["--plan", "--keep", "x"], "expected one of them"),
        (["--plan", "--only", "docs/walks"], "expected one of them"),
    ],
)
def test_a_reason_is_one_and_a_plan_keeps_nothing(
    asked: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(asked) == 2
    assert told in capsys.readouterr().err
