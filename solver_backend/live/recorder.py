"""Record a live run item by item, and finish the file at the end or when the next run starts."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any, ClassVar, Generic, ParamSpec, Protocol, Self, final

import numpy as np

from solver_backend.exchange.errors import FileDamaged, MocapError, OutputNotWritable
from solver_backend.exchange.outputs import check_output, is_held, lock
from solver_backend.io.files import open_appended
from solver_backend.io.markers.live_recording import SUFFIX

Item = ParamSpec("Item")


class RecordingFormat(Protocol[Item]):
    """Conversion of items to bytes, and of a recording to a file."""

    pieces: ClassVar[str]

    def head(self) -> bytes:
        """Return the bytes before the first item."""
        ...

    def encode(self, *args: Item.args, **kwargs: Item.kwargs) -> bytes:
        """Return one item's bytes."""
        ...

    def finish(self, recording: Path, path: Path, *, overwrite: bool = False, lost: int = 0) -> bool:
        """Write a recording to a file and remove it. Return whether it held anything.

        Raises:
            FileDamaged: it is not a recording of this format.
        """
        ...


@final
class Recorder(Generic[Item]):
    """Append items to ``PATH.recording`` and convert it to ``PATH`` at the end. A context manager.

    The file keeps all items however the process ends. The next run to the same path finishes it under another name.
    """

    def __init__(self, path: Path, form: RecordingFormat[Item], *, overwrite: bool) -> None:
        # First, because a run that was killed as it finished has left both, and check_output refuses the file.
        self.recovered = recover(path, form.finish)
        self.path = check_output(path, overwrite=overwrite)
        self.unfinished = recording_of(self.path)
        self._form, self._overwrite = form, overwrite
        self._file = open_appended(self.unfinished, fresh=True)
        lock(self._file.handle)
        self.finished = False

    @property
    def count(self) -> int:
        """Number of items in the file."""
        return self._file.written

    def add(self, *args: Item.args, **kwargs: Item.kwargs) -> None:
        """Append an item. Items that cannot be written are counted and reported at the end."""
        piece = self._form.encode(*args, **kwargs)
        self._file.append(piece if self._file.written else self._form.head() + piece)

    def finish(self) -> None:
        """Write the file, if there is an item, and remove the unfinished recording."""
        if self.finished:
            return
        self.finished = True
        self._file.close()
        self._form.finish(self.unfinished, self.path, overwrite=self._overwrite, lost=self._file.lost)
        hint = f"The other {self._form.pieces} are in {self.path.name}; make room on the disk before recording."
        self._file.require_whole(hint)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with suppress(MocapError) if kind is not None else nullcontext():
            self.finish()


def recording_of(path: Path) -> Path:
    """Return the unfinished recording of a file."""
    return path.with_name(path.name + SUFFIX)


def recover(path: Path, finish: Callable[[Path, Path], bool]) -> Path | None:
    """Finish the recording of a killed run. Return the new file, None if there was nothing.

    Raises:
        OutputNotWritable: another process is recording, or the disk is full. The recording is kept.
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
        message = f"An earlier recording cannot be finished: {error.strerror or error}."
        raise OutputNotWritable(message, where=str(left)) from error
    return whole if finish(aside, whole) else None


def pack_head(form: str, version: int, **values: object) -> bytes:
    """Return the JSON line before rows of numbers."""
    return json.dumps({"format": form, "version": version, **values}).encode() + b"\n"


def pack_row(*parts: Any) -> bytes:
    """Return one row of numbers, little-endian float64."""
    return np.concatenate([np.ravel(part) for part in parts]).astype("<f8").tobytes()


def read_rows(
    recording: Path, form: str, version: int, width: Callable[[dict[str, Any]], int]
) -> tuple[dict[str, Any], np.ndarray]:
    """Return the head and the (N, width) rows of a recording. A last row that was cut off is skipped.

    Raises:
        FileDamaged: it has another format or version.
    """
    head, line, content = recording.read_bytes().partition(b"\n")
    if not line:  # ended before the first item was whole
        return {}, np.zeros((0, 0))
    try:
        found = json.loads(head)
        if found["format"] == form and found["version"] == version:
            size = width(found)
            count = len(content) // (8 * size)
            return found, np.frombuffer(content[: 8 * size * count], "<f8").reshape(count, size)
    except (ValueError, KeyError, TypeError, RecursionError, MocapError):
        pass
    raise FileDamaged("The recording cannot be read, or is of another body.", where=str(recording))
