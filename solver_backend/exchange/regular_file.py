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
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
    handle = os.open(path, flags)
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is no ordinary file")
        if not status.st_size:
            _require_no_waiting(handle)
    except BaseException:
        os.close(handle)
        raise
    return os.fdopen(handle, "rb")


def _require_no_waiting(handle: int) -> None:
    try:
        os.read(handle, 1)
    except BlockingIOError as error:
        raise OSError(errno.EINVAL, "it is a device that waits for data") from error
    os.lseek(handle, 0, os.SEEK_SET)
