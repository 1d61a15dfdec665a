"""Recording a face that is live: channels as they come, a table of them at the end or by the next run."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.outputs import write_text
from solver_backend.live.recorder import Recorder


class FaceRecorder(Recorder):
    """Appends every frame to ``FACE.csv.recording``, and makes ``FACE.csv`` of it at the end; a context manager.

    The table has the column ``time`` in seconds and one a channel; a channel that a frame lacks keeps its last value.
    """

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        """Begin a recording; what a run that was killed has left is finished under a name of its own.

        Raises:
            OutputExists, OutputNotWritable: it cannot be written, or another process records to it.
        """
        super().__init__(path, finish_face, "frames", overwrite=overwrite)

    def add(self, time: float, channels: dict[str, float]) -> None:
        """Append a frame: its seconds, and the value of each channel."""
        self._file.append(json.dumps([round(time, 6), channels]).encode() + b"\n")


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
