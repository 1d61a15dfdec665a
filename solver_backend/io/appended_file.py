"""Files that grow by whole pieces while something is live: a disk that fails loses pieces, never those before."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from solver_backend.exchange.errors import OutputNotWritable


class AppendedFile:
    """A file to which pieces are appended, each whole or not at all; what fails is counted, and never raised.

    Nothing is buffered: whatever ends this process, the system has every piece that was appended.
    """

    def __init__(self, handle: int, where: str) -> None:
        self.handle, self.where = handle, where
        self.written = 0
        """Pieces in the file."""
        self.lost = 0
        """Pieces that could not be written."""
        self.failure = ""
        """What the system reported when a piece was lost last."""
        try:
            self._size: int | None = os.lseek(handle, 0, os.SEEK_CUR)
        except OSError:  # a pipe
            self._size = None

    def append(self, piece: bytes) -> bool:
        """Append a piece; return whether it was written.

        Raises:
            BrokenPipeError: whoever read the pieces is gone.
        """
        try:
            rest = memoryview(piece)
            while rest:
                rest = rest[os.write(self.handle, rest) :]
        except BrokenPipeError:
            raise
        except OSError as error:
            self.lost += 1
            self.failure = error.strerror or str(error)
            self._cut_back()
            return False
        self.written += 1
        if self._size is not None:
            self._size += len(piece)
        return True

    def require_whole(self, hint: str) -> None:
        """Make sure that every piece was written.

        Raises:
            OutputNotWritable: some were not.
        """
        if self.lost:
            what = f"{self.lost} of {self.lost + self.written} lines or frames could not be written: {self.failure}."
            raise OutputNotWritable(what, where=self.where, hint=hint)

    def _cut_back(self) -> None:
        if self._size is not None:
            with suppress(OSError):
                os.ftruncate(self.handle, self._size)
                os.lseek(self.handle, self._size, os.SEEK_SET)

    def close(self) -> None:
        """Close the file."""
        os.close(self.handle)


def open_appended(path: Path, *, fresh: bool) -> AppendedFile:
    """Return a new file to append to.

    Args:
        path: where.
        fresh: refuse a file that is there; False empties it.

    Raises:
        OutputNotWritable: it cannot be made.
    """
    flags = os.O_WRONLY | os.O_CREAT | (os.O_EXCL if fresh else os.O_TRUNC) | getattr(os, "O_BINARY", 0)
    try:
        return AppendedFile(os.open(path, flags, 0o666), str(path))
    except OSError as error:
        raise OutputNotWritable(f"The output cannot be written: {error.strerror or error}.", where=str(path)) from error
