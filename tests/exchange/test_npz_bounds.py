"""Forged archives: each is refused by name, without taking the memory or running the code that they ask for."""

from __future__ import annotations

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange import npz
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.npz import array_names, read_arrays, read_npz


def member(header: str | bytes, data: bytes = b"", version: int = 1) -> bytes:
    text = header if isinstance(header, bytes) else header.encode("latin-1")
    return b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H" if version == 1 else "<I", len(text)) + text + data


def described(kind: object, shape: object, data: bytes = b"") -> bytes:
    return member(repr({"descr": kind, "fortran_order": False, "shape": shape}) + "\n", data)


def archive(path: Path, method: int = zipfile.ZIP_STORED, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", method) as out:
        for name, content in members.items():
            out.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize(
    "content",
    [
        described("<f8", (2**60,)), described("<f8", (2**40, 0)), described("<f8", (10,), bytes(8)),
        described("<f8", (1,), bytes(16)), described("<f8", (-1,), bytes(8)), described("<f8", [1], bytes(8)),
        described("<f8", (True,), bytes(8)), described("<f8", (1,) * 9, bytes(8)), described("<U999999999", (1,)),
        member("{'descr': '<f8', 'fortran_order': 7, 'shape': (1,)}", bytes(8)), member("__import__('os').abort()"),
        member("(" * 5000), member("{'descr': '<f8'}"), b"no array", b"", member(b"\xff", version=3),
        described("<U2", (), b"\0\0\x11\0" + bytes(4)), described(">U1", (1,), b"\xff\0\0\0"),
        b"\x93NUMPY\x02\x00\xff\xff\xff\x7f", b"\x93NUMPY\x09\x00\x00\x00",
    ],
)  # fmt: skip
def test_forged_members_are_named(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(FileDamaged, match=r"'a'.*x\.npz"):
        read_npz(archive(tmp_path / "x.npz", a=content))


@pytest.mark.parametrize("kind", ["|O", "<M8[s]", [("x", "<f8")], "|V8", None])
def test_arrays_that_are_not_plain_are_left_out_or_named(tmp_path: Path, kind: object) -> None:
    path = archive(tmp_path / "x.npz", a=described(kind, (1,), bytes(8)), b=described("<i4", (1,), b"\7\0\0\0"))
    assert {name: value.tolist() for name, value in read_npz(path).items()} == {"b": [7]}
    with pytest.raises(FileDamaged, match="need pickle"):
        read_arrays(path, required=("a",))


def test_what_is_not_wanted_is_not_read(tmp_path: Path) -> None:
    path = archive(tmp_path / "x.npz", a=b"damaged", b=described("<i4", (1,), b"\7\0\0\0"))
    assert array_names(path) == {"a", "b"}
    assert list(read_npz(path, {"b"}.__contains__)) == ["b"]
    assert list(read_arrays(path, required=("b",))) == ["b"]


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(npz, "MIN_ALLOWANCE", 2**16)
    path = archive(tmp_path / "x.npz", zipfile.ZIP_DEFLATED, a=described("<f8", (2**17,), bytes(2**20)))
    assert path.stat().st_size < 4096
    with pytest.raises(FileDamaged, match="'a' would take 1,048,576 bytes, far more than a file of this size contains"):
        read_npz(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_other_packings_are_named(tmp_path: Path, method: int) -> None:
    with pytest.raises(FileDamaged, match="'a' is packed by method"):
        read_npz(archive(tmp_path / "x.npz", method, a=described("<f8", (1,), bytes(8))))


def test_encrypted_members_are_named(tmp_path: Path) -> None:
    path = archive(tmp_path / "x.npz", a=described("<f8", (1,), bytes(8)))
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        data[data.index(signature) + offset] |= 1
    path.write_bytes(data)
    with pytest.raises(FileDamaged, match="'a' is encrypted"):
        read_npz(path)


def test_a_million_members_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(npz, "MOST_MEMBERS", 3)
    with pytest.raises(FileDamaged, match="4 members, but the limit is 3"):
        read_npz(archive(tmp_path / "x.npz", a=b"", b=b"", c=b"", d=b""))


@pytest.mark.parametrize(
    "values",
    [
        np.zeros((0, 3)), np.arange(6.0).reshape(2, 3).T, np.array("ä"), np.array(["a", "bc"]), np.array(b"x"),
        np.array(True), np.arange(3, dtype=">i2"), np.array(1 + 2j), np.arange(4, dtype=np.float16), np.array(""),
    ],
)  # fmt: skip
def test_what_numpy_writes_is_read_as_numpy_reads_it(tmp_path: Path, values: np.ndarray) -> None:
    for number, write in enumerate((np.savez, np.savez_compressed)):
        stream = io.BytesIO()
        write(stream, a=values)
        path = tmp_path / f"{number}.npz"
        path.write_bytes(stream.getvalue())
        found = read_npz(path)["a"]
        assert found.dtype == values.dtype
        assert found.shape == values.shape
        np.testing.assert_array_equal(found, values)


def test_an_array_that_is_required_and_optional_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, read = archive(tmp_path / "x.npz", a=described("<i4", (1,), b"\7\0\0\0")), []
    once = npz.Members.read
    monkeypatch.setattr(npz.Members, "read", lambda self, name: (read.append(name), once(self, name))[1])
    assert read_arrays(path, required=("a",), optional=("a", "b"))["a"] == 7 and read == ["a"]
