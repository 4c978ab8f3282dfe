"""Packed JSON: the same bytes each time, and no more unpacked than fits."""

import gzip
from pathlib import Path

import pytest

from crowdbench import files
from crowdbench.errors import WeightsError
from crowdbench.files import read_struct, write_json

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
