"""The sandbox: who hangs, crashes, forks or eats memory is refused, and leaves nothing behind."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import need

from crowdbench.errors import CrowdbenchError
from crowdbench.leaderboard.sandbox import isolation
from crowdbench.leaderboard.sandbox.parent import Limits, SandboxError, call
from crowdbench.leaderboard.submission.errors import SubmissionError
from crowdbench.leaderboard.verification.verify import _refuse_root
from crowdbench.progress import heard_by
from crowdbench.run import store

NARROW = Limits(
    memory_bytes=2**29, wall_s=20.0, cpu_s=10, file_bytes=2**24, open_files=64, processes=16
)


@pytest.fixture(autouse=True, params=["isolated", "plain"])
def walls(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Behind bubblewrap, and as where there is none."""
    if request.param == "isolated":
        need(shutil.which("bwrap") or sys.platform != "linux", "bubblewrap")
        if isolation.lacking():  # a container may forbid namespaces
            pytest.skip(isolation.lacking())
    else:
        monkeypatch.setattr(isolation, "lacking", lambda: "not asked for")
    return str(request.param)


@pytest.fixture
def plain(walls: str) -> None:
    """Only where processes of a child have the numbers that they have outside."""
    if walls == "isolated":
        pytest.skip("isolated processes have other numbers")


@pytest.fixture(autouse=True)
def found_by_children(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]), prepend=os.pathsep)


def tried(
    name: str,
    kind: type = object,
    limits: Limits = NARROW,
    writes: Sequence[Path] = (),
    **arguments: object,
) -> object:
    asked = f"hostile:{name}"
    return call(asked, arguments, kind, where="mine", limits=limits, writes=writes)[0]


def test_a_result_comes_back_with_what_it_took_and_progress_is_told() -> None:
    told = []
    with heard_by(lambda *of: told.append(of)):
        result, ran = call("hostile:add", {"a": 2, "b": 3}, int, where="mine", limits=NARROW)
    assert result == 5
    assert 0 < ran.wall_s < 20
    assert ran.peak_bytes > 2**20
    assert set(told) == {("rollouts", 1, 1)}


def test_a_child_adds_nothing_to_the_store_of_rollouts(tmp_path: Path) -> None:
    asked = {"key": "mine", "beside": str(tmp_path / "beside")}
    tried("keep_in_the_store", str, **asked)
    assert not store.folder().exists()
    store.keep("mine", ".parquet", b"here", tmp_path)
    assert tried("keep_in_the_store", str, **asked) == "here"


@pytest.mark.parametrize(
    ("name", "changed", "message"),
    [
        ("hang", {"wall_s": 1.0}, "mine: got no end after 1 s"),
        ("spin", {"cpu_s": 1}, "more than 1 s of CPU time"),
        ("crash", {}, r"a crash \(SIGABRT\), last output: about to fall\[31m"),
        ("leave", {}, "exit code 3"),
        ("fail", {}, "exit code 1, last output: ValueError: no such thing"),
        ("eat", {}, "more than 0.5 GiB of memory|out of memory"),
        ("eat_together", {}, "more than 0.5 GiB of memory"),
        ("multiply", {}, "more than 16 processes"),
        ("pipe_for_answer", {}, "an answer that cannot be read .*not a regular file"),
        ("pipe_for_progress", {"wall_s": 1.0}, "no end after 1 s"),
        ("endless_progress", {"wall_s": 1.0}, "no end after 1 s"),
        ("pipe_for_what_it_says", {}, "exit code 3"),
        ("nested_answer", {}, "an answer that cannot be read"),
    ],
)
def test_what_breaks_a_limit_is_refused_by_name(
    name: str, changed: dict[str, float], message: str
) -> None:
    limits = replace(NARROW, **changed)
    began = time.monotonic()
    with pytest.raises(SandboxError, match=message):
        tried(name, limits=limits)
    assert time.monotonic() - began < 15


@pytest.mark.usefixtures("plain")
def test_who_left_the_session_is_ended_with_the_one_that_hangs(tmp_path: Path) -> None:
    note = tmp_path / "child"
    with pytest.raises(SandboxError, match="no end after"):
        tried("outlive", limits=replace(NARROW, wall_s=2.0), note=str(note), hang_s=600)
    assert ended(int(note.read_text()))


@pytest.mark.usefixtures("plain")
def test_who_left_the_session_is_ended_with_the_one_that_answers(tmp_path: Path) -> None:
    note = tmp_path / "child"
    tried("outlive", note=str(note), hang_s=1)
    assert ended(int(note.read_text()))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends children with their parents")
@pytest.mark.usefixtures("plain")
def test_it_ends_with_a_verifier_that_is_killed(tmp_path: Path) -> None:
    note = tmp_path / "child"
    verifying = (
        f"call('hostile:hang_by_name', {{'note': '{note}'}}, object, where='', limits=Limits())"
    )
    plainly = (
        "from crowdbench.leaderboard.sandbox import isolation; isolation.lacking = lambda: 'no'"
    )
    imported = "from crowdbench.leaderboard.sandbox.parent import Limits, call"
    script = f"{plainly}; {imported}; {verifying}"
    with subprocess.Popen([sys.executable, "-c", script]) as verifier:
        soon = time.monotonic() + 30
        while not note.exists() and time.monotonic() < soon:
            time.sleep(0.05)
        verifier.kill()
    assert ended(int(note.read_text()))


def ended(process: int) -> bool:
    """Whether it ends within seconds: who is killed is so only when its turn comes."""
    soon = time.monotonic() + 5
    while alive(process) and time.monotonic() < soon:
        pass
    return not alive(process)


def alive(process: int) -> bool:
    """Whether it runs; who has ended and was not asked after is a zombie."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_files_end_at_their_limit(tmp_path: Path) -> None:
    path = str(tmp_path / "much")
    assert tried("write_much", str, path=path, writes=[tmp_path]) == "File too large"
    assert (tmp_path / "much").stat().st_size == NARROW.file_bytes


def test_so_many_files_can_be_open() -> None:
    assert 0 < tried("open_many", int) < NARROW.open_files


@pytest.fixture
def port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_there_is_no_network_or_it_is_said_why(port: int) -> None:
    found, ran = call("hostile:reach", {"port": port}, str, where="mine", limits=NARROW)
    if ran.network == "none":
        assert found != "reached"
    else:
        assert ran.network.startswith("not cut off: ")


def test_isolated_children_see_none_of_the_users_files(walls: str, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("mine")
    (tmp_path / "shared").mkdir()
    seen = call(
        "hostile:look",
        {"path": str(tmp_path / "secret"), "home": str(Path.home())},
        dict,
        where="mine",
        limits=NARROW,
        reads=[tmp_path / "shared"],
    )
    if walls == "plain":
        assert seen[0]["secret"] == "mine"
        assert seen[1].files == "not isolated: not asked for"
        return
    assert seen[0] == {"secret": "No such file or directory", "home": [], "signal": "no process"}
    assert seen[1].files == "isolated"


def test_the_working_directory_is_not_seen_because_python_imports_from_it(
    walls: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "secret").write_text("mine")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    asked = {"path": str(tmp_path / "secret"), "home": str(Path.home())}
    found = call("hostile:look", asked, dict, where="mine", limits=NARROW)[0]
    assert found["secret"] == ("mine" if walls == "plain" else "No such file or directory")


def test_isolated_children_write_only_where_they_may(walls: str, tmp_path: Path) -> None:
    mine, other = tmp_path / "mine", tmp_path / "other"
    other.mkdir()
    tried("write_into", folders=[str(mine), str(other)], writes=[mine])
    assert (mine / "file").read_text() == "written"
    assert (other / "file").exists() == (walls == "plain")


def test_an_isolated_child_that_forks_twice_is_ended(walls: str, tmp_path: Path) -> None:
    if walls == "plain":
        pytest.skip("without isolation, who leaves twice is not found")
    beats = tmp_path / "beats"
    tried("fork_twice", path=str(beats / "beat"), writes=[beats])
    before = (beats / "beat").read_text()
    time.sleep(0.5)
    assert (beats / "beat").read_text() == before


def test_root_judges_only_behind_walls(walls: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.delenv(isolation.AS_ROOT, raising=False)
    if walls == "isolated":
        _refuse_root(Path("mine"))
        return
    with pytest.raises(SandboxError, match="got the user root, without isolation"):
        _refuse_root(Path("mine"))
    monkeypatch.setenv(isolation.AS_ROOT, "1")
    _refuse_root(Path("mine"))


def test_keys_in_the_surroundings_are_not_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "1234")
    seen = tried("surroundings", list)
    assert "PATH" in seen
    assert "SECRET_TOKEN" not in seen


def test_an_error_of_the_submission_keeps_its_message() -> None:
    with pytest.raises(CrowdbenchError) as error:
        tried("refuse")
    assert str(error.value) == "the submission: got nothing; expected something. Add it."


def test_an_error_of_the_submission_only_shows() -> None:
    with pytest.raises(CrowdbenchError) as error:
        tried("paint")
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 600


def test_all_that_is_wrong_with_a_submission_is_told() -> None:
    with pytest.raises(SubmissionError) as error:
        tried("refuse_submission")
    assert str(error.value) == (
        "mine: 2 problems.\n  file 0: got x; expected y. Mend.\n  file 1: got x; expected y. Mend."
    )


def test_an_answer_that_leads_elsewhere_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text('{"network":"none","value":"secret"}')
    with pytest.raises(SandboxError, match="an answer that cannot be read"):
        tried("linked_answer", to=str(tmp_path / "secret"))


def test_what_lies_where_one_stands_is_not_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when a submission is verified from inside of its folder."""
    for module in ("msgspec", "hostile"):
        (tmp_path / f"{module}.py").write_text("import os\nos._exit(7)\n")
    monkeypatch.chdir(tmp_path)
    assert tried("add", int, a=1, b=1) == 2


def test_an_answer_of_another_kind_is_refused() -> None:
    with pytest.raises(SandboxError, match="an answer that cannot be read"):
        tried("surroundings", int)


def test_a_platform_without_posix_is_rejected_before_anything_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from crowdbench.leaderboard.sandbox import parent

    monkeypatch.setattr(parent.os, "name", "nt")
    with pytest.raises(SandboxError, match=r"expected Linux or macOS.*Windows Subsystem"):
        call(f"{__name__}:no_function", {}, int, where="a submission", limits=Limits())
