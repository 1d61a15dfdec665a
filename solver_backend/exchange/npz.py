"""Read ``.npz`` files without pickle, and write them completely or not at all."""

from __future__ import annotations

import ast
import errno
import re
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from math import prod
from pathlib import Path
from typing import IO

import numpy as np

from .errors import FileDamaged
from .outputs import atomic_output, open_regular, require_file, unreadable

MIN_ALLOWANCE, ALLOWANCE = 2**28, 50
"""Limits on the total size of a file's arrays, in bytes and as a multiple of the file size. The larger one applies."""
MOST_MEMBERS = 10_000
_LONGEST_HEADER = 10_000
_MOST_DIMENSIONS = 8
_CHUNK = 2**20
_SUFFIX = ".npy"
_PLAIN = re.compile(r"[<>|=]?(b1|\?|[iu][1248]|f[248]|c(8|16)|[SU]\d{1,9})")
_LENGTH_BYTES = {1: 2, 2: 4, 3: 4}
"""Bytes of the header's length field for each format version."""
_METHODS = {zipfile.ZIP_STORED: "stored", zipfile.ZIP_DEFLATED: "deflated"}


class NeedsPickle(ValueError):
    """An array's items are objects instead of numbers or text."""


class Members:
    """The arrays in an open archive, by name."""

    def __init__(self, archive: zipfile.ZipFile, size: int) -> None:
        entries = archive.infolist()
        if len(entries) > MOST_MEMBERS:
            raise ValueError(f"it has {len(entries):,} members, but the limit is {MOST_MEMBERS:,}")
        self._archive, self._bytes_left = archive, max(MIN_ALLOWANCE, ALLOWANCE * size)
        self._entries = {entry.filename.removesuffix(_SUFFIX): entry for entry in entries}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays, in archive order."""
        return tuple(self._entries)

    def read(self, name: str) -> np.ndarray:
        """Read an array.

        Raises:
            NeedsPickle: the array's items are objects.
            ValueError: the array is encrypted or compressed by another method, or its header, size and bytes do not
                match.
        """
        entry = self._entries[name]
        if entry.flag_bits & 1:
            raise ValueError(f"'{name}' is encrypted")
        if entry.compress_type not in _METHODS:
            raise ValueError(f"'{name}' is packed by method {entry.compress_type}, but stored or deflated is expected")
        with self._archive.open(entry) as stream:
            shape, dtype, by_columns, used = read_array_header(stream, name)
            # Count lengths of zero as one, because a shape such as (2**60, 0) may also be forged.
            count = prod(max(1, length) for length in shape) * max(1, dtype.itemsize)
            self._bytes_left -= count
            if self._bytes_left < 0:
                raise ValueError(f"'{name}' would take {count:,} bytes, far more than a file of this size contains")
            if used + prod(shape) * dtype.itemsize != entry.file_size:
                raise ValueError(f"'{name}' of shape {shape} and type {dtype} does not have {entry.file_size} bytes")
            values = np.empty(prod(shape), dtype)
            _fill(stream, values, name)
            _require_characters(values, name)
        return values.reshape(shape, order="F" if by_columns else "C")


def read_array_header(stream: IO[bytes], name: str) -> tuple[tuple[int, ...], np.dtype, bool, int]:
    """Read the header of an ``.npy`` array in format version 1, 2 or 3.

    Returns:
        Shape, type, True if columns come first in memory, and header size in bytes.
    """
    magic = stream.read(8)
    version = magic[6] if len(magic) == 8 and magic[:6] == b"\x93NUMPY" else 0
    width = _LENGTH_BYTES.get(version, 0)
    length = int.from_bytes(stream.read(width), "little")
    if not width or length > _LONGEST_HEADER:
        raise ValueError(f"'{name}' is not an array in NumPy's format")
    text = stream.read(length)
    try:
        header = ast.literal_eval(text.decode("utf-8" if version == 3 else "latin-1").strip())
        kind, shape, by_columns = header["descr"], header["shape"], header["fortran_order"]
    except (ValueError, SyntaxError, TypeError, KeyError, RecursionError, MemoryError) as error:
        raise ValueError(f"the header of '{name}' is damaged") from error
    if not isinstance(kind, str) or not _PLAIN.fullmatch(kind):
        raise NeedsPickle(f"'{name}' has the type {str(kind)[:40]}. Objects need pickle, which is not supported")
    good = isinstance(shape, tuple) and len(shape) <= _MOST_DIMENSIONS and isinstance(by_columns, bool)
    if not good or not all(type(n) is int and 0 <= n < 2**62 for n in shape):
        raise ValueError(f"'{name}' has the shape {str(shape)[:80]}")
    try:
        dtype = np.dtype(kind)
    except TypeError as error:  # NumPy 2 has no text type as wide as a header may claim
        raise ValueError(f"the header of '{name}' is damaged") from error
    return shape, dtype, by_columns, len(magic) + width + len(text)


def _fill(stream: IO[bytes], values: np.ndarray, name: str) -> None:
    """Read an array's bytes up to the end of its archive member, because the checksum is verified only there."""
    room = values.view(np.uint8) if values.nbytes else np.empty(0, np.uint8)
    at = 0
    while chunk := stream.read(_CHUNK):
        if at + len(chunk) > len(room):
            raise ValueError(f"'{name}' has more bytes than it states")
        room[at : at + len(chunk)] = np.frombuffer(chunk, np.uint8)
        at += len(chunk)
    if at < len(room):
        raise EOFError(f"'{name}' ends after {at} of {len(room)} bytes")


def _require_characters(values: np.ndarray, name: str) -> None:
    """Raise ValueError if there are invalid code points, which NumPy cannot convert to text."""
    if values.dtype.kind == "U" and values.nbytes:
        codes = values.view(np.dtype(np.uint32).newbyteorder(values.dtype.byteorder))
        if codes.max() > sys.maxunicode:
            raise ValueError(f"'{name}' contains text with invalid characters")


# Errors that Python's zip reader raises for bytes that are not a valid archive.
_DAMAGE = (OSError, ValueError, EOFError, LookupError, RuntimeError, OverflowError, MemoryError)
_DAMAGE += (struct.error, zipfile.BadZipFile, zlib.error)
_START_OF_A_BARE_ARRAY = b"\x93NUMPY"


def array_names(path: Path | str) -> frozenset[str]:
    """Return the array names in an ``.npz`` without reading the arrays."""
    with _opened(path) as members:
        return frozenset(members.names)


def read_npz(path: Path | str, wanted: Callable[[str], bool] = lambda name: True) -> dict[str, np.ndarray]:
    """Read the arrays in an ``.npz`` that ``wanted`` accepts by name, except those that need pickle."""
    arrays: dict[str, np.ndarray] = {}
    with _opened(path) as members:
        for name in filter(wanted, members.names):
            with suppress(NeedsPickle):
                arrays[name] = members.read(name)
    return arrays


def read_arrays(path: Path | str, *, required: Iterable[str], optional: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Read named arrays in an ``.npz``. Missing optional arrays are omitted."""
    required = tuple(required)
    with _opened(path) as members:
        found = set(members.names)
        arrays = {key: members.read(key) for key in dict.fromkeys((*required, *optional)) if key in found}
    if missing := [key for key in required if key not in arrays]:
        held = ", ".join(sorted(found)) or "nothing"
        raise FileDamaged(f"The file does not contain {', '.join(missing)}. It contains {held}.", where=str(path))
    return arrays


def write_npz(path: Path | str, arrays: Mapping[str, np.ndarray], *, overwrite: bool = False) -> Path:
    """Write arrays to a compressed ``.npz`` without pickle, completely or not at all."""
    plain = {key: np.asarray(value) for key, value in arrays.items()}
    for key, value in plain.items():
        if value.dtype.hasobject:
            raise ValueError(f"'{key}' is an object array, which would need pickle.")
    # Write members one by one, because np.savez uses names as keywords and forbids 'file'.
    with (
        atomic_output(path, overwrite=overwrite) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
    ):
        for key, value in plain.items():
            with archive.open(f"{key}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, value, allow_pickle=False)
    return Path(path)


@contextmanager
def _opened(path: Path | str) -> Iterator[Members]:
    """Open an archive and yield its arrays.

    If the archive is damaged, raise a named error, even if the damage is detected only within the ``with`` block.
    """
    path = require_file(path)
    try:
        with open_regular(path) as stream:
            bare = stream.read(len(_START_OF_A_BARE_ARRAY)) == _START_OF_A_BARE_ARRAY
            if bare or not zipfile.is_zipfile(stream):
                raise zipfile.BadZipFile("no zip archive" + (" but one bare array" if bare else ""))
            with zipfile.ZipFile(stream) as archive:
                yield Members(archive, path.stat().st_size)
    except _DAMAGE as error:
        if isinstance(error, OSError) and error.errno in (errno.EACCES, errno.EIO):
            raise unreadable(path, error) from error
        message = f"The file is truncated or is not an .npz of plain arrays ({error})."
        raise FileDamaged(message, where=str(path), hint="Copy or export it again.") from error
