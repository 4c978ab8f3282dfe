"""Recordings are fetched whole and right, or an error says why not."""

import io
import re
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from servers import Published, serving, unused_address

from crowdbench.cli import main
from crowdbench.data.recordings import catalogue, fetch
from crowdbench.data.recordings.catalogue import (
    SOURCES,
    cached,
    import_recording,
    known_sha256,
    note_of,
    source,
)
from crowdbench.data.recordings.fetch import default_folder
from crowdbench.errors import FetchError, OutputError, RecordingError, SettingError
from crowdbench.files import sha256

Printed = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch

CROWD = "".join(
    f"{6 * frame} {person} {frame}.5 0.0 {person}.25 0.1 0.0 0.2\n"
    for person in range(300)
    for frame in range(person, person + 25)
).encode()
"""A recording in the format of ETH's, some chunks long."""
TRACKS = (
    b"% Total number of trajectories in file are  2 \n\n"
    b"Properties.R1=[3 8 16 ];\n TRACK.R1=[[10 20 8];[11 21 12];[12 22 16]];\n\n\n"
    b"Properties.R2=[2 9 17 ];\n TRACK.R2=[[30 40 9];[31 41 17]];\n"
)
OTHER_TRACKS = TRACKS.replace(b"[31 41 17]", b"[31 42 17]")
FORUM = "datasets/Edinburgh/annotations/tracks.14Jul.txt"


def zipped(**members: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file.getvalue()


@pytest.fixture
def server(monkeypatch: Patch) -> Iterator[Published]:
    """A server that publishes `CROWD` as the recording `eth`, and days of the Forum."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(fetch, "PAUSE_S", 0.0)
    with serving() as published:
        published.files["/obsmat.txt"] = CROWD
        eth = replace(
            SOURCES["eth"], address=f"{published.address}/obsmat.txt", sha256=sha256(CROWD)
        )
        monkeypatch.setitem(SOURCES, "eth", eth)
        monkeypatch.setattr(catalogue, "_FORUM_DAYS", published.address)
        yield published


@pytest.fixture
def eth(tmp_path: Path) -> Path:
    """Where the recording `eth` comes to lie."""
    return tmp_path / SOURCES["eth"].path


@pytest.fixture
def forum(tmp_path: Path) -> Path:
    return tmp_path / FORUM


def files_in(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def test_a_recording_is_fetched_and_imported(server: Published, home: Path, capsys: Printed):
    assert main(["data", "fetch", "eth"]) == 0
    printed = capsys.readouterr()
    assert f"fetched from {server.address}/obsmat.txt" in printed.out
    assert re.search(r"persons +300\n", printed.out)
    assert "The recording remains subject to its owners' terms. Cite: Pellegrini" in printed.out
    assert printed.err == ""
    assert default_folder() == home / "OpenTraj"
    assert (default_folder() / SOURCES["eth"].path).read_bytes() == CROWD
    assert main(["data", "describe", "eth"]) == 0


def test_another_folder_gets_the_layout_and_nothing_else(server: Published, tmp_path: Path):
    assert main(["data", "fetch", "eth", "--out", str(tmp_path)]) == 0
    assert files_in(tmp_path) == [SOURCES["eth"].path]
    assert len(import_recording("eth", tmp_path)) == 300


def test_what_is_there_and_right_is_not_fetched_again(
    server: Published, tmp_path: Path, capsys: Printed
):
    main(["data", "fetch", "eth", "--out", str(tmp_path)])
    cached("eth").unlink()
    capsys.readouterr()
    assert main(["data", "fetch", "eth", "--out", str(tmp_path)]) == 0
    assert "already there" in capsys.readouterr().out
    assert len(server.asked) == 1
    assert cached("eth").exists()


def test_what_is_there_and_wrong_is_replaced(server: Published, tmp_path: Path, eth: Path):
    eth.parent.mkdir(parents=True)
    eth.write_bytes(CROWD[:100])
    assert fetch.fetch("eth", tmp_path)
    assert eth.read_bytes() == CROWD


def test_a_wrong_hash_is_refused_and_nothing_is_left(
    server: Published, tmp_path: Path, capsys: Printed
):
    server.files["/obsmat.txt"] = CROWD.replace(b"0.5", b"0.6", 1)
    assert main(["data", "fetch", "eth", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"crowdbench: {server.address}/obsmat.txt: got data with SHA-256 ")
    assert sha256(CROWD) in error
    assert sha256(server.files["/obsmat.txt"]) in error
    assert "Run the command again" in error
    assert files_in(tmp_path) == []
    assert not cached("eth").exists()


def test_a_wrong_hash_leaves_the_file_that_was_there(server: Published, tmp_path: Path, eth: Path):
    eth.parent.mkdir(parents=True)
    eth.write_bytes(b"the user's own")
    server.files["/obsmat.txt"] = b"something else"
    with pytest.raises(FetchError):
        fetch.fetch("eth", tmp_path)
    assert eth.read_bytes() == b"the user's own"


def test_a_transfer_that_breaks_off_begins_again(server: Published, tmp_path: Path, eth: Path):
    server.breaks = [65_536, 0]
    assert fetch.fetch("eth", tmp_path)
    assert eth.read_bytes() == CROWD
    assert files_in(tmp_path) == [SOURCES["eth"].path]
    assert len(server.asked) == 3


def test_a_line_that_breaks_for_good_is_a_message_and_leaves_nothing(
    server: Published, tmp_path: Path, capsys: Printed
):
    server.breaks = [49_152, 8_192, 0]
    assert main(["data", "fetch", "eth", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "interrupted 3 times" in error
    assert "Run the command again" in error
    assert files_in(tmp_path) == []


def test_a_server_that_tells_no_length_is_held_against_the_hash(
    server: Published, tmp_path: Path, eth: Path
):
    server.says_length = False
    server.breaks = [1000]
    with pytest.raises(FetchError, match="SHA-256"):
        fetch.fetch("eth", tmp_path)
    assert fetch.fetch("eth", tmp_path)
    assert eth.read_bytes() == CROWD


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(breaks=st.lists(st.integers(0, len(CROWD) - 1), max_size=8))
def test_wherever_transfers_break_the_file_is_whole_or_absent(
    server: Published, tmp_path_factory: pytest.TempPathFactory, breaks: list[int]
):
    server.breaks = list(breaks)
    folder = tmp_path_factory.mktemp("broken")
    path = folder / SOURCES["eth"].path
    while not path.exists():
        try:
            fetch.fetch("eth", folder)
        except FetchError:
            assert files_in(folder) == []
    assert path.read_bytes() == CROWD


def test_progress_tells_bytes_of_the_whole_file(server: Published, tmp_path: Path):
    told: list[tuple[int, int | None]] = []
    server.breaks = [100_000]
    fetch.fetch("eth", tmp_path, lambda done, total: told.append((done, total)))
    assert told[-1] == (len(CROWD), len(CROWD))
    assert {total for _, total in told} == {len(CROWD)}


def test_an_interrupt_ends_with_exit_code_130_and_the_next_fetch_is_right(
    server: Published, tmp_path: Path, eth: Path
):
    server.breaks, server.stalls = [200_000], True
    code = (
        "import sys; from dataclasses import replace; from crowdbench import cli\n"
        "from crowdbench.data.recordings.catalogue import SOURCES\n"
        "SOURCES['eth'] = replace(SOURCES['eth'], address=sys.argv[1])\n"
        "sys.exit(cli.main(['data', 'fetch', 'eth', '--out', sys.argv[2]]))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, SOURCES["eth"].address, str(tmp_path)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    server.stalled.wait()
    process.send_signal(signal.SIGINT)
    _, error = process.communicate()
    assert (process.returncode, error) == (130, "crowdbench: interrupted\n")
    assert not eth.exists()
    assert fetch.fetch("eth", tmp_path)
    assert eth.read_bytes() == CROWD


ANSWERS = {
    "moved": ({"status": 404}, "got the response 404 Not Found", "The file may have moved"),
    "out of order": ({"status": 503}, "got the response 503 Service Unavailable", "unavailable"),
    "forbidden": ({"status": 403}, "got the response 403 Forbidden", "in a browser"),
    "a log-in page": ({"kind": "text/html; charset=utf-8"}, "got an HTML page", "require a login"),
}


@pytest.mark.parametrize("what", ANSWERS)
def test_another_answer_than_a_file_is_a_message_and_exit_code_2(
    server: Published, what: str, tmp_path: Path, capsys: Printed
):
    ways, got, hint = ANSWERS[what]
    for name, value in ways.items():
        setattr(server, name, value)
    assert main(["data", "fetch", "eth", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"crowdbench: {server.address}/obsmat.txt: {got}")
    assert hint in error
    assert "Traceback" not in error
    assert files_in(tmp_path) == []


def test_a_server_that_cannot_be_reached_is_a_message_and_exit_code_2(
    server: Published, tmp_path: Path, monkeypatch: Patch, capsys: Printed
):
    nowhere = replace(SOURCES["eth"], address=f"{unused_address()}/obsmat.txt")
    monkeypatch.setitem(SOURCES, "eth", nowhere)
    assert main(["data", "fetch", "eth", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"crowdbench: {nowhere.address}: got [Errno")
    assert "refused" in error
    assert "can reach the address" in error
    assert len(error.splitlines()) == 1


def test_more_bytes_than_any_recording_has_are_refused_and_dropped(
    server: Published, tmp_path: Path, monkeypatch: Patch
):
    monkeypatch.setattr(fetch, "MAX_BYTES", 100_000)
    with pytest.raises(FetchError, match="more than 100000 bytes"):
        fetch.fetch("eth", tmp_path)
    assert files_in(tmp_path) == []


def test_a_folder_that_cannot_be_written_is_refused(server: Published, tmp_path: Path):
    (tmp_path / "datasets").write_text("a file")
    with pytest.raises(OutputError, match="a file in place of a folder"):
        fetch.fetch("eth", tmp_path)
    assert server.asked == []


@pytest.mark.parametrize("name", ["moon", "plaza", "forum-14", "forum-14july", "../eth"])
def test_an_unknown_recording_cannot_be_fetched(name: str, tmp_path: Path):
    with pytest.raises(SettingError, match="forum-14jul"):
        fetch.fetch(name, tmp_path)


def test_a_day_of_the_forum_is_unpacked_and_its_hash_noted(
    server: Published, tmp_path: Path, forum: Path, capsys: Printed
):
    # What the text is called in the zip is not known: its name there is of no account.
    server.files["/Jul.14.zip"] = zipped(**{"../../tracks.Jul14": TRACKS, "readme": b"Tracks"})
    assert main(["data", "fetch", "forum-14jul", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert f"SHA-256 {sha256(TRACKS)} stored at first use; the publisher states none." in out
    assert "Majecka" in out
    assert files_in(tmp_path) == [FORUM]
    assert forum.read_bytes() == TRACKS
    assert known_sha256(source("forum-14jul")) == sha256(TRACKS)


def test_the_hash_is_told_as_noted_only_once(server: Published, tmp_path: Path, capsys: Printed):
    server.files["/Jul.14.zip"] = zipped(tracks=TRACKS)
    main(["data", "fetch", "forum-14jul", "--out", str(tmp_path)])
    capsys.readouterr()
    assert main(["data", "fetch", "forum-14jul", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "already there" in out
    assert "SHA-256" not in out


def test_an_import_notes_the_hash_too(forum: Path, tmp_path: Path, capsys: Printed):
    forum.parent.mkdir(parents=True)
    forum.write_bytes(TRACKS)
    assert main(["data", "import", "forum-14jul", "--source", str(tmp_path)]) == 0
    assert "stored at first use" in capsys.readouterr().out
    forum.write_bytes(OTHER_TRACKS)
    assert main(["data", "import", "forum-14jul", "--source", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert f"expected data with SHA-256 {sha256(TRACKS)}, as stored at first use" in error
    assert f"delete {note_of('forum-14jul')}" in error
    assert main(["data", "describe", "forum-14jul"]) == 0


def test_a_day_that_changed_since_its_first_use_is_refused(
    server: Published, tmp_path: Path, forum: Path, capsys: Printed
):
    server.files["/Jul.14.zip"] = zipped(tracks=TRACKS)
    main(["data", "fetch", "forum-14jul", "--out", str(tmp_path)])
    server.files["/Jul.14.zip"] = zipped(tracks=OTHER_TRACKS)
    elsewhere = tmp_path / "elsewhere"
    arguments = ["data", "fetch", "forum-14jul", "--out", str(elsewhere)]
    capsys.readouterr()
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert f"got data with SHA-256 {sha256(OTHER_TRACKS)}" in error
    assert f"expected data with SHA-256 {sha256(TRACKS)}, as stored at first use" in error
    assert str(note_of("forum-14jul")) in error
    assert files_in(elsewhere) == []
    note_of("forum-14jul").unlink()  # as the message says
    assert main(arguments) == 0
    assert known_sha256(source("forum-14jul")) == sha256(OTHER_TRACKS)


def test_the_same_tracks_in_another_zip_are_the_same_day(server: Published, tmp_path: Path):
    server.files["/Jul.14.zip"] = zipped(tracks=TRACKS)
    main(["data", "fetch", "forum-14jul", "--out", str(tmp_path / "a")])
    server.files["/Jul.14.zip"] = zipped(renamed=TRACKS, other=b"")
    assert main(["data", "fetch", "forum-14jul", "--out", str(tmp_path / "b")]) == 0


def test_a_broken_note_is_refused(forum: Path, tmp_path: Path):
    note_of("forum-14jul").parent.mkdir(parents=True)
    note_of("forum-14jul").write_text("{}")
    with pytest.raises(RecordingError, match="Delete it"):
        fetch.fetch("forum-14jul", tmp_path)


BAD_ZIPS = {
    "no zip": (b"not a zip", "a broken zip"),
    "broken off": (zipped(tracks=TRACKS)[:150], "a broken zip"),
    "a flipped byte": (zipped(tracks=TRACKS * 9).replace(b"\x03\x04", b"\x03\x05"), "a broken zip"),
    "nothing in it": (zipped(), "a zip with 0 files of tracks"),
    "no tracks": (zipped(readme=b"TRACK", detections=b"1 2 3"), "a zip with 0 files of tracks"),
    "two days": (zipped(a=TRACKS, b=OTHER_TRACKS), "a zip with 2 files of tracks"),
    "tracks broken off": (zipped(tracks=TRACKS[:-8]), "TRACK.R2"),
    "a bomb": (zipped(tracks=TRACKS + b" " * (1 << 27)), "tracks of more than 67108864 bytes"),
}


@pytest.mark.parametrize("what", BAD_ZIPS)
def test_a_zip_without_a_days_tracks_is_refused_and_dropped(
    server: Published, what: str, tmp_path: Path
):
    server.files["/Jul.14.zip"], message = BAD_ZIPS[what]
    with pytest.raises((FetchError, RecordingError), match=message) as caught:
        fetch.fetch("forum-14jul", tmp_path)
    assert str(caught.value).startswith(f"{server.address}/Jul.14.zip")
    assert caught.value.hint
    assert files_in(tmp_path) == []
    assert known_sha256(source("forum-14jul")) is None


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(0), byte=st.integers(0, 255))
def test_a_zip_with_any_byte_altered_gives_the_same_tracks_or_an_error(
    server: Published, tmp_path_factory: pytest.TempPathFactory, at: int, byte: int
):
    data = bytearray(zipped(tracks=TRACKS, readme=b"Tracks"))
    data[at % len(data)] = byte
    server.files["/Jul.14.zip"] = bytes(data)
    folder = tmp_path_factory.mktemp("altered")
    try:
        fetch.fetch("forum-14jul", folder)
    except FetchError:
        assert files_in(folder) == []
    else:
        assert (folder / FORUM).read_bytes() == TRACKS


def git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(folder), *arguments], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: Patch) -> tuple[str, str]:
    """A repository with GC's folder and others, as a server has it: its address, and a commit
    that is not the newest.
    """
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", "/dev/null")
    monkeypatch.setenv("GIT_CONFIG_NOSYSTEM", "1")
    made = tmp_path / "made"
    gc, other = made / "datasets" / "GC", made / "datasets" / "other"
    (gc / "Annotation").mkdir(parents=True)
    other.mkdir()
    (gc / "H.json").write_text('{"homog":[[0.1,0,0],[0,0.1,0],[0,0,1]]}')
    for number in range(1, 4):
        rows = [f"{number} {frame} {20 * frame}" for frame in range(5)]
        (gc / "Annotation" / f"{number:06}.txt").write_bytes("\r\n".join(rows).encode())
    (other / "large.txt").write_text("not wanted")
    git(tmp_path, "init", "--quiet", str(made))
    as_someone = ("-c", "user.name=a", "-c", "user.email=a@b")
    git(made, "add", ".")
    git(made, *as_someone, "commit", "--quiet", "-m", "pinned")
    pinned = git(made, "rev-parse", "HEAD")
    git(made, *as_someone, "commit", "--quiet", "--allow-empty", "-m", "newest")
    served = tmp_path / "served.git"
    git(tmp_path, "clone", "--quiet", "--bare", str(made), str(served))
    for allowed in ("allowFilter", "allowAnySHA1InWant"):  # as GitHub has it
        git(served, "config", f"uploadpack.{allowed}", "true")
    return f"file://{served}", pinned


def test_of_gc_the_commands_are_told_that_check_it_out(
    repository: tuple[str, str], tmp_path: Path, monkeypatch: Patch, capsys: Printed
):
    address, commit = repository
    monkeypatch.setattr(fetch.catalogue, "REPOSITORY", address)
    monkeypatch.setattr(fetch.catalogue, "COMMIT", commit)
    folder = tmp_path / "my recordings"
    assert main(["data", "fetch", "gc", "--out", str(folder)]) == 2
    error = capsys.readouterr().err
    assert "nothing was downloaded" in error
    *commands, bring = [line.strip() for line in error.splitlines() if line.startswith("  ")]
    assert bring == f"crowdbench data import gc --source '{folder}'"

    for command in commands:
        subprocess.run(command, shell=True, check=True, capture_output=True)
    assert not (folder / "datasets" / "other").exists()
    missing = git(folder, "rev-list", "--objects", "--missing=print", commit).count("?")
    assert missing == 1  # what is not wanted was not transferred either
    assert git(folder, "rev-list", "--count", "HEAD") == "1"

    found = catalogue.sha256_in(SOURCES["gc"], folder)
    monkeypatch.setitem(SOURCES, "gc", replace(SOURCES["gc"], sha256=found))
    capsys.readouterr()
    assert main(["data", "import", "gc", "--source", str(folder)]) == 0
    assert re.search(r"persons +3\n", capsys.readouterr().out)
    assert main(["data", "fetch", "gc", "--out", str(folder)]) == 0
    assert "already there" in capsys.readouterr().out


def test_gc_is_checked_out_beside_what_was_fetched_before(
    repository: tuple[str, str], tmp_path: Path
):
    address, commit = repository
    folder = tmp_path / "OpenTraj"
    fetched = folder / "datasets" / "other" / "large.txt"
    fetched.parent.mkdir(parents=True)
    fetched.write_text("fetched before")
    for command in fetch.git_commands(SOURCES["gc"], folder, address, commit):
        subprocess.run(command, shell=True, check=True, capture_output=True)
    assert fetched.read_text() == "fetched before"
    assert (folder / SOURCES["gc"].path / "H.json").exists()


def test_git_is_not_let_loose_on_a_repository_that_is_there(tmp_path: Path):
    (tmp_path / ".git").mkdir()
    with pytest.raises(FetchError, match="Choose another folder with --out") as caught:
        fetch.fetch("gc", tmp_path)
    assert "sparse-checkout" not in str(caught.value)


def test_the_commands_name_the_pinned_commit(tmp_path: Path):
    with pytest.raises(FetchError) as caught:
        fetch.fetch("gc", tmp_path)
    assert "https://github.com/crowdbotp/OpenTraj" in caught.value.hint
    assert caught.value.hint.count("97ec1d5e1b579f26febeaa9083705952deac338a") == 2


@pytest.mark.parametrize("name", SOURCES)
def test_each_recording_is_published_over_https(name: str):
    assert SOURCES[name].address.startswith("https://")
