"""Pickles put together operation by operation, as forgers and old programs write them."""

from __future__ import annotations

import struct

import numpy as np


def text(value: str) -> bytes:
    raw = value.encode()
    return b"X" + struct.pack("<I", len(raw)) + raw


def array(shape: bytes, dtype: str, data: bytes) -> bytes:
    """Return the operations that build one array; ``shape`` is operations that push a tuple."""
    empty = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
    kind = (
        b"cnumpy\ndtype\n"
        + text(dtype)
        + b"\x89\x88\x87R(K\x03"
        + text("<")
        + b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
    )
    return empty + b"(K\x01" + shape + kind + b"\x89" + b"B" + struct.pack("<I", len(data)) + data + b"tb"


def stand_in(name: str, state: bytes) -> bytes:
    return f"c{name}\n".encode() + b")\x81" + state + b"b"


def attributes(**members: bytes) -> bytes:
    return b"}" + b"".join(text(name) + value + b"s" for name, value in members.items())


def pickled(value: bytes) -> bytes:
    return b"\x80\x02}" + text("v_template") + value + b"s."


def column(values: list[int]) -> bytes:
    """Return the operations that build a list of whole numbers as an array."""
    return array(b"K" + bytes([len(values)]) + b"\x85", "i4", np.array(values, "<i4").tobytes())


def sparse(indices: list[int], pointers: list[int], rows: bytes = b"K\x02") -> bytes:
    """Return a model whose template is SciPy's compressed matrix of two columns."""
    parts = {
        "_shape": rows + b"K\x02\x86", "data": column([1, 1]), "indices": column(indices), "indptr": column(pointers),
    }  # fmt: skip
    return pickled(stand_in("scipy.sparse.csc\ncsc_matrix", attributes(**parts)))


def chumpy(**members: bytes) -> bytes:
    """Return a model whose template is one of chumpy's arrays."""
    return pickled(stand_in("chumpy.ch\nCh", attributes(**members)))
