"""NumPy's arrays, types and scalars as pickles describe them, built from parts that are checked first."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from typing import Any, Literal

import numpy as np

from solver_backend.exchange.errors import UnsafePickle

MAX_DIMENSIONS = 8
"""Dimensions of an array in a body file at most; SMPL's have three."""
_SIMPLE_DTYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248]|[SU]\d{1,4})")
_NUMPY_MODULES = ("numpy.core.multiarray", "numpy._core.multiarray")


class Damage(ValueError):
    """The pickle contradicts itself."""


@dataclass(frozen=True)
class PickledName:
    """A class or function that the pickle names."""

    module: str
    name: str

    @property
    def dotted(self) -> str:
        """Both in one."""
        return f"{self.module}.{self.name}"


@dataclass
class NamedDtype:
    """An array's type by its name and byte order."""

    spec: str
    order: Literal["<", ">", "=", "|"] = "="

    def dtype(self) -> np.dtype:
        """Return the type of plain numbers or text that is meant."""
        if not _SIMPLE_DTYPE.fullmatch(self.spec):
            raise Damage(f"an array has the type {self.spec!r}; plain numbers are expected")
        dtype = np.dtype(self.spec)
        return dtype.newbyteorder(self.order) if self.order in "<>" else dtype


class UnbuiltArray:
    """An array before its state is known; ``values`` is set by BUILD."""

    values: np.ndarray | None = None


def finished(value: Any) -> Any:
    """Return an array for what was built as one; a dictionary's values likewise."""
    if isinstance(value, UnbuiltArray):
        if value.values is None:
            raise Damage("an array has no values")
        return value.values
    if isinstance(value, dict):
        return {key: finished(item) if isinstance(item, UnbuiltArray) else item for key, item in value.items()}
    return value


def array_of(shape: Any, dtype: Any, by_columns: Any, data: Any) -> np.ndarray:
    """Return an array of plain numbers from its pickled state, after checking that the parts agree."""
    if not isinstance(dtype, NamedDtype) or not isinstance(shape, tuple) or len(shape) > MAX_DIMENSIONS:
        raise Damage("an array's state is not valid")
    if not all(isinstance(size, int) and 0 <= size < 2**40 for size in shape):
        raise Damage(f"an array has the shape {shape}")
    plain, content = dtype.dtype(), _bytes(data)
    if len(content) != prod(shape) * plain.itemsize:
        raise Damage(f"an array of shape {shape} and type {plain} has {len(content)} bytes")
    values = np.frombuffer(content, plain) if content else np.zeros(0, plain)
    return values.reshape(shape, order="F" if by_columns else "C").astype(plain.newbyteorder("="))


def _bytes(data: Any) -> bytes:
    """Return raw bytes; Python 2 pickled them as text."""
    if isinstance(data, str):
        return data.encode("latin1")
    if not isinstance(data, bytes | bytearray):
        raise Damage("an array's values are not bytes")
    return bytes(data)


def _empty_array(kind: Any = None, *_: Any) -> UnbuiltArray:
    if kind != PickledName("numpy", "ndarray"):
        raise Damage("an array of an unknown class")
    return UnbuiltArray()


def _dtype(spec: Any = None, *_: Any) -> NamedDtype:
    if not isinstance(spec, str):
        raise Damage("an array's type is not text")
    return NamedDtype(spec)


def _scalar(dtype: Any = None, data: Any = None, *_: Any) -> Any:
    return array_of((1,), dtype, False, data)[0]


def _encode(text: Any = None, encoding: Any = "latin1", *_: Any) -> bytes:
    """Return the bytes that Python 2 pickled as text."""
    if not isinstance(text, str) or encoding != "latin1":
        raise UnsafePickle(f"The pickle asks for the text encoding {encoding!r}; only latin1 occurs in body files.")
    return text.encode("latin1")


CALLS: dict[str, Callable[..., Any] | None] = {
    "numpy.ndarray": None, "numpy.dtype": _dtype, "_codecs.encode": _encode,
    "builtins.bytes": lambda: b"", "__builtin__.bytes": lambda: b"",
}  # fmt: skip
"""What a pickle may call; an array's class is only ever an argument."""
CALLS |= {f"{module}._reconstruct": _empty_array for module in _NUMPY_MODULES}
CALLS |= {f"{module}.scalar": _scalar for module in _NUMPY_MODULES}
