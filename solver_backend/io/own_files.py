"""Our own two files as readers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.marker_world import marker_problems
from solver_backend.io.recognition.start_times import bring_capture_to_one_time
from solver_backend.io.recognition.world_check import without_world
from solver_backend.types import Capture


def _is_npz(path: Path) -> bool:
    return path.suffix.lower() == ".npz" and path.is_file()


def _read_capture(path: Path, options: ReadOptions) -> Capture:
    """Read a capture file; a given frame rate or joint set replaces the file's.

    What the file says of its world is not believed: it may have been changed since. It is looked at as any reader's.
    """
    capture = read_capture(path)
    found, markers = capture.keypoints, capture.markers
    if found is not None:
        said = {"fps": options.fps or found.fps, "joint_set": options.joint_set or found.joint_set}
        found = replace(found, **said)
        people = tuple(replace(p, keypoints=replace(p.keypoints, **said)) for p in capture.people)
        capture = replace(capture, people=people)
    if markers is not None:
        markers = replace(markers, fps=options.fps or markers.fps)
        odd = (problem for problem in marker_problems(markers) if problem not in capture.problems)
        capture = replace(capture, problems=(*capture.problems, *odd))
    notes, problems = without_world(capture.notes), without_world(capture.problems)
    capture = replace(capture, notes=notes, problems=problems) if found is not None else capture
    capture = replace(capture, keypoints=found, markers=markers, sources=capture.sources or (str(path),))
    return bring_capture_to_one_time(capture, options)


CAPTURE = Reader("our own capture .npz", _is_npz, _read_capture)
MOTION = Reader("our own motion .npz", _is_npz, lambda path, options: read_motion(path))
