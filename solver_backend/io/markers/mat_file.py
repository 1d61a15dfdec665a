"""Read MATLAB files of versions 5 to 7.2 (MathWorks), within memory limits."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged
from solver_backend.exchange.npz import ALLOWANCE, MIN_ALLOWANCE
from solver_backend.exchange.outputs import open_regular, require_file

_HEADER, _TAG = 128, 8
"""Size in bytes of the file header and of an element tag."""
_MOST_ELEMENTS, _DEEPEST, _MOST_AXES = 200_000, 20, 8
"""Largest number of matrices in a file, nesting depth of structures and cells, and number of array axes. Chosen by
hand. QTM files have a few hundred matrices."""
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""NumPy type for each element type."""
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
"""Text encoding for each element type."""
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR, _OPAQUE = 1, 2, 4, 17
_NUMERIC = range(6, 16)  # Classes of dense numeric arrays. Objects, functions and sparse matrices are skipped.
_LEFT_OUT = object()


def read_mat(path: Path) -> dict[str, Any]:
    """Read the variables in a MATLAB file. Return them by name.

    Numbers are returned as arrays of their stored type, texts as ``str``, cells as lists, and structures as
    dictionaries or lists of dictionaries. Objects, sparse matrices and imaginary parts are ignored.

    Raises:
        FileMissing: the file does not exist.
        CaptureNotRecognised: the file has MATLAB version 7.3 (HDF5).
        FileDamaged: the file is of another type, truncated, or needs far more memory than its size allows.
    """
    require_file(path)
    with open_regular(path) as stream:
        data = stream.read()
    if data[:10] == b"MATLAB 7.3" or data[512:516] == b"\x89HDF":
        hint = "Save it in MATLAB with save(name, '-v7'), or export C3D or TSV from QTM."
        what = "The file is not supported: MATLAB 7.3 (HDF5)."
        raise CaptureNotRecognised(what, where=str(path), hint=hint)
    try:
        if data[126:128] not in (b"IM", b"MI"):
            raise ValueError("it has no header of version 5")
        order = "<" if data[126:128] == b"IM" else ">"
        return _ElementReader(order, max(MIN_ALLOWANCE, ALLOWANCE * len(data))).variables(memoryview(data)[_HEADER:])
    except (ValueError, zlib.error, struct.error) as error:
        what = f"The file is truncated or is not a MATLAB file of version 5 to 7.2 ({error})."
        raise FileDamaged(what, where=str(path), hint="Export it again, or as C3D or TSV.") from error


@dataclass
class _ElementReader:
    order: str  # Byte order, "<" or ">".
    bytes_left: int
    elements_left: int = _MOST_ELEMENTS

    def variables(self, data: memoryview) -> dict[str, Any]:
        """Read the variables from the data after the file header."""
        found: dict[str, Any] = {}
        while len(data):
            kind, content, data = self._element(data, padded=False)
            if kind == _COMPRESSED:
                kind, content, _ = self._element(self._unpacked(content))
            if kind == _MATRIX:
                name, value = self._matrix(content, 0)
                if value is not _LEFT_OUT:
                    found[name] = value
        return found

    def _unpacked(self, content: memoryview) -> memoryview:
        unpack = zlib.decompressobj()
        data = unpack.decompress(content, self.bytes_left)
        if unpack.unconsumed_tail or not unpack.eof:
            raise ValueError("a packed variable is truncated, or far larger than a file of this size contains")
        self.bytes_left -= len(data)
        return memoryview(data)

    def _element(self, data: memoryview, *, padded: bool = True) -> tuple[int, memoryview, memoryview]:
        """Split off the first element. Return its type, its content and the remaining data."""
        if len(data) < _TAG:
            raise ValueError("it ends within an element")
        kind, size = struct.unpack_from(f"{self.order}II", data)
        if kind >> 16:  # up to four bytes are stored within the tag
            kind, size = kind & 0xFFFF, kind >> 16
            start, end = 4, _TAG
        else:
            # Packed elements in a file are not padded, and its matrices have sizes that need no padding.
            start, end = _TAG, _TAG + (-(-size // _TAG) * _TAG if padded else size)
        if start + size > len(data):
            raise ValueError("it ends within an element")
        return kind, data[start : start + size], data[end:]

    def _numbers(self, data: memoryview, least: int = 0) -> tuple[np.ndarray, memoryview]:
        kind, content, data = self._element(data)
        if kind not in _NUMBERS:
            raise ValueError(f"an element has the type {kind} instead of numbers")
        dtype = np.dtype(self.order + _NUMBERS[kind])
        if len(content) % dtype.itemsize or len(content) < least * dtype.itemsize:
            raise ValueError(f"an element has {len(content)} bytes")
        return np.frombuffer(content, dtype), data

    def _matrix(self, data: memoryview, depth: int) -> tuple[str, Any]:
        self.elements_left -= 1
        if self.elements_left < 0 or depth > _DEEPEST:
            raise ValueError("it has too many values, or values that are nested too deeply")
        if not len(data):
            return "", np.zeros((0, 0))
        flags, data = self._numbers(data, least=2)
        if int(flags[0]) & 0xFF == _OPAQUE:  # a MATLAB object (string, table, datetime), which has no shape
            return "", _LEFT_OUT
        axes, data = self._numbers(data, least=2)
        name, data = self._numbers(data)
        shape, kind = tuple(int(length) for length in axes), int(flags[0]) & 0xFF
        if len(shape) > _MOST_AXES or min(shape) < 0:
            raise ValueError(f"a matrix has the shape {str(shape)[:80]}")
        return name.tobytes().decode("latin-1"), self._value(kind, shape, data, depth)

    def _value(self, kind: int, shape: tuple[int, ...], data: memoryview, depth: int) -> Any:
        count = prod(shape)
        if kind in _NUMERIC:
            values, _ = self._numbers(data)
            if len(values) != count:
                raise ValueError(f"a matrix of shape {shape} has {len(values)} numbers")
            return values.reshape(shape, order="F")
        if kind == _CHAR:
            return self._text(data, shape)
        if kind == _CELL:
            return self._members(data, count, depth)
        if kind != _STRUCT:
            return _LEFT_OUT
        length, data = self._numbers(data, least=1)
        names, data = self._numbers(data)
        width = int(length[0])
        if not 0 < width <= 64 or len(names) % width:
            raise ValueError(f"the names of a structure have {len(names)} bytes, {width} each")
        keys = [part.tobytes().partition(b"\0")[0].decode("latin-1") for part in names.reshape(-1, width)]
        if not keys:
            return {}
        values = self._members(data, count * len(keys), depth)
        made = [dict(zip(keys, values[n : n + len(keys)], strict=True)) for n in range(0, len(values), len(keys))]
        return made[0] if count == 1 else made

    def _members(self, data: memoryview, count: int, depth: int) -> list[Any]:
        if count > self.elements_left:
            raise ValueError(f"a cell or structure has {count:,} values")
        values: list[Any] = []
        for _ in range(count):
            kind, content, data = self._element(data)
            if kind != _MATRIX:
                raise ValueError(f"a cell or structure has an element of the type {kind}")
            value = self._matrix(content, depth + 1)[1]
            values.append(None if value is _LEFT_OUT else value)
        return values

    def _text(self, data: memoryview, shape: tuple[int, ...]) -> str | list[str]:
        kind, content, _ = self._element(data)
        if kind not in _TEXTS:
            raise ValueError(f"a text has the type {kind}")
        coding = _TEXTS[kind]
        coding += {"<": "-le", ">": "-be"}[self.order] if coding in ("utf-16", "utf-32") else ""
        text = bytes(content).decode(coding, "replace")
        if len(shape) != 2 or shape[0] < 2 or shape[0] > len(text):
            return text
        return [text[row :: shape[0]].rstrip() for row in range(shape[0])]
