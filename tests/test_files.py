"""Packed JSON: the same bytes each time, and no more unpacked than fits."""

import gzip
import os
from pathlib import Path

import pytest

from crowdbench import files
from crowdbench.errors import OutputError, WeightsError
from crowdbench.files import read_struct, write_json, write_text

HINT = "Make it again."


def test_packed_json_is_read_back_and_has_no_date(tmp_path: Path) -> None:
    for name in ("a.json.gz", "b.json.gz"):
        write_json(tmp_path / name, {"numbers": [0.1, 1e-300], "name": "ä"})
    packed = (tmp_path / "a.json.gz").read_bytes()
    assert packed == (tmp_path / "b.json.gz").read_bytes()
    assert gzip.decompress(packed).count(b"\n") == 1
    found = read_struct(tmp_path / "a.json.gz", dict, WeightsError, HINT)
    assert found == {"numbers": [0.1, 1e-300], "name": "ä"}


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"{}", "expected a gzip file"),
        (gzip.compress(b"{}")[:-3], "cut, too large"),
        (gzip.compress(b"{}") + b"more", "followed by other bytes"),
        (gzip.compress(b"[" + b" " * 5000), "at most 0 MB, unpacked"),
        (gzip.compress(b"{]"), "expected valid JSON"),
        (gzip.compress(b"\xff"), "expected valid JSON"),
    ],
    ids=["plain", "cut", "longer", "bomb", "syntax", "bytes"],
)
def test_broken_packed_json_is_refused(
    data: bytes, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "LARGEST_UNPACKED", 1000)
    (tmp_path / "a.json.gz").write_bytes(data)
    with pytest.raises(WeightsError) as caught:
        read_struct(tmp_path / "a.json.gz", dict, WeightsError, HINT)
    assert told in str(caught.value)
    assert HINT in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_pipes_and_devices_are_neither_read_nor_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "table.json"
    os.mkfifo(pipe)
    with pytest.raises(WeightsError, match="got a pipe; expected a file"):
        read_struct(pipe, dict, WeightsError, "")
    with pytest.raises(OutputError, match="got a pipe; expected a file, or no such path"):
        write_json(pipe, {})
    assert pipe.is_fifo()
    with pytest.raises(OutputError, match="got a device"):
        write_text(Path("/dev/null"), "lost")
    assert Path("/dev/null").is_char_device()
    assert list(tmp_path.iterdir()) == [pipe]


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    file, link = tmp_path / "file.json", tmp_path / "link.json"
    write_json(file, {"a": 1})
    link.symlink_to(file)
    write_json(link, {"a": 2})
    assert link.is_symlink()
    assert read_struct(file, dict, WeightsError, "") == {"a": 2}
