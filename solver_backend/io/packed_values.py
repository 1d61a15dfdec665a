"""Read arrays from PyTorch, joblib, pickle and NumPy files without running any code in them.

In PyTorch 2, ``torch.save`` writes a zip with ``data.pkl`` and ``data/KEY``. Before version 1.6, it wrote pickles with
a magic number, the version, the system, the content and the keys, followed by the numbers. ``joblib.dump`` (1.4) writes
a pickle in which each array, plain or compressed, follows its description. ``numpy.save`` writes objects.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from solver_backend.body.files.restricted_pickle import (
    MAX_DIMENSIONS,
    Damage,
    Dialect,
    Machine,
    NamedDtype,
    PickledName,
    StandIn,
    UnbuiltArray,
    finished,
)
from solver_backend.exchange.errors import FileDamaged, UnsafePickle
from solver_backend.exchange.outputs import open_regular
from solver_backend.io.files import read_bytes

SUFFIXES = (".pt", ".pth", ".pkl", ".pickle", ".joblib")  # Lower-case suffixes of such files.
_LARGEST, _LARGEST_ARRAY = 4_000_000_000, 1 << 30  # Size limits in bytes of a file and its contents, and of an array.
_DEEPEST, _ITEM = 50, 64  # Deepest nesting of lists and dictionaries, and bytes counted per item.
_MOST_OPERATIONS = 30_000_000  # Largest number of pickle operations. PHALP needs a few thousand per frame.
_ITEMS = {"Float": "<f4", "Double": "<f8", "Half": "<f2", "Long": "<i8", "Int": "<i4", "Short": "<i2", "Char": "i1"}
_ITEMS |= {"Byte": "u1", "Bool": "b1", "BFloat16": "<u2"}
"""NumPy type of each PyTorch storage class. A BFloat16 is the upper half of a float."""
_WIDEST = 8  # Largest number of bytes per number.
_MAGIC = 0x1950A86A20F9469CFC6C  # First number in older PyTorch files.
_WRAPPER = "joblib.numpy_pickle.NumpyArrayWrapper"
_DAMAGE = (OSError, EOFError, ValueError, TypeError, KeyError, IndexError, OverflowError, RecursionError, MemoryError)
_DAMAGE += (zipfile.BadZipFile, zlib.error, struct.error, AttributeError, NotImplementedError, RuntimeError)


@dataclass(frozen=True)
class Stored:
    """An array in a file that is loaded on first use."""

    read: Callable[[], np.ndarray]
    size: int = 0  # Largest size in bytes.


def numbers(value: Any) -> np.ndarray:
    """Convert an array, a ``Stored`` array, a number, or nested lists of these to an array.

    Raises:
        ValueError: the value has another type or is damaged.
    """
    try:
        value = finished(value)
        if isinstance(value, list | tuple):
            return np.array([numbers(item) for item in value])
        found = np.asarray(value.read() if isinstance(value, Stored) else value)
    except _DAMAGE as error:
        raise ValueError(str(error)) from error
    if found.dtype.kind not in "fiub":
        raise ValueError(f"numbers are expected instead of {type(value).__name__}")
    return found


def read_packed(path: Path) -> Any:
    """Read the nested dictionaries and lists in a file. Each array is a ``Stored``.

    Raises:
        UnsafePickle: the file requests a class or function that arrays do not need.
        FileMissing, FileDamaged: the file is missing, damaged or too large.
    """
    try:
        content = _content(path)
        if _expanded(content, {}) > _LARGEST:
            raise Damage(f"its lists expand to more than {_LARGEST:,} bytes")
        return content
    except UnsafePickle:
        raise
    except _DAMAGE as error:
        what = f"The network result cannot be read: {error}"
        raise FileDamaged(what, where=str(path), hint="The file may be truncated. Copy or write it again.") from error


def _content(path: Path) -> Any:
    with open_regular(path) as stream:
        head = stream.read(8)
        if stream.seek(0, 2) > _LARGEST:
            raise Damage(f"it has more than {_LARGEST:,} bytes")
        if head[:4] == b"PK\x03\x04":
            return _zipped_torch(path, stream)
        if head[:1] == b"\x78":
            return _follow(BytesIO(_inflated(read_bytes(path))), path)
        if head[:6] == b"\x93NUMPY":
            return _follow(BytesIO(read_bytes(path)[_header_size(head, path) :]), path)
        content = _follow(stream, path)
    return _older_torch(read_bytes(path), path) if content == _MAGIC else content


def _expanded(value: Any, known: dict[int, int], deep: int = 0) -> int:
    """Return the size in bytes of nested content if every shared list and array were stored once per use."""
    value = finished(value) if isinstance(value, UnbuiltArray) else value
    if isinstance(value, Stored | np.ndarray):
        return value.size if isinstance(value, Stored) else value.nbytes
    if not isinstance(value, dict | list | tuple):
        return 0
    if id(value) not in known:
        if deep > _DEEPEST:
            raise Damage("its lists are nested too deeply")
        items = value.values() if isinstance(value, dict) else value
        known[id(value)] = sum(_ITEM + _expanded(item, known, deep + 1) for item in items)
    return known[id(value)]


def _follow(
    stream: BinaryIO | BytesIO, path: Path, storage: Callable[[Any], Any] | None = None, least: int | None = None
) -> Any:
    """Decode the pickle at the stream's position. ``storage`` returns the values of a tensor.

    ``least`` is the memory allowed for the arrays in a small file. None uses the default.
    """
    held = stream if isinstance(stream, BytesIO) else None

    def behind(wrapper: StandIn, stream: BinaryIO | BytesIO) -> Stored:
        return _behind(wrapper, stream, held, path)

    dialect = replace(_DIALECT, persistent=storage, inline=behind)
    dialect = dialect if least is None else replace(dialect, least=least)
    return Machine(stream, str(path), frozenset({_WRAPPER}), dialect).load()


def _behind(wrapper: StandIn, stream: BinaryIO | BytesIO, held: BytesIO | None, path: Path) -> Stored:
    """Return the joblib array that follows its description in the stream. Move the stream to the end of the array."""
    shape, dtype = wrapper.state.get("shape"), wrapper.state.get("dtype")
    if not isinstance(dtype, NamedDtype):
        raise Damage("an array's description is not valid")
    size, plain = _bytes_of(shape, 1) * dtype.dtype().itemsize, dtype.dtype()
    if wrapper.state.get("numpy_array_alignment_bytes") is not None:
        stream.seek(stream.read(1)[0], 1)
    at = stream.tell()
    if stream.seek(0, 2) < at + size:
        raise Damage("an array is cut off")
    stream.seek(at + size)
    order: Any = "F" if wrapper.state.get("order") == "F" else "C"

    def read() -> np.ndarray:
        with _opened(held, path) as source:
            source.seek(at)
            return np.frombuffer(source.read(_bounded(size)), plain).reshape(tuple(shape or ()), order=order)

    return Stored(read, size)


@contextmanager
def _opened(held: BytesIO | None, path: Path) -> Iterator[BinaryIO | BytesIO]:
    if held is not None:
        yield held
    else:
        with open_regular(path) as stream:
            yield stream


def _bytes_of(shape: Any, item: int) -> int:
    good = isinstance(shape, tuple) and len(shape) <= 8 and all(isinstance(n, int) and 0 <= n < 2**40 for n in shape)
    if not good:
        raise Damage("an array's shape is not valid")
    return prod(shape) * item


def _bounded(size: int) -> int:
    if size > _LARGEST_ARRAY:
        raise Damage(f"an array has {size:,} bytes")
    return size


def _tensor(storage: Any = None, offset: Any = 0, shape: Any = (), strides: Any = (), *_: Any) -> Stored:
    """Build a tensor from its storage, as PyTorch's ``_rebuild_tensor_v2`` does."""
    count, reach = _bytes_of(shape, 1), _bytes_of((offset,), 1)
    steps = [_bytes_of((step,), 1) for step in strides]
    reach += sum((n - 1) * step for n, step in zip(shape, steps, strict=True))

    def read() -> np.ndarray:
        values = storage.read()
        if not count:
            return np.zeros(shape, values.dtype)
        _bounded(count * values.itemsize)
        if reach >= len(values):
            raise Damage("a tensor reaches beyond its numbers")
        strided = np.lib.stride_tricks.as_strided(
            values[offset:], shape, [step * values.itemsize for step in steps], writeable=False
        )
        return strided.copy()

    return Stored(read, _WIDEST * count)


def _zipped_torch(path: Path, stream: BinaryIO) -> Any:
    with zipfile.ZipFile(stream) as archive:
        (top,) = (entry for entry in archive.infolist() if entry.filename.endswith("data.pkl"))
        content, folder = archive.read(_small(top)), top.filename.removesuffix("data.pkl")

    def storage(key: Any) -> Stored:
        _, kind, name, _, count = key

        def read() -> np.ndarray:
            with open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
                return _values(archive.read(_small(archive.getinfo(f"{folder}data/{name}"))), kind, count)

        return Stored(read)

    return _follow(BytesIO(content), path, storage)


def _small(entry: zipfile.ZipInfo) -> zipfile.ZipInfo:
    if entry.compress_type != zipfile.ZIP_STORED:
        raise Damage("its entries are compressed, but PyTorch never compresses entries")
    _bounded(entry.file_size)
    return entry


def _older_torch(data: bytes, path: Path, least: int | None = None) -> Any:
    """Read a file from PyTorch before 1.6, which stores tensor values after the pickled content.

    ``least`` is the memory allowed for the arrays in a small file. None uses the default.
    """
    at, parts, found = 0, list[Any](), dict[str, np.ndarray]()
    kinds: dict[str, Any] = {}

    def storage(key: Any) -> Stored:
        name = str(key[2])
        kinds[name] = key[1]
        return Stored(lambda: found[name])

    for _ in range(5):
        stream = BytesIO(data[at:])
        parts.append(_follow(stream, path, storage, least))
        at += stream.tell()
    for name in parts[4]:
        count = struct.unpack_from("<q", data, at)[0]
        end = at + 8 + _bounded(_bytes_of((count,), _item(kinds[str(name)]).itemsize))
        found[str(name)] = _values(data[at + 8 : end], kinds[str(name)], count)
        at = end
    return parts[3]


def _item(kind: Any) -> np.dtype:
    name = kind.name.removesuffix("Storage") if isinstance(kind, PickledName) else ""
    if name not in _ITEMS:
        raise Damage("a tensor has numbers of an unknown kind")
    return np.dtype(_ITEMS[name])


def _values(data: bytes, kind: Any, count: Any) -> np.ndarray:
    item = _item(kind)
    if len(data) < _bounded(_bytes_of((count,), item.itemsize)):
        raise Damage("a tensor is cut off")
    values = np.frombuffer(data, item, count)
    return (values.astype("<u4") << 16).view("<f4") if kind.name == "BFloat16Storage" else values


def _loaded(data: Any = b"", *_: Any) -> Any:
    """Read a tensor that is stored in a pickle as the bytes of a complete PyTorch file."""
    return _older_torch(bytes(data), Path("tensor"), least=0)


def _lengths(values: Any = (), *_: Any) -> tuple[Any, ...]:
    if not isinstance(values, list | tuple) or len(values) > MAX_DIMENSIONS:
        raise Damage("a tensor's shape is not valid")
    return tuple(values)


def _inflated(data: bytes) -> bytes:
    stream = zlib.decompressobj()
    content = stream.decompress(data, _LARGEST)
    if not stream.eof:
        raise Damage("it is truncated, or expands to too much")
    return content


def _header_size(head: bytes, path: Path) -> int:
    """Return the number of bytes before the pickle of a NumPy object array."""
    width = 2 if head[6] == 1 else 4
    return 8 + width + int.from_bytes(read_bytes(path)[8 : 8 + width], "little")


_DIALECT = Dialect(
    calls={
        "torch._utils._rebuild_tensor_v2": _tensor,
        "torch._utils._rebuild_parameter": lambda tensor=None, *_: tensor,
        "torch.storage._load_from_bytes": _loaded,
        "torch.Size": _lengths,
        "torch.device": lambda *_: "",
        **dict.fromkeys(("collections.OrderedDict", "collections.defaultdict", "builtins.dict"), lambda *_: {}),
        **{f"torch.{name}Storage": None for name in _ITEMS},
    },
    objects=True,
    most=_MOST_OPERATIONS,
    kind="network's result",
    remedy="Run the network again, and save only arrays, numbers and text",
)
