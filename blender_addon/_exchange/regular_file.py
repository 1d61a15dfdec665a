"""Opening a file for reading that is surely a file: devices and pipes are refused, and never waited for."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def open_regular(path: Path | str) -> BinaryIO:
    """Open an ordinary file for reading its bytes.

    Some files of the system call themselves ordinary, have no size, and wait for data when they are read
    (``/proc/kmsg``): such a one is tried without waiting.

    Raises:
        OSError: it cannot be opened, is a device, a pipe or a folder, or has nothing to read yet.
    """
    return os.fdopen(_opened(path)[0], "rb")


def read_regular(path: Path | str, largest: int) -> tuple[bytes, int]:
    """Return what an ordinary file holds, and its size; of a larger one nothing, of one that grows a byte too much.

    Args:
        path: of the file.
        largest: bytes that it may hold.

    Raises:
        OSError: see ``open_regular``.
    """
    handle, size = _opened(path)
    try:
        if size > largest:
            return b"", size
        data = os.read(handle, size + 1)
        if size and len(data) == size:
            return data, size
        parts, left = [data], largest - size
        while left > 0 and (part := os.read(handle, min(left, _PART))):
            parts.append(part)
            left -= len(part)
        return b"".join(parts), size
    finally:
        os.close(handle)


_PART = 1 << 20
"""Bytes that are read at once of a file that states no size."""


def _opened(path: Path | str) -> tuple[int, int]:
    """Return the handle of an ordinary file, and its size."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
    handle = os.open(path, flags)
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file")
        if not status.st_size:
            _require_no_waiting(handle)
    except BaseException:
        os.close(handle)
        raise
    return handle, status.st_size


def _require_no_waiting(handle: int) -> None:
    try:
        os.read(handle, 1)
    except BlockingIOError as error:
        raise OSError(errno.EINVAL, "it is a device that waits for data") from error
    os.lseek(handle, 0, os.SEEK_SET)
