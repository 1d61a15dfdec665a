"""Recording while something is live: pieces as they come, a file of them at the end or when the next run starts."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Self

from solver_backend.exchange.errors import MocapError, OutputNotWritable
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.unfinished import is_held, lock
from solver_backend.io.appended_file import AppendedFile, open_appended
from solver_backend.io.markers.live_recording import SUFFIX


class Recorder:
    """Appends pieces to ``PATH.recording``, and makes ``PATH`` of them at the end; a context manager.

    Whatever ends the process, the pieces before are in that file, which the next run to the same path finishes under a
    name of its own.
    """

    def __init__(self, path: Path, finish: Callable[..., bool], pieces: str, *, overwrite: bool) -> None:
        """Begin a recording.

        Args:
            path: the file.
            finish: writes a recording (the first path) to a file (the second) and removes it, takes ``overwrite``, and
                returns whether anything was in it.
            pieces: what they are called.
            overwrite: replace a file that is there.

        Raises:
            OutputExists, OutputNotWritable: it cannot be written, or another process records to it.
        """
        # First: a run that was killed as it finished has left both, and the file that is there is refused.
        self.recovered = recover(path, finish)
        self.path = check_output(path, overwrite=overwrite)
        self.unfinished = recording_of(self.path)
        self._finish, self._pieces, self._overwrite = finish, pieces, overwrite
        self._file: AppendedFile = open_appended(self.unfinished, fresh=True)
        lock(self._file.handle)
        self.finished = False

    @property
    def count(self) -> int:
        """Number of pieces in the file."""
        return self._file.written

    def finish(self) -> None:
        """Write the file and remove the unfinished recording; only the latter where nothing came.

        Raises:
            OutputNotWritable: the file cannot be written (the unfinished one is kept), or pieces were lost.
        """
        if self.finished:
            return
        self.finished = True
        self._file.close()
        self._write()
        self._file.require_whole(
            f"The other {self._pieces} are in {self.path.name}; make room on the disk before recording."
        )

    def _write(self) -> None:
        self._finish(self.unfinished, self.path, overwrite=self._overwrite)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Finish; an error that is on its way already is not replaced by one of finishing."""
        with suppress(MocapError) if kind is not None else nullcontext():
            self.finish()


def recording_of(path: Path) -> Path:
    """Return the unfinished recording of a file."""
    return path.with_name(path.name + SUFFIX)


def recover(path: Path, finish: Callable[[Path, Path], bool]) -> Path | None:
    """Finish what a run that was killed has left of the recording to a file; return where it is, None for nothing.

    Args:
        path: the file.
        finish: writes a recording to a file and returns whether anything was in it.

    Raises:
        OutputNotWritable: another process is recording, or the disk is full; nothing is lost.
    """
    left = recording_of(path)
    if not left.exists():
        return None
    if is_held(left):
        raise OutputNotWritable("Another process is recording to this file.", where=str(path), hint="Choose another.")
    number = 1
    while (whole := path.with_name(f"{path.stem}_recovered_{number}{path.suffix}")).exists() or (
        aside := recording_of(whole)
    ).exists():
        number += 1
    try:
        os.rename(left, aside)
    except OSError as error:
        raise OutputNotWritable(
            f"An earlier recording cannot be finished: {error.strerror or error}.", where=str(left)
        ) from error
    return whole if finish(aside, whole) else None
