"""Track the background of a video from a moving camera, and write the camera's path."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.extrinsics.camera_path import Tracks, estimate_path
from solver_backend.camera_calibration.pictures import opencv
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.io.calibration.entry import Calibration
from solver_backend.types import Cameras
from solver_backend.videos.detect.assemble import (
    FEATURES,
    WIDTH_PX,
    background_mask,
    followed,
    in_video_pixels,
    steadied,
)
from solver_backend.videos.files.video import probe, read_pictures
from solver_backend.videos.video_detections import VideoDetections

APART_PX = 7  # Smallest distance in pixels between a new feature and the tracked ones.
REFILLED = 0.7  # New features are detected if less than this fraction of ``FEATURES`` remains.
SHORTEST = 8  # Length of the shortest usable track in images. Shorter tracks do not determine a point's position.


def track_background(found: VideoDetections, pictures: Iterable[np.ndarray], progress: Progress = silent) -> Tracks:
    """Track background points around people. Return their tracks in px.

    Reference: Shi and Tomasi 1994, "Good features to track"; Lucas and Kanade 1981.
    """
    cv2 = opencv()
    scale = min(1.0, WIDTH_PX / found.size[0])
    rows: list[tuple[np.ndarray, np.ndarray]] = []
    points, names, count = np.zeros((0, 2), np.float32), np.zeros(0, int), 0
    before = None
    for number, rgb in zip(range(found.num_frames), pictures, strict=False):
        grey = cv2.resize(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        mask = background_mask(found, number, grey.shape, scale)
        if before is not None and len(points):
            points, kept = followed(cv2, before, grey, points)
            names = names[kept]
            x, y = np.clip(points.round().astype(int).T, 0, [[grey.shape[1] - 1], [grey.shape[0] - 1]])
            free = mask[y, x] > 0
            points, names = points[free], names[free]
        if len(points) < REFILLED * FEATURES:
            for x, y in points.round().astype(int).tolist():
                cv2.circle(mask, (x, y), APART_PX, 0, -1)
            corners = cv2.goodFeaturesToTrack(grey, FEATURES - len(points), 0.01, APART_PX, mask=mask)
            if corners is not None:
                points = np.concatenate([points, corners[:, 0]])
                names = np.concatenate([names, count + np.arange(len(corners))])
                count += len(corners)
        rows.append((names, points / scale))
        before = grey
        progress("Following the background", number + 1, found.num_frames)
    rows += [(np.zeros(0, int), np.zeros((0, 2)))] * (found.num_frames - len(rows))  # The file may be truncated.
    lengths = np.bincount(np.concatenate([row[0] for row in rows]), minlength=count)
    kept = [lengths[names] >= SHORTEST for names, _ in rows]
    return Tracks(*(tuple(row[part][long] for row, long in zip(rows, kept, strict=True)) for part in (0, 1)))


def follow_camera(
    found: VideoDetections, camera: Cameras, pictures: Iterable[np.ndarray], out: Path, progress: Progress = silent
) -> Path | None:
    """Estimate a moving camera's path and write it as a TUM trajectory, or return None if that fails.

    Args:
        camera: the single camera, for its lens.
        pictures: (H, W, 3) images from the video.
    """
    path = estimate_path(camera, track_background(found, pictures, progress), progress)
    if path is None:
        return None
    back = np.swapaxes(path.R, 1, 2)
    centres, turns = -np.einsum("fab,fb->fa", back, path.t), np.roll(np.asarray(quat_from_matrix(back)), -1, axis=1)
    rows = np.concatenate([(found.times_s - found.times_s[0])[:, None], centres, turns], axis=1)
    lines = [" ".join(f"{value:.9g}" for value in row) for row in rows.tolist()]
    write_text(out, "\n".join(["# seconds tx ty tz qx qy qz qw", *lines, ""]), overwrite=True)
    return out


def without_camera_motion(
    found: tuple[VideoDetections, ...],
    calibration: Calibration,
    world: WorldSettings,
    out: Path,
    progress: Progress = silent,
) -> tuple[tuple[VideoDetections, ...], WorldSettings, list[Diagnostic]]:
    """Correct the detections for camera rotation, or add the path of a moving camera to the settings.

    If the settings already contain a path from the user, nothing changes. Otherwise, a path is estimated if rotation
    alone does not explain the motion of the background.

    Args:
        out: file for the estimated path. An existing file is removed.
    """
    if world.camera_path:
        return found, world, []
    out.unlink(missing_ok=True)  # from an earlier run
    still, diagnostics = steadied(found, calibration, progress)
    if all(item.code != "camera_moves" for item in diagnostics):
        return still, world, diagnostics
    pictures = (picture.rgb for picture in read_pictures(probe(found[0].video)))
    camera, _ = in_video_pixels(calibration, found)
    if follow_camera(found[0], camera, pictures, out, progress) is None:
        return found, world, diagnostics
    return found, replace(world, camera_path=str(out)), []
