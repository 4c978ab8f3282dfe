"""Submissions as zips: the same bytes again, and none that writes elsewhere or eats memory."""

import io
import shutil
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from submissions import walk_submission

from crowdbench.errors import OutputError
from crowdbench.leaderboard.submission import archive
from crowdbench.leaderboard.submission.archive import unpack, wrong_name
from crowdbench.leaderboard.submission.errors import SubmissionError
from crowdbench.leaderboard.submission.limits import LARGEST_SUBMISSION, LONGEST_PATH, MOST_FILES
from crowdbench.leaderboard.submission.submission import open_submission, pack_submission


@pytest.fixture
def walker(tmp_path: Path) -> Path:
    return walk_submission(tmp_path / "walker")


def hostile(path: Path, *members: str | zipfile.ZipInfo, data: bytes = b"x") -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made:
        for member in members:
            made.writestr(member, data)
    return path


def refused(path: Path, tmp_path: Path) -> str:
    """What is told of an archive, of which nothing is written outside its folder."""
    into = tmp_path / "deep" / "into"
    into.mkdir(parents=True)
    before = set(tmp_path.rglob("*"))
    with pytest.raises(SubmissionError) as caught:
        unpack(path, into)
    assert {p for p in set(tmp_path.rglob("*")) - before if into not in p.parents} == set()
    return str(caught.value)


def test_the_same_folder_gives_the_same_bytes(walker: Path, tmp_path: Path) -> None:
    packed = pack_submission(walker)
    assert packed == tmp_path / "walker.zip"
    again = tmp_path / "elsewhere" / "copy"
    shutil.copytree(walker, again)
    (again / "README.md").write_text("Notes are left out.")
    (again / "submission.toml").touch()
    out = pack_submission(again, tmp_path / "again.zip")
    assert out.read_bytes() == packed.read_bytes()


def test_a_packed_submission_is_the_folder(walker: Path) -> None:
    packed = pack_submission(walker)
    with open_submission(walker) as of_folder, open_submission(packed) as of_zip:
        assert of_zip.artefacts == of_folder.artefacts
        assert of_zip.declared == of_folder.declared
        fresh = of_zip.folder
        assert fresh != walker
        assert {p.relative_to(fresh) for p in fresh.rglob("*")} == {
            p.relative_to(walker) for p in walker.rglob("*")
        }
    assert not fresh.exists()


def test_only_what_is_right_is_packed(walker: Path, tmp_path: Path) -> None:
    (walker / "notes.txt").write_text("x")
    with pytest.raises(SubmissionError, match=r"notes\.txt"):
        pack_submission(walker)
    assert not (tmp_path / "walker.zip").exists()
    (walker / "notes.txt").unlink()
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="a file in place of a folder"):
        pack_submission(walker, tmp_path / "file" / "out.zip")
    with pytest.raises(SubmissionError, match="no such folder"):
        pack_submission(tmp_path / "nothing")


@pytest.mark.parametrize(
    ("name", "got"),
    [
        ("/etc/passwd", "an absolute path"),
        ("../evil", "leads out of the folder"),
        ("a/../../evil", "leads out of the folder"),
        ("C:/evil", "a drive letter"),
        ("a\\evil", "a backslash"),
        ("a//b", "invalid characters"),
        ("./a", "invalid characters"),
        (".git/config", "hidden"),
        ("ä.onnx", "invalid characters"),
        ("a\u202eb", "invalid characters"),
        ("a b", "invalid characters"),
        ("a\nb", "invalid characters"),
        ("a\x1b[2Jb", "invalid characters"),
        ("x" * (LONGEST_PATH + 1), f"a path of {LONGEST_PATH + 1} characters"),
    ],
)
def test_names_that_are_no_plain_paths_are_refused(name: str, got: str, tmp_path: Path) -> None:
    told = refused(hostile(tmp_path / "evil.zip", name), tmp_path)
    assert got in told
    assert all(c.isprintable() for c in told.replace("\n", ""))


def test_a_name_that_ends_at_a_null_byte_is_refused(tmp_path: Path) -> None:
    path = hostile(tmp_path / "evil.zip", "policy.onnxA.txt")
    path.write_bytes(path.read_bytes().replace(b"onnxA", b"onnx\0"))
    assert "invalid characters" in refused(path, tmp_path)


def test_a_second_name_in_an_extra_field_is_refused_or_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, other = b"policy.onnx", b"../evil"
    field = struct.pack("<BL", 1, zlib.crc32(name)) + other
    member = zipfile.ZipInfo(name.decode())
    member.extra = struct.pack("<HH", 0x7075, len(field)) + field
    path = hostile(tmp_path / "evil.zip", member)
    into = tmp_path / "deep" / "into"
    into.mkdir(parents=True)
    with suppress(SubmissionError):
        unpack(path, into)
    assert not (tmp_path / "deep" / "evil").exists()

    read = zipfile.ZipFile.infolist

    def believing(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
        """What newer Pythons read."""
        for member in (members := read(archive)):
            member.filename = other.decode()
        return members

    monkeypatch.setattr(zipfile.ZipFile, "infolist", believing)
    shutil.rmtree(tmp_path / "deep")
    assert "a second name, '../evil'" in refused(path, tmp_path)


@given(st.text(alphabet="./\\aA:~$ é\0", max_size=12))
def test_a_right_name_stays_in_its_folder(name: str) -> None:
    if wrong_name(name) is None:
        assert Path("/base", name).resolve().is_relative_to("/base")
        assert name.isascii()


@pytest.mark.parametrize("names", [("a.txt", "A.TXT"), ("a", "a/b"), ("a/b", "A"), ("a/", "A")])
def test_names_that_meet_are_refused(names: tuple[str, str], tmp_path: Path) -> None:
    assert "a repeated name" in refused(hostile(tmp_path / "evil.zip", *names), tmp_path)


def with_mode(mode: int) -> zipfile.ZipInfo:
    member = zipfile.ZipInfo("policy.onnx")
    member.create_system = 3
    member.external_attr = mode << 16
    return member


@pytest.mark.parametrize(
    ("mode", "got"),
    [
        (stat.S_IFLNK | 0o777, "a link"),
        (stat.S_IFCHR | 0o666, "a device"),
        (stat.S_IFBLK | 0o666, "a device"),
        (stat.S_IFIFO | 0o666, "a pipe"),
        (stat.S_IFSOCK | 0o666, "a device"),
    ],
)
def test_links_and_devices_are_refused(mode: int, got: str, tmp_path: Path) -> None:
    path = hostile(tmp_path / "evil.zip", with_mode(mode), data=b"/etc/passwd")
    assert got in refused(path, tmp_path)


def changed(path: Path, at_local: int, at_directory: int, value: int) -> Path:
    """The archive with 16 bits changed in the headers of its first member."""
    data = bytearray(path.read_bytes())
    struct.pack_into("<H", data, data.index(b"PK\x03\x04") + at_local, value)
    struct.pack_into("<H", data, data.index(b"PK\x01\x02") + at_directory, value)
    path.write_bytes(data)
    return path


def test_encrypted_members_are_refused(tmp_path: Path) -> None:
    path = changed(hostile(tmp_path / "evil.zip", "a"), 6, 8, 1)
    assert "an encrypted file" in refused(path, tmp_path)


def test_other_compression_is_refused(tmp_path: Path) -> None:
    path = changed(hostile(tmp_path / "evil.zip", "a"), 8, 10, 14)
    assert "compression of kind 14" in refused(path, tmp_path)


def test_archives_in_archives_are_refused(tmp_path: Path) -> None:
    inner = hostile(tmp_path / "inner.zip", "a").read_bytes()
    path = hostile(tmp_path / "evil.zip", "plaza-v0/more.ZIP", data=inner)
    assert "an archive in an archive" in refused(path, tmp_path)


def test_too_many_members_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = hostile(tmp_path / "evil.zip", *(f"{k}.txt" for k in range(MOST_FILES + 1)))
    assert f"expected at most {MOST_FILES} files" in refused(path, tmp_path)


def test_a_bomb_is_refused_by_what_it_says(tmp_path: Path) -> None:
    path = tmp_path / "bomb.zip"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made,
        made.open("policy.onnx", "w") as member,
    ):
        for _ in range(LARGEST_SUBMISSION // 2**20 + 1):
            member.write(bytes(2**20))
    assert path.stat().st_size < 1_000_000
    told = refused(path, tmp_path)
    assert "expected at most 200 MB, unpacked" in told


def test_a_bomb_that_says_less_is_refused_while_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "LARGEST_SUBMISSION", 500_000)
    path = hostile(tmp_path / "bomb.zip", "a", "b", data=bytes(400_000))
    assert "got 0.8 MB" in refused(path, tmp_path)
    less = path.read_bytes().replace(struct.pack("<L", 400_000), struct.pack("<L", 1_000))
    path.write_bytes(less)
    # Python stops at the size that the header says, and the checksum is then another.
    with pytest.raises(SubmissionError, match="an unreadable zip"):
        unpack(path, tmp_path / "deep" / "into")


def test_real_bytes_are_counted_whatever_the_headers_say(tmp_path: Path) -> None:
    path = hostile(tmp_path / "a.zip", "a", data=bytes(3_000))
    with (
        zipfile.ZipFile(path) as opened,
        pytest.raises(archive.RefusedError, match="than the arch"),
    ):
        archive._write(opened, opened.infolist()[0], tmp_path / "a", left=2_000)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: b"PK",
        lambda data: data[:-1],
        lambda data: data + b"tail",
        lambda data: data[len(data) // 2 :],
        lambda data: b"\0" * len(data),
        lambda data: data[:-22] + b"PK\x06\x07" + bytes(16) + data[-22:],
        lambda data: data[:-10] + b"\xff" * 4 + data[-6:],
    ],
)
def test_what_is_no_zip_is_refused(
    spoil: Callable[[bytes], bytes], walker: Path, tmp_path: Path
) -> None:
    path = pack_submission(walker)
    path.write_bytes(spoil(path.read_bytes()))
    assert "1 problem" in refused(path, tmp_path)


def test_a_large_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "large.zip"
    with path.open("wb") as file:
        file.truncate(LARGEST_SUBMISSION + 1)
    assert "got 200.0 MB" in refused(path, tmp_path)


def test_overlapping_members_are_refused(tmp_path: Path) -> None:
    """One kernel of data, many names: each entry of the directory points to the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as made:
        for name in ("a", "b"):
            made.writestr(name, bytes(100))
    data = bytearray(buffer.getvalue())
    second = data.index(b"PK\x01\x02", data.index(b"PK\x01\x02") + 4)
    struct.pack_into("<L", data, second + 42, 0)
    (tmp_path / "evil.zip").write_bytes(data)
    assert "an unreadable zip" in refused(tmp_path / "evil.zip", tmp_path)
