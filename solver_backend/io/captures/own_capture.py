"""Our own capture file as a reader, with what the caller knows better."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.types import Capture


def _recognises(path: Path) -> bool:
    return path.suffix.lower() == ".npz" and path.is_file()


def _read(path: Path, options: ReadOptions) -> Capture:
    """Read a capture file; a given frame rate or joint set replaces the file's."""
    capture = read_capture(path)
    keypoints = capture.keypoints
    if keypoints is None:
        return capture
    changed = replace(keypoints, fps=options.fps or keypoints.fps, joint_set=options.joint_set or keypoints.joint_set)
    return replace(capture, keypoints=changed, sources=capture.sources or (str(path),))


READER = Reader("our own capture .npz", _recognises, _read)
