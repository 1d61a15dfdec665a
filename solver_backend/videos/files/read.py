"""The pictures of a video one after the other, upright and with their true times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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
    invalid = library().error.InvalidDataError
    number = 0
    with opened(info.path) as container:
        stream = video_stream(container)
        stream.thread_type = "AUTO"
        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except invalid:
                continue
            for frame in frames:
                if frame.time is None:
                    continue
                yield Picture(number, float(frame.time), upright(frame.to_ndarray(format="rgb24"), frame.rotation))
                number += 1
    if number < (1.0 - LOST_SHARE) * info.num_frames:
        raise VideoUnreadable(
            f"Only {number} of the video's {info.num_frames} pictures can be decoded.", where=str(info.path), hint=AGAIN
        )


def upright(rgb: np.ndarray, rotation_deg: float) -> np.ndarray:
    """Return a stored picture (H, W, 3) turned counter-clockwise as its video says."""
    turns = quarter_turn(rotation_deg) // 90
    return np.ascontiguousarray(np.rot90(rgb, turns)) if turns else rgb


def picture_at(path: Path | str, number: int) -> Picture:
    """Return one picture of a video by its number.

    Raises:
        VideoUnreadable: it has fewer pictures, or cannot be read.
    """
    from solver_backend.videos.files.probe import probe

    info = probe(path)
    for picture in read_pictures(info):
        if picture.number == number:
            return picture
    raise VideoUnreadable(f"The video has no picture {number}.", where=str(path))
