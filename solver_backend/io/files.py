"""Read text, JSON, TOML, XML and arrays with size limits, and append to files safely."""

from __future__ import annotations

import codecs
import os
import re
import tomllib
from contextlib import suppress
from math import prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from solver_backend.exchange.errors import FileDamaged, MocapError, OutputNotWritable
from solver_backend.exchange.json_file import parse_json
from solver_backend.exchange.npz import NeedsPickle, array_names, read_array_header
from solver_backend.exchange.outputs import open_regular, read_regular, require_file, unreadable

LARGEST_TAKE = 1_000_000_000  # Largest size of a take in bytes.
LARGEST_TEXT = 20_000_000  # Size limit in bytes of a calibration, a job or one frame's detections. Real files have kB.
_LARGEST_TOML = 2_000_000
LONGEST_HEADING = 200  # Longest allowed column heading in characters. Pattern matching takes quadratic time.
_MOST_KEY_PARTS = 32  # Largest number of dotted parts in a TOML key, chosen by hand.
_KEY_PART = re.compile(r"""\.[ \t]*(?:[\w-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')[ \t]*(?=\.)""")


def read_bytes(path: Path | str, largest: int = LARGEST_TAKE) -> bytes:
    """Read a file of at most ``largest`` bytes. Raise FileMissing or FileDamaged."""
    try:
        data, size = read_regular(path, largest)
    except OSError as error:
        require_file(path)
        raise unreadable(path, error) from error
    if (size := max(size, len(data))) > largest:
        what = f"The file has {size / 1e6:,.1f} MB, but files of this kind have at most {largest / 1e6:g} MB."
        raise FileDamaged(what, where=str(path), hint="Check that it is the right file, or remove it.")
    return data


def first_bytes(path: Path, length: int) -> bytes:
    """Read a file's first bytes to recognise it. Return no bytes if the file is unreadable."""
    with suppress(OSError), open_regular(path) as stream:
        return stream.read(length)
    return b""


def read_text(path: Path | str, largest: int = LARGEST_TAKE) -> str:
    """Read and decode a text file. It raises the same errors as ``read_bytes``."""
    return as_text(read_bytes(path, largest))


def as_text(data: bytes) -> str:
    """Decode bytes in UTF-16 (with a byte order mark), UTF-8 or Latin-1."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_json(path: Path | str) -> Any:
    """Read a JSON file. Raise FileMissing or FileDamaged."""
    return parse_json(read_text(path, LARGEST_TEXT), path)


def read_toml(path: Path | str) -> dict[str, Any]:
    """Read a TOML file. Raise FileMissing or FileDamaged."""
    text = read_text(path, _LARGEST_TOML)
    try:
        # Python's parser takes quadratic time for keys with many parts.
        if any(len(_KEY_PART.findall(line)) > _MOST_KEY_PARTS for line in text.splitlines()):
            raise tomllib.TOMLDecodeError(f"a key has more than {_MOST_KEY_PARTS} parts")
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        what = f"The file is truncated or is not TOML ({error})."
        raise FileDamaged(what, where=str(path), hint="Check this line.") from error


def read_xml(path: Path, largest: int, kind: str) -> ElementTree.Element:
    """Read an XML file. Raise FileMissing or FileDamaged. ``kind`` names the format in messages."""
    try:
        return ElementTree.fromstring(read_bytes(path, largest))
    except (ElementTree.ParseError, LookupError, ValueError, RecursionError) as error:
        what = f"The file is truncated or is not {kind}: {error}."
        raise FileDamaged(what, where=str(path), hint="Export the file again.") from error


def npz_names(path: Path) -> frozenset[str]:
    """Return the array names in an ``.npz`` file, or no names for other or unreadable files."""
    with suppress(MocapError):
        if path.suffix.lower() == ".npz":
            return array_names(path)
    return frozenset()


def load_array(path: Path) -> np.ndarray:
    """Memory-map the array in a ``.npy`` file. Raise FileDamaged for any other file."""
    with open_regular(require_file(path)) as stream:
        if stream.read(4) == b"PK\x03\x04":
            hint = "Rename it to .npz, or save one array with numpy.save."
            raise FileDamaged("The file is an .npz archive of arrays, not a single array.", where=str(path), hint=hint)
        stream.seek(0)
        try:
            shape, dtype, by_columns, used = read_array_header(stream, path.name)
            size = os.fstat(stream.fileno()).st_size - used
            if (needed := prod(shape) * dtype.itemsize) > size:
                raise ValueError(f"the header states {needed:,} bytes, but {size:,} follow")
            if not needed:
                return np.empty(shape, dtype)
            return np.memmap(path, dtype, "r", used, shape, "F" if by_columns else "C")
        except (OSError, ValueError) as error:
            what = f"The file is not a NumPy array, or cannot be read ({error})."
            packed = isinstance(error, NeedsPickle)
            hint = "`motion convert` reads network results." if packed else "Save it again."
            raise FileDamaged(what, where=str(path), hint=hint) from error


class AppendedFile:
    """A file to which complete pieces are appended. A piece that cannot be written completely is removed.

    Nothing is buffered, so the written pieces remain if the process ends unexpectedly.
    """

    def __init__(self, handle: int, where: str) -> None:
        self.handle, self.where = handle, where
        self.written, self.lost = 0, 0  # Number of pieces in the file, and number of pieces that could not be written.
        self.failure = ""  # System message for the last failure.
        try:
            self._size: int | None = os.lseek(handle, 0, os.SEEK_CUR)
        except OSError:  # the path is a pipe
            self._size = None

    def append(self, piece: bytes) -> bool:
        """Append a piece and return whether it was written."""
        try:
            rest = memoryview(piece)
            while rest:
                rest = rest[os.write(self.handle, rest) :]
        except BrokenPipeError:
            raise
        except OSError as error:
            self.lost += 1
            self.failure = error.strerror or str(error)
            if self._size is not None:
                with suppress(OSError):
                    os.ftruncate(self.handle, self._size)
                    os.lseek(self.handle, self._size, os.SEEK_SET)
            return False
        self.written += 1
        if self._size is not None:
            self._size += len(piece)
        return True

    def require_whole(self, hint: str) -> None:
        """Raise OutputNotWritable if a piece could not be written."""
        if self.lost:
            what = f"{self.lost} of {self.lost + self.written} lines or frames could not be written: {self.failure}."
            raise OutputNotWritable(what, where=self.where, hint=hint)

    def close(self) -> None:
        """Close the file handle."""
        os.close(self.handle)


def open_appended(path: Path, *, fresh: bool) -> AppendedFile:
    """Create a file to append to. An existing file is replaced, or rejected if ``fresh`` is true."""
    flags = os.O_WRONLY | os.O_CREAT | (os.O_EXCL if fresh else os.O_TRUNC) | getattr(os, "O_BINARY", 0)
    try:
        return AppendedFile(os.open(path, flags, 0o666), str(path))
    except OSError as error:
        raise OutputNotWritable(f"The output cannot be written: {error.strerror or error}.", where=str(path)) from error
