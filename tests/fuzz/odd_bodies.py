"""Bodies, weights and archives that are odd or forged: each is read or refused by name."""

from __future__ import annotations

import io
import pickle
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.body.oracle import model
from tests.fuzz.target import Write, file
from tests.support.pickle_bytes import array, attributes, chumpy, column, pickled, sparse, stand_in, text


def body(family: str, **arrays: object) -> Write:
    """Return what writes a body's ``.npz``, with some arrays changed, added or (None) left out."""
    kept = {key: value for key, value in model(family).items() if value.dtype != object}
    kept["shapedirs"], kept["posedirs"] = kept["shapedirs"][..., :10], np.float16(kept["posedirs"])
    kept |= {key: np.asarray(value) for key, value in arrays.items() if value is not None}
    kept = {key: value for key, value in kept.items() if arrays.get(key, 0) is not None}
    return lambda folder: np.savez(folder / "a.npz", **kept)


_SMPL, _SMPLH, _SMPLX = (model(family) for family in ("SMPL", "SMPL-H", "SMPL-X"))


def _tree(values: np.ndarray, joint: int, parent: int) -> np.ndarray:
    tree = np.array(values, dtype=np.int64)
    tree[0, joint] = parent
    return tree


SHOWN: tuple[Write, ...] = (
    file("b.npz", b""),
    body("SMPL", v_template=np.array(["a", "b"])),
    body("SMPL", weights=np.array(1.0)),
    body("SMPL", weights=_SMPL["weights"] * 0),
    body("SMPL", weights=_SMPL["weights"] * np.nan),
    body("SMPL", weights=_SMPL["weights"][:, :20]),
    body("SMPL", f=_SMPL["f"] + 10**6),
    body("SMPL", kintree_table=_tree(_SMPL["kintree_table"], 5, 1)),
    body("SMPL-H", weights=_SMPLH["weights"][:-1]),
    body("SMPL-H", kintree_table=_tree(_SMPLH["kintree_table"], 5, 40)),
)
RELAXED: tuple[Write, ...] = (
    body("SMPL"),
    body("SMPL-X", hands_meanl=None),
    body("SMPL-X", hands_meanl=np.full(45, np.nan)),
    body("SMPL-X", hands_meanr=np.zeros(7)),
)


def packed(change: Callable[[bytes], bytes] = bytes, kind: int = zipfile.ZIP_STORED, **members: bytes) -> Write:
    """Return what writes an archive whose members are these bytes, and changes it."""

    def write(folder: Path) -> None:
        out = io.BytesIO()
        with warnings.catch_warnings(), zipfile.ZipFile(out, "w", kind) as archive:
            warnings.simplefilter("ignore")
            for name, content in members.items():
                archive.writestr(f"{name}.npy", content)
        (folder / "a.npz").write_bytes(change(out.getvalue()))

    return write


def npy(shape: str, data: bytes = b"", kind: str = "'<f8'", magic: bytes = b"\x93NUMPY\x01\x00") -> bytes:
    """Return a member that claims a shape."""
    header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return magic + len(header).to_bytes(2, "little") + header + data


def _encrypted(data: bytes) -> bytes:
    """Return the archive with every member marked as encrypted, in both places where it says so."""
    for mark, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = data.find(mark)
        while at >= 0:
            data = data[: at + place] + b"\x01" + data[at + place + 1 :]
            at = data.find(mark, at + 4)
    return data


def _longer(data: bytes) -> bytes:
    """Return the archive whose directory says that its members are shorter than they are."""
    at = data.find(b"PK\x01\x02")
    return data[: at + 24] + (100).to_bytes(4, "little") + data[at + 28 :]


_GOOD = npy("(3,)", np.arange(3.0).tobytes())
ARCHIVES: tuple[Write, ...] = (
    packed(_encrypted, format=_GOOD),
    packed(kind=zipfile.ZIP_LZMA, format=_GOOD),
    packed(kind=zipfile.ZIP_BZIP2, format=_GOOD),
    packed(format=b"none", version=b""),
    packed(format=npy("(3,)", b"short")),
    packed(format=npy("(3,)", _GOOD * 3)),
    packed(format=npy("(2**70,)")),
    packed(format=npy("(1152921504606846976, 0)")),
    packed(format=npy("(100000000,)")),
    packed(format=npy("(-1,)")),
    packed(format=npy("(1,) * 40")),
    packed(format=npy("(" + "(" * 500)),
    packed(format=npy("(3,)", kind="'|O'")),
    packed(format=npy("(3,)", kind="[('a', '<f8')]")),
    packed(format=npy("(3,)", magic=b"\x93NUMPY\x09\x00")),
    packed(_longer, kind=zipfile.ZIP_DEFLATED, format=npy("(3,)", bytes(24))),
    packed(lambda data: data[:-30], format=_GOOD),
)
"""What is no archive of arrays, under a name that says so."""
MANY_MEMBERS = packed(**{f"m{i}": b"" for i in range(10_001)})
_THREE = column([1, 2, 3])
_MANY_BYTES = b"\x80\x02]q\x00" + b"h\x00a" * 20
_ARRAY_OF = {
    "shape": array(b"K\x03K\xff\x86", "f8", bytes(24)),
    "negative": array(b"J\xff\xff\xff\xff\x85", "f8", bytes(24)),
    "many": array(b"(" + b"K\x01" * 60 + b"t", "f8", bytes(8)),
    "object": array(b"K\x03\x85", "O8", bytes(24)),
    "text": array(b"K\x03\x85", "i4", bytes(12)).replace(b"B\x0c\0\0\0" + bytes(12), text("a" * 12)),
    "none": array(b"K\x03\x85", "i4", bytes(12)).replace(b"B\x0c\0\0\0" + bytes(12), b"N"),
    "class": array(b"K\x03\x85", "i4", bytes(12)).replace(b"cnumpy\nndarray\n", b"cnumpy\ndtype\n"),
    "unbuilt": b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R",
    "no dtype": b"cnumpy\ndtype\nK\x05\x85R",
    "no class": text("numpy") + b"K\x05\x93",
    "state": b"cnumpy\ndtype\n" + text("f8") + b"\x85RK\x01b",
    "codec": b"c_codecs\nencode\n" + text("a") + text("utf8") + b"\x86R",
    "code": b"cos\nsystem\n" + text("true") + b"\x85R",
    "called": text("a") + b"K\x01\x85R",
    "new": b"cnumpy\ndtype\n)\x81",
    "list": b"](K\x01K\x02e",
    "appended": b"K\x01K\x02a",
    "thrown away": b"(K\x01K\x021N",
    "no mark": b"t",
    "key": b"}(N}u",
    "list as a key": b"}]K\x01s",
    "persistent": text("x") + b"Q",
    "memo": b"h\x63",
    "nothing": b"0000",
}
PICKLES: tuple[bytes, ...] = (
    *(pickled(value) for value in _ARRAY_OF.values()),
    b"\x80\x02N",
    _MANY_BYTES + b".",
    sparse([0, 1], [0, 1, 2]),
    sparse([0, 7], [0, 1, 2]),
    pickled(stand_in("scipy.sparse.csc\ncsc_matrix", attributes(_shape=b"K\x02K\x02\x86", data=b"]", indices=_THREE))),
    chumpy(x=_THREE),
    chumpy(a=_THREE, idxs=column([2, 0]), preferred_shape=b"K\x02K\x01\x86"),
    chumpy(a=_THREE, idxs=column([1])),
    chumpy(),
    pickle.dumps([1, 2.5, None, True, "text", b"bytes", {1: (2, 3)}, 10**30], protocol=0),
    pickle.dumps({"a": np.float32(1), "b": np.array(["a", "bc"]), "c": np.asfortranarray(np.eye(3))}, protocol=2),
    pickle.dumps({"a": np.arange(3, dtype=">i4"), "b": {1, 2}, "c": frozenset({3})}, protocol=4),
    pickle.dumps({"a": [1, [2, 3], (4,)], "b": {"c": [5] * 5}}, protocol=2),
)


_ENCODED = b"c_codecs\nencode\nh\x01" + text("latin1") + b"\x86R0"
BOMB = file("a.pkl", b"\x80\x02" + text("a" * 3_000_000) + b"q\x010" + _ENCODED * 60 + b"N.")
"""A pickle that turns a text into bytes again and again."""
