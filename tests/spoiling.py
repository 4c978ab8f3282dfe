"""Ways to spoil a submission, for the fuzz run: bytes, fields, tables, networks."""

import os
import re
import shutil
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random

import numpy as np
import onnx
import pyarrow as pa
from onnx import TensorProto, helper
from pyarrow import parquet

Spoil = Callable[[Path, Random], None]

VALUES = [
    '""', '" "', "0", "-1", "1e999", "nan", "true", "[]", "{}", "9" * 50, "9" * 5000, "[" * 3000,
    '"../../x"', '"/etc/passwd"', '"<script>alert(1)</script>"', '"\\u202e"', '"\\u0000"',
    '"' + "x" * 10_000 + '"', "1979-05-27T07:32:00Z", '["a", 1]', '["plaza-v0", "eth-v0"]',
    "'''\n'''", '"full"',
    '"none"', '"spawn"', '"crowd"', '"walk"', '"os:system"', '"social-force"', '"replay"', '"bc"',
    "0x" + "f" * 6000, '"plaza-v0"', "\x00",
]  # fmt: skip
LINES = [
    "colour = 1", "[training.more]", "[[training]]", "a.b.c = 1", 'shipped_policy = "straight"',
    'shipped_spawn = "replay"', "[a]\n" * 50, "x = " + "{a=" * 500, "\ufeff", 'name = "again"',
]  # fmt: skip
NUMBERS = [
    b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"1e999", b"NaN", b"null", b'"x"', b"[]", b"{}",
    b"9" * 30, b"9" * 400, b"[" * 2000, b"true", b"-0.0", b"2147483648", b"9223372036854775808",
]  # fmt: skip
CHUNKS = [
    b"\xff" * 8, b"\0" * 8, b"\x7f" + b"\xff" * 7, struct.pack("<Q", 2**40), struct.pack("<i", -1),
    b"PK\x03\x04", b"PAR1", b"9" * 40, b",,,,", b"\n\n", b'"', b"\r", b"\x1b[2J", b"../", b"=",
]  # fmt: skip
NAMES = [
    "../evil", "/tmp/crowdbench-evil", "C:\\evil", "a\\..\\evil", "plaza-v0/../../evil", "a\0b",
    "\u202ecod", "x" * 300, "submission.toml", "SUBMISSION.TOML", "plaza-v0", "a/" * 60 + "b", "..",
    "plaza-v0/policy/fold0.onnx", "plaza-v0/policy/fold0.onnx/x", "inner.zip", ".hidden", " ",
    "plaza-v0/trajectories/7.csv", "policy.onnx", "eth-v0/policy/fold0.onnx", "\x1b[2J", "NUL",
    "-rf", "a b", "é",
]  # fmt: skip


def spoilt(sound: Path, place: Path, rng: Random) -> tuple[Path, str]:
    """A spoilt copy of a submission in `place`, and how it was spoilt."""
    folder = place / "submission"
    shutil.copytree(sound, folder)
    done = []
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        spoil = rng.choice(OF_FOLDERS)
        with suppress(Exception):  # what is spoilt already may not take more
            spoil(folder, rng)
        done.append(spoil.__name__)
    return folder, f"{sound.name}: {', '.join(done)}"


def _files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file() and not p.is_symlink())


def _chosen(folder: Path, rng: Random, suffix: str = "") -> Path | None:
    there = [p for p in _files(folder) if p.name.endswith(suffix)]
    return rng.choice(there) if there else None


def flip(folder: Path, rng: Random) -> None:
    if file := _chosen(folder, rng):
        file.write_bytes(_flipped(file.read_bytes(), rng))


def _flipped(whole: bytes, rng: Random) -> bytes:
    data = bytearray(whole)
    # Headers stand at the ends of files, and matter more than what is between.
    near = [rng.randrange(200), -rng.randrange(1, 200), rng.randrange(2**30)]
    for _ in range(rng.choice([1, 2, 20])) if data else ():
        data[rng.choice(near) % len(data)] = rng.choice([0, 255, 127, 128, rng.randrange(256)])
        near[2] = rng.randrange(2**30)
    return bytes(data)


def cut(folder: Path, rng: Random) -> None:
    if file := _chosen(folder, rng):
        data = file.read_bytes()
        at = rng.randrange(len(data) + 1)
        file.write_bytes(rng.choice([data[:at], data[at:], b""]))


def insert(folder: Path, rng: Random) -> None:
    if file := _chosen(folder, rng):
        data = file.read_bytes()
        at = rng.choice([0, min(8, len(data)), rng.randrange(len(data) + 1), len(data)])
        chunk = rng.choice([rng.choice(CHUNKS), rng.randbytes(30), data[at : at + 1000]])
        file.write_bytes(data[:at] + chunk * rng.choice([1, 1, 100]) + data[at:])


def overwrite(folder: Path, rng: Random) -> None:
    if file := _chosen(folder, rng):
        data = file.read_bytes()
        chunk = rng.choice(CHUNKS)
        at = rng.randrange(max(1, min(len(data), rng.choice([64, 10**9]))))
        file.write_bytes(data[:at] + chunk + data[at + len(chunk) :])


def field(folder: Path, rng: Random) -> None:
    file = folder / "submission.toml"
    lines = file.read_bytes().split(b"\n") if file.is_file() else []
    fields = [k for k, line in enumerate(lines) if b" = " in line]
    if fields:
        k = rng.choice(fields)
        lines[k] = lines[k].split(b" = ")[0] + b" = " + rng.choice(VALUES).encode()
        file.write_bytes(b"\n".join(lines))


def line(folder: Path, rng: Random) -> None:
    file = folder / "submission.toml"
    if file.is_file():
        lines = file.read_bytes().split(b"\n")
        at = rng.randrange(len(lines))
        dropped = rng.random() < 0.3
        lines[at : at + dropped] = [] if dropped else [rng.choice(LINES).encode()]
        file.write_bytes(b"\n".join(lines))


def number(folder: Path, rng: Random) -> None:
    if file := _chosen(folder, rng, rng.choice([".json", ".csv", ".safetensors"])):
        data = file.read_bytes()
        found = list(re.finditer(rb"-?\d+(\.\d+)?", data[: 2**16]))
        if found:
            where = rng.choice(found)
            file.write_bytes(data[: where.start()] + rng.choice(NUMBERS) + data[where.end() :])


def move(folder: Path, rng: Random) -> None:
    if file := _chosen(folder, rng):
        name = rng.choice(["x.txt", "a b", "é.onnx", "\x1b[2J.csv", "\n", "y" * 120, *NAMES[9:12]])
        other = rng.choice([folder, file.parent, folder / "plaza-v0" / "policy"]) / name
        if not other.exists() and len(name) < 200:
            other.parent.mkdir(parents=True, exist_ok=True)
            rng.choice([shutil.move, shutil.copy])(file, other)


def swap(folder: Path, rng: Random) -> None:
    one, other = _chosen(folder, rng), _chosen(folder, rng)
    if one and other:
        first, second = one.read_bytes(), other.read_bytes()
        one.write_bytes(second)
        other.write_bytes(rng.choice([first, second]))


def replace(folder: Path, rng: Random) -> None:
    """Something that is no file where a file was."""
    if file := _chosen(folder, rng):
        file.unlink()
        kind = rng.randrange(5)
        if kind == 0:
            file.symlink_to(
                rng.choice(["/etc/passwd", "/dev/zero", file.name, "../submission.toml"])
            )
        elif kind == 1:
            os.mkfifo(file)
        elif kind == 2:
            file.mkdir()
        elif kind == 3:
            with file.open("wb") as sparse:
                sparse.truncate(rng.choice([70_000, 21_000_000, 61_000_000, 201_000_000]))


def many(folder: Path, rng: Random) -> None:
    for k in range(rng.choice([1, 1, 10, 450])):
        (folder / f"{k}.csv").write_bytes(b"")


def table(folder: Path, rng: Random) -> None:
    """Another column, type, value, row or length in a table."""
    file = _chosen(folder, rng, ".parquet")
    if file is None:
        return
    made = parquet.read_table(file)
    k = rng.randrange(made.num_columns)
    name, column = made.column_names[k], made.column(k)
    kind = rng.randrange(8)
    if kind == 0:
        made = made.drop_columns([name])
    elif kind == 1:
        made = made.rename_columns([rng.choice(made.column_names) if c == name else c
                                    for c in made.column_names])  # fmt: skip
    elif kind == 2:
        values = column.to_numpy().astype(np.float64)
        values[rng.randrange(len(values)) :] = rng.choice(
            [np.nan, np.inf, 1e30, -1.0, 2.0**62, 1e6]
        )
        made = made.set_column(k, name, pa.array(values))
    elif kind == 3:
        other = rng.choice([pa.string(), pa.float32(), pa.decimal128(30, 2), pa.binary()])
        try:
            made = made.set_column(k, name, column.cast(pa.float64()).cast(other))
        except pa.ArrowException:
            made = made.set_column(k, name, pa.nulls(len(made), other))
    elif kind == 4:
        text = rng.choice([b"", b"{}", b"[" * 5000, b'{"schema": 1}', b"\xff"])
        good = (made.schema.metadata or {}).get(b"crowdbench", b"{}")
        hostile = re.sub(rb"\d+", rng.choice(NUMBERS).replace(b"\\", b""), good, count=0)
        made = made.replace_schema_metadata({b"crowdbench": rng.choice([text, hostile])})
    elif kind == 5:
        times = rng.choice([0, 2, 100_000])
        made = made.take(pa.array([rng.randrange(len(made))] * times, pa.int64()))
    elif kind == 6:
        made = pa.concat_tables([made] * rng.choice([2, 300]))
    else:
        more = pa.array(["x" * 1000] * len(made)).dictionary_encode()
        made = made.append_column(rng.choice(["note", "time_s", " x"]), more)
    parquet.write_table(made, file, compression=rng.choice(["none", "zstd", "gzip", "snappy"]))


def network(folder: Path, rng: Random) -> None:
    """Another operator, shape, weight or card in a network."""
    file = _chosen(folder, rng, ".onnx")
    if file is None:
        return
    model = onnx.load(file)
    graph = model.graph
    node, weights = graph.node[0], graph.initializer[0]
    kind = rng.randrange(9)
    if kind == 0:
        node.op_type = rng.choice(
            ["Gemm", "Loop", "If", "Nothing", "Einsum", "Add", "Identity", ""]
        )
    elif kind == 1:
        node.domain = rng.choice(["com.microsoft", "evil", "ai.onnx.ml", "\x1b[2J"])
    elif kind == 2:
        weights.dims[rng.randrange(2)] = rng.choice([0, -1, 2**31, 2**62, 3])
    elif kind == 3:
        weights.data_location = TensorProto.EXTERNAL
        entry = weights.external_data.add()
        entry.key, entry.value = "location", rng.choice(["/etc/passwd", "../x", "weights.bin"])
    elif kind == 4:
        model.opset_import[0].version = rng.choice([0, 1, 6, 9999, 2**62, -1])
    elif kind == 5:
        entry = model.metadata_props[0]
        old = rng.choice(['"plaza-v0"', '"fold0"', "8", '"lidar-2"', "10.0", '"tiny"', "1"])
        new = rng.choice([*NUMBERS, b'"fold2"', b'"full"', b'"x"', b'"\\u001b[2J"']).decode()
        entry.value = entry.value.replace(old, new)
    elif kind == 6:
        size = rng.choice([10**6, 10**9, 2**40, 2**62])
        graph.initializer.append(helper.make_tensor("size", TensorProto.INT64, [1], [size]))
        graph.node.insert(0, helper.make_node("ConstantOfShape", ["size"], ["huge"]))
        graph.node.insert(1, helper.make_node("ReduceSum", ["huge"], ["sum"], keepdims=0))
        node.output[0] = "before"
        graph.node.append(helper.make_node("Add", ["before", "sum"], ["action"]))
    elif kind == 7:
        data = np.frombuffer(weights.raw_data, np.float32).copy()
        data[rng.randrange(len(data))] = rng.choice([np.nan, np.inf, 1e38, 0.1])
        weights.raw_data = data.tobytes()
    else:
        shape = rng.choice([graph.input[0], graph.output[0]]).type.tensor_type.shape
        shape.dim[rng.randrange(2)].dim_value = rng.choice([-1, 0, 3, 2**40])
    file.write_bytes(model.SerializeToString())


OF_FOLDERS: list[Spoil] = [
    flip, flip, cut, insert, overwrite, field, field, field, line, number, number, move, swap,
    replace, many, table, table, network, network,
]  # fmt: skip
