"""Arrays in an ``.npz``: read without pickle, written whole or not at all."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from .errors import FileDamaged, FileMissing
from .npz_members import Members, NeedsPickle
from .outputs import atomic_output
from .regular_file import open_regular

_DAMAGE = (
    OSError, ValueError, EOFError, KeyError, IndexError, NotImplementedError, RuntimeError, OverflowError, MemoryError,
    struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What Python's zip reader raises for bytes that are no sound archive."""
_START_OF_A_BARE_ARRAY = b"\x93NUMPY"


def require_file(path: Path | str) -> Path:
    """Return the path of a file that exists.

    Raises:
        FileMissing: there is no such file, or a folder, pipe or device in its place.
    """
    path = Path(path)
    if not path.is_file():
        other = "A folder, a pipe or a device is in the place of the file."
        what = other if path.exists() else "There is no such file."
        raise FileMissing(what, where=str(path), hint="Check the path.")
    return path


def array_names(path: Path | str) -> frozenset[str]:
    """Return the names of the arrays of an ``.npz``; none of them is read.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file is truncated or no npz.
    """
    with _opened(path) as members:
        return frozenset(members.names)


def read_npz(path: Path | str, wanted: Callable[[str], bool] = lambda name: True) -> dict[str, np.ndarray]:
    """Read the wanted arrays of an ``.npz`` that need no pickle; arrays that would need it are left out.

    Args:
        path: the file.
        wanted: whether an array of this name is read; by default all are.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file is truncated or no npz, or an array is forged.
    """
    arrays: dict[str, np.ndarray] = {}
    with _opened(path) as members:
        for name in filter(wanted, members.names):
            with suppress(NeedsPickle):
                arrays[name] = members.read(name)
    return arrays


def read_arrays(path: Path | str, *, required: Iterable[str], optional: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Read the named arrays of an ``.npz``; optional ones that are not there are left out.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file is truncated, is no ``.npz``, or lacks required arrays; or one would need pickle.
    """
    required = tuple(required)
    with _opened(path) as members:
        found = set(members.names)
        arrays = {key: members.read(key) for key in (*required, *optional) if key in found}
    missing = [key for key in required if key not in arrays]
    if missing:
        raise FileDamaged(
            f"The file lacks {', '.join(missing)}; it holds {', '.join(sorted(found)) or 'nothing'}.", where=str(path)
        )
    return arrays


def write_npz(path: Path | str, arrays: Mapping[str, np.ndarray], *, overwrite: bool = False) -> Path:
    """Write arrays to a compressed ``.npz`` that holds no pickles, whole or not at all.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        ValueError: an array is of type object.
    """
    plain = {key: np.asarray(value) for key, value in arrays.items()}
    for key, value in plain.items():
        if value.dtype.hasobject:
            raise ValueError(f"'{key}' is an object array, which would need pickle.")
    # The archive is written member by member: np.savez takes names as keywords and so forbids 'file'.
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
    """Yield the archive's arrays; whatever is wrong with its bytes, here or in the block, becomes a named error."""
    path = require_file(path)
    try:
        with open_regular(path) as stream:
            bare = stream.read(len(_START_OF_A_BARE_ARRAY)) == _START_OF_A_BARE_ARRAY
            if bare or not zipfile.is_zipfile(stream):
                raise zipfile.BadZipFile("no zip archive" + (" but one bare array" if bare else ""))
            with zipfile.ZipFile(stream) as archive:
                yield Members(archive, path.stat().st_size)
    except _DAMAGE as error:
        raise FileDamaged(
            f"The file is truncated or is not an .npz of plain arrays ({error}).",
            where=str(path),
            hint="Copy or export it again.",
        ) from error
