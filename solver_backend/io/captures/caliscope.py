"""Points that caliscope tracked, one row a point, a camera and a moment, with the project's calibration."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import diagnostic, notes_in, warnings_in
from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.exchange.reading_settings import calibrated_names
from solver_backend.io.calibration.search import find_calibration
from solver_backend.io.files import read_text, read_toml
from solver_backend.io.interpretation import interpret_rate
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.recognition.joint_sets import choose_joint_set
from solver_backend.io.recognition.start_times import bring_capture_to_one_time
from solver_backend.io.recognition.world_fit import fit_world, scale_world
from solver_backend.types import Capture, JointSet, Keypoints2D

_CAMERA = ("port", "cam_id")
_COLUMNS = ("sync_index", "point_id", "img_loc_x", "img_loc_y")
_LEVELS = 5
"""Folders above the file that may be the project's."""
MEDIAPIPE_POINTS = 33
"""Points of larger numbers are those of hands and face."""
DEFAULT_FPS = 30.0
"""Frames a second that are assumed where no project states them, which is reported as a problem; chosen by hand."""
LARGEST_TAKE_FRAMES = 1_000_000
"""Frames of a take at most, over four hours at 60 a second; chosen by hand."""


def _file(path: Path) -> Path | None:
    if path.is_dir():
        found = [p for p in path.iterdir() if p.name.lower().startswith("xy_") and p.suffix.lower() == ".csv"]
        return found[0] if len(found) == 1 else None
    return path if path.name.lower().startswith("xy_") and path.suffix.lower() == ".csv" and path.is_file() else None


def _recognises(path: Path) -> bool:
    return _file(path) is not None


def _read(path: Path, options: ReadOptions) -> Capture:
    """Read the points of one person."""
    source = _file(path) or path
    numbers, xy = _rows(source)
    project = _project(source)
    ports, first = np.unique(numbers[:, 1]), int(numbers[:, 0].min())
    frames = int(numbers[:, 0].max()) - first + 1
    if frames > LARGEST_TAKE_FRAMES:
        what = f"Its sync_index runs over {frames:,} frames; a take has at most {LARGEST_TAKE_FRAMES:,}."
        raise FileDamaged(what, where=str(source))
    names = tuple(f"cam_{port}" for port in ports.tolist())
    body = numbers[:, 2] < MEDIAPIPE_POINTS
    count = int(numbers[body, 2].max()) + 1 if body.any() else 0
    if not count:
        raise NoDetections("The table holds no points of a body.", where=str(source))
    positions = np.full((len(ports), frames, count, 2), np.nan)
    at = np.searchsorted(ports, numbers[body, 1]), numbers[body, 0] - first, numbers[body, 2]
    positions[at] = xy[body]
    confidence = np.isfinite(positions).all(-1).astype(float)
    chosen, notes, problems = choose_joint_set(positions, confidence, options.joint_set, None, where=str(source))
    configured = _stated_rate(project)
    note = diagnostic("frame_rate_read", source="file", rate=configured or 0.0, file="config.toml")
    fps, rate_note, rate_problems = interpret_rate(options.fps, [(configured, note)], DEFAULT_FPS)
    calibrated = calibrated_names(options.camera)
    folder = project or source.parent
    calibration = find_calibration(folder, names, unit=options.unit, up_axis=options.up_axis, names=calibrated)
    columns = slice(0, chosen.num_keypoints)
    keypoints = Keypoints2D(positions[:, :, columns], confidence[:, :, columns], JointSet(chosen), fps)
    cameras, scaled = scale_world(calibration.cameras, keypoints, options)
    world = fit_world(cameras, keypoints, options, options.up_axis)
    capture = Capture(
        name=source.parent.parent.name if source.parent.name in source.stem else source.stem,
        cameras=world.cameras,
        keypoints=keypoints,
        sources=(str(source), str(calibration.source)),
        notes=(*calibration.notes, *notes, *rate_note, *notes_in(scaled), *world.notes, *world.check.notes()),
        problems=(
            *calibration.problems,
            *problems,
            *rate_problems,
            *warnings_in(scaled),
            *world.problems,
            *world.check.problems(),
        ),
        world_checked=True,
    )
    return bring_capture_to_one_time(capture, options)


def _rows(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) whole sync_index, camera and point, and (N, 2) px, of the table's rows."""
    table = csv.reader(io.StringIO(read_text(path)))
    try:
        header = [name.strip() for name in next(table, [])]
    except csv.Error as error:
        raise FileDamaged(f"The table has no heading ({error}).", where=str(path)) from error
    camera = next((name for name in _CAMERA if name in header), "port")
    missing = [name for name in (*_COLUMNS, camera) if name not in header]
    if missing:
        hint = "Export it from caliscope again."
        raise FileDamaged(f"The table lacks {', '.join(missing)}.", where=str(path), hint=hint)
    order = [header.index(name) for name in ("sync_index", camera, "point_id", "img_loc_x", "img_loc_y")]
    try:
        values = np.array([[row[i] or "nan" for i in order] for row in table if row], dtype=np.float64)
    except (ValueError, IndexError, csv.Error) as error:
        what = f"A row is cut off or holds something that is not a number ({error})."
        raise FileDamaged(what, where=str(path)) from error
    if not len(values):
        raise NoDetections("The table holds no points.", where=str(path))
    whole = values[:, :3]
    if not np.isfinite(whole).all() or (whole != np.round(whole)).any() or (whole < 0).any() or (whole > 1e9).any():
        raise FileDamaged("sync_index, camera and point_id must be whole numbers from 0.", where=str(path))
    return whole.astype(np.int64), values[:, 3:]


def _project(source: Path) -> Path | None:
    above = list(source.parents)[:_LEVELS]
    return next((p for p in above if (p / "config.toml").is_file() or (p / "camera_array.toml").is_file()), None)


def _stated_rate(project: Path | None) -> float | None:
    if project is None or not (project / "config.toml").is_file():
        return None
    stated = read_toml(project / "config.toml").get("fps_recording")
    if not isinstance(stated, int | float) or isinstance(stated, bool):
        return None
    return float(stated) if 0 < stated < 1e5 else None


_TAKES = frozenset(
    {"fps", "joint_set", "unit", "up_axis", "trim", "offset", "by_order", "camera", "stature", "scale", "level"}
)
READER = Reader("caliscope's xy_*.csv, or its folder, in a project with its config.toml", _recognises, _read, _TAKES)
