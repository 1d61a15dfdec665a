"""Recording what comes live: written as it comes, finished into a C3D file at the end or when the next run starts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import OutputNotWritable
from solver_backend.io.markers.c3d_writer import C3dSize, unnamed_labels, write_c3d_parts
from solver_backend.io.markers.live_recording import (
    LiveBlock,
    measure_recording,
    pack_block,
    read_parts,
)
from solver_backend.live.frames import PointFrame
from solver_backend.live.recorder import Recorder

_FRAMES_AT_ONCE = 512
"""Frames of a recording that are in memory while it is finished."""

World = Callable[[], np.ndarray | None]


class LiveRecorder(Recorder):
    """Appends every frame to ``TAKE.c3d.recording``, which readers of markers open (see ``live_recording``)."""

    def __init__(self, path: Path, fps: float | None, world: World, *, overwrite: bool) -> None:
        """Begin a recording.

        Args:
            path: the C3D file.
            fps: nominal rate, None where none was given.
            world: returns the (3, 3) matrix that turns the points into metres, Z up, None while it is not known.
            overwrite: replace a file that is there.

        Raises:
            OutputExists, OutputNotWritable: it cannot be written, or another process records to it.
        """
        super().__init__(path, finish_points, "frames", overwrite=overwrite)
        self._fps, self._world = fps, world

    def watched(self, frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
        """Yield the same frames, each after it was recorded."""
        for frame in frames:
            if not frame.fault:
                self._file.append(pack_block(LiveBlock(frame.time, frame.points, self._fps, self._world())))
            yield frame

    def _write(self) -> None:
        lost = self._file.lost
        finish_recording(self.unfinished, self.path, self._world(), overwrite=self._overwrite, lost=lost)


def finish_recording(
    recording: Path, path: Path, world: np.ndarray | None, *, overwrite: bool = False, lost: int = 0
) -> bool:
    """Write a recording as C3D and remove it; return whether it had points.

    Args:
        recording: the unfinished one.
        path: the C3D file.
        world: what turns the points into metres, Z up; None takes what the recording knows.
        overwrite: replace a file that is there.
        lost: frames that came and are not in it.

    Raises:
        OutputExists, OutputNotWritable: the C3D file cannot be written; the recording is kept.
    """
    with recording.open("rb") as stream:
        extent = measure_recording(stream)
        turn = world if world is not None else extent.to_metres
        turn = np.eye(3) if turn is None else np.asarray(turn)
        # Rows of a scaled rotation: no coordinate grows by more than the sum of a row.
        reach = extent.largest * float(np.abs(turn).sum(axis=1).max())
        size = C3dSize(extent.frames, unnamed_labels(extent.most), extent.rate, reach)
        stream.seek(0)
        parts = ((part @ turn.T, None) for part in read_parts(stream, extent.most, _FRAMES_AT_ONCE))
        if extent.most:
            try:
                write_c3d_parts(path, size, parts, overwrite=overwrite)
            except OutputNotWritable as error:
                kept = f"{extent.frames} of {extent.frames + lost} frames are in {recording.name}"
                hint = f"{kept}: info and solve open it, the next run finishes it."
                raise OutputNotWritable(error.message, where=str(path), hint=hint) from error
    recording.unlink()
    return bool(extent.most)


def finish_points(recording: Path, path: Path, *, overwrite: bool = False) -> bool:
    """Write a recording of points with what it knows of their world; see ``finish_recording``."""
    return finish_recording(recording, path, None, overwrite=overwrite)
