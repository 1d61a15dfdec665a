"""Recording a face that is live: channels as they come, a table of them at the end or by the next run."""

from __future__ import annotations

import csv
import io
import json
from contextlib import nullcontext, suppress
from pathlib import Path

from solver_backend.exchange.errors import FileDamaged, MocapError
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.exchange.unfinished import lock
from solver_backend.io.appended_file import AppendedFile, open_appended
from solver_backend.live.recording import recording_of, recover


class FaceRecorder:
    """Appends every frame to ``FACE.csv.recording``, and makes ``FACE.csv`` of it at the end; a context manager.

    The table has the column ``time`` in seconds and one a channel; a channel that a frame lacks keeps its last value.
    """

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        """Begin a recording; what a run that was killed has left is finished under a name of its own.

        Raises:
            OutputExists, OutputNotWritable: it cannot be written, or another process records to it.
        """
        self.path = check_output(path, overwrite=overwrite)
        self.unfinished = recording_of(self.path)
        self.recovered = recover(self.path, finish_face)
        self._overwrite, self.finished = overwrite, False
        self._file: AppendedFile = open_appended(self.unfinished, fresh=True)
        lock(self._file.handle)

    @property
    def count(self) -> int:
        """Number of frames in the file."""
        return self._file.written

    def add(self, time: float, channels: dict[str, float]) -> None:
        """Append a frame: its seconds, and the value of each channel."""
        self._file.append(json.dumps([round(time, 6), channels]).encode() + b"\n")

    def finish(self) -> None:
        """Write the table and remove the unfinished recording; only the latter where nothing came.

        Raises:
            OutputNotWritable: the table cannot be written (the unfinished one is kept), or frames were lost.
        """
        if self.finished:
            return
        self.finished = True
        self._file.close()
        finish_face(self.unfinished, self.path, overwrite=self._overwrite)
        self._file.require_whole(f"The other frames are in {self.path.name}; make room on the disk before recording.")

    def __enter__(self) -> FaceRecorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Finish; an error that is on its way already is not replaced by one of finishing."""
        with suppress(MocapError) if kind is not None else nullcontext():
            self.finish()


def finish_face(recording: Path, path: Path, *, overwrite: bool = False) -> bool:
    """Write a recording of a face as a table and remove it; return whether it had frames.

    Raises:
        FileDamaged: it is none.
        OutputExists, OutputNotWritable: the table cannot be written; the recording is kept.
    """
    frames: list[tuple[float, dict[str, float]]] = []
    try:
        for line in recording.read_bytes().splitlines(keepends=True):
            if line.endswith(b"\n"):  # the last one may be cut
                seconds, channels = json.loads(line)
                frames.append((float(seconds), {str(name): float(value) for name, value in channels.items()}))
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise FileDamaged("The recording of a face cannot be read.", where=str(recording)) from error
    if frames:
        names = list(dict.fromkeys(name for _, channels in frames for name in channels))
        table, last = io.StringIO(newline=""), dict.fromkeys(names, 0.0)
        writer = csv.writer(table, lineterminator="\n")
        writer.writerow(["time", *names])
        for seconds, channels in frames:
            last |= channels
            writer.writerow([f"{seconds:.6f}", *(f"{last[name]:.4f}" for name in names)])
        write_text(path, table.getvalue(), overwrite=overwrite)
    recording.unlink()
    return bool(frames)
