"""Recording what comes live: written as it comes, finished into a C3D file at the end or when the next run starts."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import MocapError, OutputNotWritable
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.unfinished import is_held, lock
from solver_backend.io.appended_file import AppendedFile, open_appended
from solver_backend.io.markers.c3d_writer import C3dSize, unnamed_labels, write_c3d_parts
from solver_backend.io.markers.live_recording import (
    SUFFIX,
    LiveBlock,
    measure_recording,
    pack_block,
    read_parts,
)
from solver_backend.live.frames import PointFrame

_FRAMES_AT_ONCE = 512
"""Frames of a recording that are in memory while it is finished."""

World = Callable[[], np.ndarray | None]


class LiveRecorder:
    """Appends every frame to ``TAKE.c3d.recording``, and makes ``TAKE.c3d`` of it at the end.

    Whatever ends the process, the frames before are in that file, which readers of markers open (see
    ``live_recording``) and which the next run to the same file finishes under a name of its own.
    """

    def __init__(self, path: Path, fps: float | None, world: World, *, overwrite: bool) -> None:
        """Begin a recording.

        Args:
            path: the C3D file.
            fps: nominal rate, None where nobody said one.
            world: returns the (3, 3) matrix that turns the points into metres, Z up, None while it is not known.
            overwrite: replace a file that is there.

        Raises:
            OutputExists, OutputNotWritable: it cannot be written, or another process records to it.
        """
        self.path = check_output(path, overwrite=overwrite)
        self.unfinished = recording_of(self.path)
        self.recovered = recover(self.path)
        self._fps, self._world, self._overwrite = fps, world, overwrite
        self._file: AppendedFile = open_appended(self.unfinished, fresh=True)
        lock(self._file.handle)
        self.finished = False

    @property
    def count(self) -> int:
        """Number of frames in the file."""
        return self._file.written

    def watched(self, frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
        """Yield the same frames, each after it was recorded."""
        for frame in frames:
            if not frame.fault:
                self._file.append(pack_block(LiveBlock(frame.time, frame.points, self._fps, self._world())))
            yield frame

    def finish(self) -> None:
        """Write the C3D file and remove the unfinished one; only the latter where no frame has points.

        Raises:
            OutputNotWritable: the C3D file cannot be written (the unfinished one is kept), or frames were lost.
        """
        if self.finished:
            return
        self.finished = True
        self._file.close()
        finish_recording(self.unfinished, self.path, self._world(), overwrite=self._overwrite)
        self._file.require_whole(f"The other frames are in {self.path.name}; make room on the disk before recording.")

    def __enter__(self) -> LiveRecorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Finish; an error that is on its way already is not replaced by one of finishing."""
        with contextlib.suppress(MocapError) if kind is not None else contextlib.nullcontext():
            self.finish()


def recording_of(path: Path) -> Path:
    """Return the unfinished recording of a C3D file."""
    return path.with_name(path.name + SUFFIX)


def finish_recording(recording: Path, path: Path, world: np.ndarray | None, *, overwrite: bool = False) -> bool:
    """Write a recording as C3D and remove it; return whether it had points.

    Args:
        recording: the unfinished one.
        path: the C3D file.
        world: what turns the points into metres, Z up; None takes what the recording knows.
        overwrite: replace a file that is there.

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
                hint = f"The recording is whole in {recording.name}: info and solve open it, the next run finishes it."
                raise OutputNotWritable(error.message, where=str(path), hint=hint) from error
    recording.unlink()
    return bool(extent.most)


def finish_points(recording: Path, path: Path) -> bool:
    """Write a recording of points with what it knows of their world; see ``finish_recording``."""
    return finish_recording(recording, path, None)


def recover(path: Path, finish: Callable[[Path, Path], bool] = finish_points) -> Path | None:
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
