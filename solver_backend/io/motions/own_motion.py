"""Our own motion file as a reader."""

from __future__ import annotations

from solver_backend.io.native.motion_file import read_motion
from solver_backend.io.reader import Reader

READER = Reader(
    "our own motion .npz", lambda path: path.suffix.lower() == ".npz", lambda path, options: read_motion(path)
)
