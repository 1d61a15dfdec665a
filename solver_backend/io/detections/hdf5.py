"""HDF5 files, opened with h5py where it is installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import BackendMissing, FileDamaged, MocapError
from solver_backend.exchange.regular_file import open_regular

_MAGIC = b"\x89HDF\r\n\x1a\n"


@contextmanager
def opened(path: Path, program: str) -> Iterator[Any]:
    """Open a file; what it lacks inside the block becomes one of our errors.

    Args:
        path: the file.
        program: that wrote it, for messages.

    Raises:
        BackendMissing: h5py is not installed.
        FileDamaged: it is no HDF5 file, is truncated, or is not as the program writes it.
    """
    try:
        h5py = import_module("h5py")
    except ModuleNotFoundError as error:
        raise BackendMissing(
            f"{program}'s HDF5 files are read with h5py, which is not installed.", where=str(path),
            hint="Install it with: pip install h5py.",
        ) from error  # fmt: skip
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise FileDamaged(f"The file is not an HDF5 file, or is truncated ({error}).", where=str(path)) from error
    with file:
        try:
            yield file
        except MocapError:
            raise
        except (KeyError, ValueError, IndexError, TypeError, OSError, RecursionError, AttributeError) as error:
            raise FileDamaged(
                f"The file is not as {program} writes it ({error}).", where=str(path),
                hint=f"Export it from {program} again.",
            ) from error  # fmt: skip


def begins_with(path: Path, text: bytes, length: int) -> bool:
    """Whether the first bytes of an HDF5 file, so many, hold a text, such as the name of a group."""
    try:
        with open_regular(path) as file:
            start = file.read(length)
    except OSError:
        return False
    return start.startswith(_MAGIC) and text in start
