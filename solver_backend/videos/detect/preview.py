"""Videos with what was found drawn over them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from solver_backend.exchange.progress import Progress, silent
from solver_backend.types import JointSet
from solver_backend.videos.files.probe import probe
from solver_backend.videos.files.read import read_pictures
from solver_backend.videos.files.write import write_video
from solver_backend.videos.video_detections import VideoDetections

HEIGHT = 720
"""Pixels of a preview's shorter side at most."""
COLOURS = np.array([[60, 220, 90], [255, 140, 40], [70, 160, 255], [240, 80, 220], [250, 230, 60], [120, 240, 240]])
"""Of the people, by their track."""
_CHAINS = (
    ("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"), ("left_shoulder", "left_hip"),
    ("right_shoulder", "right_hip"), ("left_shoulder", "left_elbow"), ("left_elbow", "left_wrist"),
    ("right_shoulder", "right_elbow"), ("right_elbow", "right_wrist"), ("left_hip", "left_knee"),
    ("left_knee", "left_ankle"), ("right_hip", "right_knee"), ("right_knee", "right_ankle"),
    ("left_ankle", "left_big_toe"), ("right_ankle", "right_big_toe"),
)  # fmt: skip


def write_previews(
    found: Sequence[VideoDetections], folder: Path, progress: Progress = silent, *, overwrite: bool = False
) -> list[Path]:
    """Write a preview of each video into a folder and return their paths.

    Raises:
        OutputExists, OutputNotWritable, VideoUnreadable: see ``write_video`` and ``read_pictures``.
    """
    written, total, done = [], sum(item.num_frames for item in found), 0
    for item in found:
        path = folder / f"{item.name}_detections.mp4"
        progress("Drawing previews", done, total)
        write_video(path, _drawn(item), max(item.fps, 1.0), overwrite=overwrite)
        written.append(path)
        done += item.num_frames
    progress("Drawing previews", total, total)
    return written


def _drawn(item: VideoDetections) -> Iterator[np.ndarray]:
    step = max(1, min(item.size) // HEIGHT)
    for picture in read_pictures(probe(item.video)):
        if picture.number >= item.num_frames:
            return
        small = np.ascontiguousarray(picture.rgb[::step, ::step])
        yield draw_people(small, item, picture.number, step)


def draw_people(rgb: np.ndarray, item: VideoDetections, frame: int, step: int = 1) -> np.ndarray:
    """Return a picture, every ``step``-th pixel of the video's, with the people of a frame drawn into it."""
    for slot in np.flatnonzero(item.track[frame] >= 0):
        colour = COLOURS[item.track[frame, slot] % len(COLOURS)]
        points, sure = item.xy[frame, slot] / step, item.confidence[frame, slot]
        for a, b in _bones(item.joint_set):
            if sure[a] > 0 and sure[b] > 0:
                count = int(np.abs(points[b] - points[a]).max()) + 2
                _dots(rgb, np.linspace(points[a], points[b], count), colour, 1)
        _dots(rgb, points[sure > 0], np.array([255, 255, 255]), 2)
    return rgb


def _bones(joint_set: JointSet) -> list[tuple[int, int]]:
    names = joint_set.keypoints
    return [(names.index(a), names.index(b)) for a, b in _CHAINS if a in names and b in names]


def _dots(rgb: np.ndarray, points: np.ndarray, colour: np.ndarray, radius: int) -> None:
    """Paint squares around points (N, 2)."""
    reach = np.arange(-radius, radius + 1)
    x, y = (np.round(points[:, axis]).astype(int)[:, None, None] for axis in (0, 1))
    x, y = np.broadcast_arrays(x + reach[:, None], y + reach)
    inside = (x >= 0) & (y >= 0) & (x < rgb.shape[1]) & (y < rgb.shape[0])
    rgb[y[inside], x[inside]] = colour
