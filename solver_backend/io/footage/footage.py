"""Videos or image folders of the cameras, and whether their size is the calibration's."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.cameras.camera_corrections import resized
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.io.calibration import Calibration
from solver_backend.io.footage.mp4 import VideoHeader, read_video_header
from solver_backend.io.recognition.camera_names import name_key, natural_key

VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".wmv")
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
SENSOR_RECORDING = "recording.json"
"""The file that states what a folder of infrared and depth sensors holds."""
_FOLDERS = ("videos", "video", "images", "footage")


def find_footage(levels: Sequence[Path], recorded: Sequence[str]) -> tuple[Path | None, ...]:
    """Return the video or image folder of each recorded camera, None where there is none.

    Args:
        levels: folders that may hold a folder ``videos``, nearest first.
        recorded: names of the recorded cameras.
    """
    for level in levels:
        for name in (*_FOLDERS, "."):
            folder = level / name
            if folder.is_dir() and (found := footage_in(folder)):
                matched = tuple(found.get(name_key(camera)) for camera in recorded)
                if any(matched):
                    return matched
    return (None,) * len(recorded)


def footage_in(folder: Path) -> dict[tuple[str, ...], Path]:
    """Return the videos and folders of pictures of a folder by what distinguishes their names."""
    found: dict[tuple[str, ...], Path] = {}
    for path in sorted(folder.iterdir(), key=lambda p: natural_key(p.name)):
        if path.suffix.lower() in VIDEOS and path.is_file():
            found.setdefault(name_key(path.stem), path)
        elif path.is_dir() and any(item.suffix.lower() in IMAGES for item in path.iterdir()):
            found.setdefault(name_key(path.name), path)
    return found


def headers(footage: Sequence[Path | None]) -> list[VideoHeader | None]:
    """Return the header of each video that has one we can read."""
    return [read_video_header(path) if path is not None and os.path.isfile(path) else None for path in footage]


def with_sizes_of(
    calibration: Calibration, videos: Sequence[VideoHeader | None], detections: Detections
) -> Calibration:
    """Return the calibration in the pixels of the detections.

    A camera without a stated size takes its video's. Where video and calibration have sizes of the same shape, the
    calibration is scaled to the video if the detections only make sense there; other differences are reported.
    """
    cameras, notes, problems = calibration.cameras, list(calibration.notes), list(calibration.problems)
    guessed: list[str] = []
    for c, header in enumerate(videos):
        name, size = cameras.names[c], tuple(cameras.image_size[c].tolist())
        if not calibration.size_known[c]:
            if header is None:
                guessed.append(name)
            else:
                sizes = cameras.image_size.copy()
                sizes[c] = header.size
                cameras = replace(cameras, image_size=sizes)
            continue
        if header is None or header.size == size:
            continue
        if _made_for_video(size, header.size, detections.xy[c]):
            cameras = resized(cameras, c, header.size)
            notes.append(_of_sizes("calibration_resized", name, size, header.size))
        else:
            problems.append(_of_sizes("video_size_differs", name, size, header.size))
    if guessed:
        problems.append(diagnostic("image_size_assumed", cameras=guessed))
    return replace(calibration, cameras=cameras, notes=tuple(notes), problems=tuple(problems))


def _of_sizes(code: str, camera: str, calibrated: tuple[int, ...], video: tuple[int, int]) -> Diagnostic:
    return diagnostic(
        code, cameras=[camera], width=calibrated[0], height=calibrated[1], video_width=video[0], video_height=video[1],
    )  # fmt: skip


def _made_for_video(calibrated: tuple[int, ...], video: tuple[int, int], xy: np.ndarray) -> bool:
    scale = np.array(video) / np.array(calibrated)
    if abs(scale[0] / scale[1] - 1) > 0.005 or abs(scale[0] - 1) < 0.02:
        return False
    known = xy[np.isfinite(xy).all(-1)]
    if not len(known):
        return False
    reach = np.quantile(known, 0.995, axis=0)
    if scale[0] < 1:
        return bool((reach <= 1.02 * np.array(video)).all())
    return bool((reach > 1.02 * np.array(calibrated)).any())
