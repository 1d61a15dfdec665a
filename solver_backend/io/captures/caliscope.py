"""Read the points tracked by caliscope and the calibration of their project."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import diagnostic, notes_in, warnings_in
from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.exchange.reading_settings import calibrated_names
from solver_backend.io.calibration.search import find_calibration
from solver_backend.io.captures.agreement import bring_capture_to_one_time
from solver_backend.io.detections.search import positive_number
from solver_backend.io.files import read_toml
from solver_backend.io.interpretation import interpret_rate
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.joint_sets import choose_joint_set
from solver_backend.io.recognition.world_fit import fit_world, scale_world
from solver_backend.io.text_table import read_numbers, read_rows
from solver_backend.types import Capture, JointSet, Keypoints2D

_CAMERA = ("port", "cam_id")  # Headings of the camera column in different versions of caliscope.
_CONFIG = "config.toml"
_LEVELS = 5
"""Largest number of folders above the file that are searched for the project."""
MEDIAPIPE_POINTS = 33  # Points with larger numbers belong to the hands and the face.
DEFAULT_FPS = 30.0  # Frames per second if there is no project, chosen by hand. A problem reports this assumption.
LARGEST_TAKE_FRAMES = 1_000_000  # Largest number of frames, more than four hours at 60 per second. Chosen by hand.
_LARGEST_NUMBER = 1e9  # Largest whole number in a table.


def _find_table(path: Path) -> Path | None:
    inside = list(path.iterdir()) if path.is_dir() else [path] if path.is_file() else []
    found = [p for p in inside if p.name.lower().startswith("xy_") and p.suffix.lower() == ".csv"]
    return found[0] if len(found) == 1 else None


def _read(path: Path, options: ReadOptions) -> Capture:
    source = _find_table(path) or path
    numbers, xy = _rows(source)
    above = list(source.parents)[:_LEVELS]
    project = next((p for p in above if (p / _CONFIG).is_file() or (p / "camera_array.toml").is_file()), None)
    ports, first = np.unique(numbers[:, 1]), int(numbers[:, 0].min())
    frames = int(numbers[:, 0].max()) - first + 1
    if frames > LARGEST_TAKE_FRAMES:
        what = f"The sync_index covers {frames:,} frames, but a take has at most {LARGEST_TAKE_FRAMES:,}."
        raise FileDamaged(what, where=str(source))
    names = tuple(f"cam_{port}" for port in ports.tolist())
    body = numbers[:, 2] < MEDIAPIPE_POINTS
    if not body.any():
        raise NoDetections("The table does not contain body points.", where=str(source))
    positions = np.full((len(ports), frames, int(numbers[body, 2].max()) + 1, 2), np.nan)
    at = np.searchsorted(ports, numbers[body, 1]), numbers[body, 0] - first, numbers[body, 2]
    positions[at] = xy[body]
    confidence = np.isfinite(positions).all(-1).astype(float)
    chosen, notes, problems = choose_joint_set(positions, confidence, options.joint_set, None, where=str(source))
    has_config = project is not None and (project / _CONFIG).is_file()
    configured = positive_number(read_toml(project / _CONFIG).get("fps_recording")) if project and has_config else None
    note = diagnostic("frame_rate_read", source="file", rate=configured or 0.0, file=_CONFIG)
    fps, rate_note, rate_problems = interpret_rate(options.fps, [(configured, note)], DEFAULT_FPS)
    calibrated = calibrated_names(options.camera)
    folder = project or source.parent
    calibration = find_calibration(folder, names, unit=options.unit, up_axis=options.up_axis, names=calibrated)
    columns = slice(0, chosen.num_keypoints)
    keypoints = Keypoints2D(positions[:, :, columns], confidence[:, :, columns], JointSet(chosen), fps)
    cameras, scaled = scale_world(calibration.cameras, keypoints, options)
    world = fit_world(cameras, keypoints, options, options.up_axis)
    changed = (*scaled, *world.found, *world.check.found())
    capture = Capture(
        name=source.parent.parent.name if source.parent.name in source.stem else source.stem,
        cameras=world.cameras,
        keypoints=keypoints,
        sources=(str(source), str(calibration.source)),
        notes=(*calibration.notes, *notes, *rate_note, *notes_in(changed)),
        problems=(*calibration.problems, *problems, *rate_problems, *warnings_in(changed)),
        stature_m=options.stature,
        world_checked=True,
    )
    return bring_capture_to_one_time(capture, options)


def _rows(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read a table of points. Return sync_index, camera and point (N, 3), and pixels (N, 2)."""
    header, rows = read_rows(path)
    camera = next((name for name in _CAMERA if name in header), _CAMERA[0])
    needed = ("sync_index", camera, "point_id", "img_loc_x", "img_loc_y")
    if missing := [name for name in needed if name not in header]:
        hint = "Export it from caliscope again."
        raise FileDamaged(f"The table does not contain {', '.join(missing)}.", where=str(path), hint=hint)
    order = [header.index(name) for name in needed]
    if any(len(row) <= max(order) for row in rows):
        raise FileDamaged("A row of the table is incomplete.", where=str(path))
    if not rows:
        raise NoDetections("The table has no points.", where=str(path))
    values = read_numbers([[*(row[i] for i in order), "0"] for row in rows], 2, path)
    whole = values[:, :3]
    counted = np.isfinite(whole).all() and (whole == np.round(whole)).all() and (whole >= 0).all()
    if not counted or (whole > _LARGEST_NUMBER).any():
        raise FileDamaged("sync_index, camera and point_id must be whole numbers from 0.", where=str(path))
    return whole.astype(np.int64), values[:, 3:5]


_TAKES = "fps joint_set unit up_axis trim offset by_order camera stature scale level"
READER = Reader(
    "caliscope's xy_*.csv, or its folder, in a project with its config.toml",
    lambda path: _find_table(path) is not None,
    _read,
    frozenset(_TAKES.split()),
)
