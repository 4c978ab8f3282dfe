"""Submissions as zip files: packed reproducibly, and unpacked safely.

Names, file types and sizes are checked before anything is written. Sizes are checked again while
writing, since those stated in an archive may be false.
"""

import re
import stat
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

from crowdbench.files import replacing
from crowdbench.leaderboard.submission.errors import RefusedError, SubmissionError
from crowdbench.leaderboard.submission.limits import LARGEST_SUBMISSION, LONGEST_PATH, MOST_FILES

_HINT = "Create it with `crowdbench submit pack`."
_CHUNK = 2**20
_END = struct.Struct("<4s4H2LH")  # end of central directory
_ZIP64 = b"PK\x06\x07"
_LONGEST_ENTRY = 500  # bytes of a member in the central directory
_EPOCH = (1980, 1, 1, 0, 0, 0)
_NAME = re.compile(r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*(/[A-Za-z0-9_+-][A-Za-z0-9._+-]*)*/?")
_ARCHIVES = (".zip", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".zst", ".7z", ".rar", ".jar", ".whl")
_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    LookupError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
)
"""Exceptions that Python's zip reader raises for broken files."""


def pack(folder: Path, names: Iterable[str], out: Path) -> None:
    """Write the files `names` of a folder to a zip. The same files give the same bytes.

    Raises:
        OutputError: `out` cannot be written.
    """
    with replacing(out) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name in sorted(names):
            member = zipfile.ZipInfo(name, _EPOCH)
            member.create_system = 3  # Unix, on every platform
            member.external_attr = (stat.S_IFREG | 0o644) << 16
            # Stored uncompressed: compressed bytes would depend on the library.
            archive.writestr(member, (folder / name).read_bytes())


def unpack(path: Path, into: Path) -> None:
    """Extract an untrusted zip into the empty folder `into`.

    Raises:
        SubmissionError: the zip is broken or too large, or contains invalid names, links, devices,
            encrypted or repeated members, or other archives.
    """
    try:
        _check_end(path)
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            problems = [*_wrong_names(members), *_wrong_kinds(members), *_wrong_sizes(members)]
            if problems:
                raise SubmissionError(path, problems)
            left = LARGEST_SUBMISSION
            for member in members:
                if not member.is_dir():
                    left -= _write(archive, member, into / member.filename, left)
    except _BROKEN as error:
        told = str(error) or type(error).__name__
        broken = RefusedError(
            path.name, got=f"an unreadable zip ({told})", expected="a valid zip", hint=_HINT
        )
        raise SubmissionError(path, [broken]) from error
    except RefusedError as refusal:
        raise SubmissionError(path, [refusal]) from refusal


def _check_end(path: Path) -> None:
    """Reject a central directory that is too long, before it is read."""
    size = path.stat().st_size
    if size > LARGEST_SUBMISSION:
        raise _too_large(path.name, f"{size / 1e6:.1f} MB")
    with path.open("rb") as file:
        file.seek(max(0, size - _END.size - 20))
        tail = file.read()
    if len(tail) < _END.size or tail[-_END.size : -_END.size + 4] != b"PK\x05\x06":
        raise RefusedError(
            path.name,
            got="a file without the end record of a zip",
            expected="a zip without a comment",
            hint=_HINT,
        )
    members, length = _END.unpack(tail[-_END.size :])[4:6]
    if tail.startswith(_ZIP64) or members > MOST_FILES or length > MOST_FILES * _LONGEST_ENTRY:
        raise RefusedError(
            path.name,
            got=f"a central directory of {members} files and {length} bytes",
            expected=f"at most {MOST_FILES} files",
            hint=_HINT,
        )


def _too_large(name: str, got: str) -> RefusedError:
    return RefusedError(
        name, got=got, expected=f"at most {LARGEST_SUBMISSION / 1e6:.0f} MB, unpacked", hint=_HINT
    )


def wrong_name(name: str) -> RefusedError | None:
    """The problem with a file's path in a submission; None if it is valid."""
    problems = (
        (name.startswith("/"), "an absolute path"),
        ("\\" in name, "a backslash in a path"),
        (re.match(r"[A-Za-z]:", name), "a drive letter in a path"),
        (".." in name.split("/"), "a path that leads out of the folder"),
        (len(name) > LONGEST_PATH, f"a path of {len(name)} characters"),
        (not _NAME.fullmatch(name), "a hidden path or invalid characters"),
    )
    for wrong, got in problems:
        if wrong:
            return RefusedError(
                ascii(name[:LONGEST_PATH]),
                got=got,
                expected=f"up to {LONGEST_PATH} letters, digits and ._+-, with / between folders",
                hint="Remove or rename the file.",
            )
    return None


def _wrong_names(members: list[zipfile.ZipInfo]) -> Iterator[RefusedError]:
    names = [member.orig_filename for member in members]
    for member in members:
        if refused := wrong_name(member.orig_filename):
            yield refused
        # Python writes to `filename`. It can differ from the name in the archive: it ends at a null
        # byte, and newer versions of Python take it from the extra field 0x7075.
        elif member.filename != member.orig_filename:
            yield RefusedError(
                ascii(member.orig_filename),
                got=f"a second name, {member.filename[:LONGEST_PATH]!a}",
                expected="one name",
                hint=_HINT,
            )
    files = Counter(name.casefold() for name in names if not name.endswith("/"))
    folders = {str(parent) for name in names for parent in PurePosixPath(name.casefold()).parents}
    folders |= {name.casefold().rstrip("/") for name in names if name.endswith("/")}
    for name, times in files.items():
        if times > 1 or name in folders:
            yield RefusedError(
                ascii(name[:LONGEST_PATH]),
                got="a repeated name",
                expected="names that differ in more than upper and lower case",
                hint=_HINT,
            )


def _wrong_kinds(members: list[zipfile.ZipInfo]) -> Iterator[RefusedError]:
    for member in members:
        kind = stat.S_IFMT(member.external_attr >> 16)
        name = ascii(member.filename[:LONGEST_PATH])
        for wrong, got in (
            (kind == stat.S_IFLNK, "a link"),
            (kind not in (0, stat.S_IFREG, stat.S_IFDIR, stat.S_IFLNK), "a device or a pipe"),
            (member.flag_bits & 0x41, "an encrypted file"),
            (
                member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED),
                f"compression of kind {member.compress_type}",
            ),
            (member.filename.lower().endswith(_ARCHIVES), "an archive in an archive"),
        ):
            if wrong:
                yield RefusedError(name, got=got, expected="stored or deflated files", hint=_HINT)


def _wrong_sizes(members: list[zipfile.ZipInfo]) -> Iterator[RefusedError]:
    size = sum(member.file_size for member in members)
    if size > LARGEST_SUBMISSION:
        yield _too_large("its files", f"{size / 1e6:.1f} MB")


def _write(archive: zipfile.ZipFile, member: zipfile.ZipInfo, out: Path, left: int) -> int:
    """Extract a member, and return its size in bytes, which must be at most `left`."""
    out.parent.mkdir(parents=True, exist_ok=True)
    size = 0
    with archive.open(member) as packed, out.open("xb") as file:
        while chunk := packed.read(_CHUNK):
            size += len(chunk)
            if size > left:
                raise _too_large(member.filename, "more bytes than the archive states")
            file.write(chunk)
    return size
