"""Define the readers of our own capture and motion files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, notes_in, warnings_in
from solver_backend.exchange.plausible import FARTHEST_M, largest_finite
from solver_backend.exchange.reading_settings import OFF, ON
from solver_backend.io.files import npz_names
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.marker_up_axis import find_unit, find_up_axis, spread
from solver_backend.io.recognition.world_fit import without_world
from solver_backend.types import Capture, MarkerCloud


def _is_npz(path: Path) -> bool:
    return path.suffix.lower() == ".npz" and path.is_file()


def _has_views(path: Path) -> bool:
    return "xy" in npz_names(path)


def _read_views(path: Path, options: ReadOptions) -> Capture:
    """Read a capture file with detections.

    Diagnostics about the world are recomputed, because the cameras may have changed since the file was written.
    """
    from solver_backend.io.captures.agreement import bring_capture_to_one_time

    capture = _read_markers(path, options)
    found = capture.keypoints
    if found is not None:
        given = {"fps": options.fps or found.fps, "joint_set": options.joint_set or found.joint_set}
        people = tuple(replace(p, keypoints=replace(p.keypoints, **given)) for p in capture.people)
        notes, problems = without_world(capture.notes), without_world(capture.problems)
        found = replace(found, **given)
        capture = replace(capture, keypoints=found, people=people, notes=notes, problems=problems)
        capture = bring_capture_to_one_time(capture, options)
    return _in_another_world(capture, options) if options.changes_world else capture


def _read_markers(path: Path, options: ReadOptions) -> Capture:
    """Read a capture file with markers. A frame rate in the options replaces the stored one."""
    capture = read_capture(path)
    capture = replace(capture, sources=capture.sources or (str(path),))
    if capture.markers is None:
        return capture
    markers = replace(capture.markers, fps=options.fps or capture.markers.fps)
    others = None if capture.others is None else replace(capture.others, fps=markers.fps)
    odd = (problem for problem in marker_problems(markers) if problem not in capture.problems)
    return replace(capture, markers=markers, others=others, problems=(*capture.problems, *odd))


def _in_another_world(capture: Capture, options: ReadOptions) -> Capture:
    if capture.cameras is None or capture.keypoints is None:
        return capture
    from solver_backend.io.recognition.world_fit import fit_world, scale_world

    cameras, scaled = scale_world(capture.cameras, capture.keypoints, options)
    level = replace(options, level=ON if options.level == ON else OFF)
    world = fit_world(cameras, capture.keypoints, level)
    kept = capture.stature_m if len(cameras) == 1 or options.scale == 1.0 else 0.0
    known: dict[str, Any] = {"stature_m": options.stature or kept}
    if len(cameras) == 1:
        known["floor_from_person"] = world.from_person
    changed = (*scaled, *world.found)
    notes, problems = (*capture.notes, *notes_in(changed)), (*capture.problems, *warnings_in(changed))
    return replace(capture, cameras=world.cameras, notes=notes, problems=problems, truth={}, **known)


_KIND = "capture .npz of this program"
_TAKES = frozenset(
    {"fps", "joint_set", "trim", "person", "offset", "by_order", "stature", "scale", "level", "camera_path"}
)
CAPTURES = (
    Reader(_KIND, _has_views, _read_views, _TAKES),
    Reader(_KIND, lambda path: _is_npz(path) and not _has_views(path), _read_markers, frozenset({"fps"})),
)
"""Readers for files with detections and for files with only markers."""
MOTION = Reader("motion .npz of this program", _is_npz, lambda path, _: read_motion(path))


def marker_problems(cloud: MarkerCloud) -> tuple[Diagnostic, ...]:
    """Warn if markers (metres, Z up) do not have human size, or suggest another up axis."""
    if not np.isfinite(cloud.positions).any() or largest_finite(cloud.positions) > FARTHEST_M:
        return ()  # the range check after every reader rejects the latter
    found: list[Diagnostic] = []
    unit = find_unit(cloud.positions, "m", None, "m")
    if unit.problem is not None:
        likely, size = "metres" if unit.name == "m" else "unit", spread(cloud.positions)
        found.append(diagnostic("marker_spread_unlikely", likely=likely, spread=size, unit=unit.name))
    axis = find_up_axis(cloud.positions * unit.metres, cloud.labels or ("",) * cloud.positions.shape[1], "z", None, "z")
    if axis.problem is not None:
        found.append(diagnostic("up_axis_doubted", conflict="capture", along=axis.problem.values["along"]))
    return tuple(found)
