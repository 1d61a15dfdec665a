"""The pictures of a video one after the other, upright and with their true times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.videos.files.container import AGAIN, library, opened, video_stream
from solver_backend.videos.files.errors import VideoUnreadable
from solver_backend.videos.files.probe import VideoInfo, quarter_turn

LOST_SHARE = 0.02
"""So large a share of the pictures may be broken; beyond it the video is refused."""


@dataclass(frozen=True)
class Picture:
    """One picture of a video."""

    number: int
    """From 0, in the order they are shown."""
    time_s: float
    """When it is shown, on the file's clock; uneven where the rate is."""
    rgb: np.ndarray
    """(H, W, 3) uint8, turned as a player shows it."""


def read_pictures(info: VideoInfo) -> Iterator[Picture]:
    """Yield the pictures of a video.

    A picture that cannot be decoded is passed over: the next one keeps its own time.

    Args:
        info: of the video, from ``probe``.

    Raises:
        VideoUnreadable: more than ``LOST_SHARE`` of the pictures are broken or missing.
    """
    number = 0
    for time_s, rgb in _pictures_of_folder(info) if info.path.is_dir() else _pictures_of_files(info):
        yield Picture(number, time_s, rgb)
        number += 1
    if number < (1.0 - LOST_SHARE) * info.num_frames:
        raise VideoUnreadable(
            f"Only {number} of the video's {info.num_frames} pictures can be decoded.", where=str(info.path), hint=AGAIN
        )


def _pictures_of_folder(info: VideoInfo) -> Iterator[tuple[float, np.ndarray]]:
    for part, time_s in zip(info.parts, info.times_s.tolist(), strict=True):
        yield from ((time_s, rgb) for _, rgb in _pictures_of_file(part))


def _pictures_of_files(info: VideoInfo) -> Iterator[tuple[float, np.ndarray]]:
    """Yield times and pictures of files one after the other, a picture's time after the last of the file before."""
    gap_s, count = 1.0 / max(info.fps, 1.0), 0
    late_s = last_s = 0.0
    for part in info.parts or (info.path,):
        begun = count
        for time_s, rgb in _pictures_of_file(part):
            if begun and count == begun:
                late_s = last_s + gap_s - time_s
            last_s = time_s + late_s if info.timed else float(info.times_s[min(count, info.num_frames - 1)])
            yield last_s, rgb
            count += 1


def _pictures_of_file(path: Path) -> Iterator[tuple[float, np.ndarray]]:
    """Yield times and pictures of one file."""
    for frame in decoded_frames(path):
        yield float(frame.time), picture_of(frame)


def decoded_frames(path: Path) -> Iterator[Any]:
    """Yield PyAV's frames of a file that have a time; what cannot be decoded is passed over."""
    invalid = library().error.InvalidDataError
    with opened(path) as container:
        stream = video_stream(container)
        stream.thread_type = "AUTO"
        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except invalid:
                continue
            yield from (frame for frame in frames if frame.time is not None)


def picture_of(frame: Any) -> np.ndarray:
    """Return (H, W, 3) uint8 of a frame of PyAV's, turned as its video asks."""
    return upright(frame.to_ndarray(format="rgb24"), frame.rotation)


def upright(rgb: np.ndarray, rotation_deg: float) -> np.ndarray:
    """Return a stored picture (H, W, 3) turned counter-clockwise as its video states."""
    turns = quarter_turn(rotation_deg) // 90
    return np.ascontiguousarray(np.rot90(rgb, turns)) if turns else rgb
