"""What a video is, found without decoding it: its pictures' times, rate, size and rotation, and its sound."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.io.footage import parts_of
from solver_backend.videos.files.container import AGAIN, opened, video_stream
from solver_backend.videos.files.errors import VideoUnreadable

VARIABLE_SHARE = 0.02
"""A video has a variable rate where more than this share of its intervals is off ..."""
OFF_SHARE = 0.2
"""... the median interval by more than this share of it."""


@dataclass(frozen=True)
class VideoInfo:
    """A video of F pictures."""

    path: Path
    """The file, the first of several chapters, or a folder of pictures."""
    size: tuple[int, int]
    """Width and height in pixels as a player shows it, that is, after the rotation."""
    times_s: np.ndarray
    """(F,) when each picture is shown, ascending, on the file's clock."""
    parts: tuple[Path, ...] = ()
    """Its files in order, see ``parts_of``; () where it is one file."""
    timed: bool = True
    """Whether the file times its pictures; else they are taken as even, at the rate that it states."""

    @property
    def num_frames(self) -> int:
        """Number of pictures."""
        return len(self.times_s)

    @property
    def fps(self) -> float:
        """Pictures a second, see ``rate_of``."""
        return rate_of(self.times_s)

    @property
    def variable(self) -> bool:
        """Whether the pictures come at uneven intervals, as phones film in poor light."""
        gaps = np.diff(self.times_s)
        if len(gaps) < 2:
            return False
        usual = float(np.median(gaps))
        return bool((np.abs(gaps - usual) > OFF_SHARE * usual).mean() > VARIABLE_SHARE)


UNTIMED_SHARE = 0.5
"""A file whose pictures have at most this share of different times, such as 0 for all, does not time them."""
PICTURES_FPS = 30.0
"""Pictures a second of a folder of pictures, which does not state it."""


def probe(path: Path | str, pictures_fps: float = PICTURES_FPS) -> VideoInfo:
    """Return what a video is; its packets are counted and its first picture is decoded.

    Chapters of one recording are one video, and so are the pictures of a folder.

    Args:
        path: a video, the first chapter of a recording, or a folder of pictures.
        pictures_fps: rate of pictures.

    Raises:
        BackendMissing: PyAV is not installed.
        VideoUnreadable: the file is missing, empty, broken, holds no pictures or none that can be decoded.
    """
    path = Path(path)
    parts = parts_of(path)
    if path.is_dir():
        if not parts:
            raise VideoUnreadable("The folder holds no picture.", where=str(path), hint="Check the path.")
        first = _probe_file(parts[0])
        return replace(first, path=path, times_s=np.arange(len(parts)) / pictures_fps, parts=parts)
    found = [_probe_file(part) for part in parts]
    if any(item.size != found[0].size for item in found):
        raise VideoUnreadable("Its chapters differ in size.", where=str(path), hint="Keep recordings apart.")
    times = [found[0].times_s]
    for item in found[1:]:
        times.append(item.times_s - item.times_s[0] + times[-1][-1] + 1.0 / max(found[0].fps, 1.0))
    return replace(found[0], times_s=np.concatenate(times), parts=parts if len(parts) > 1 else ())


def _probe_file(path: Path) -> VideoInfo:
    with opened(path) as container:
        stream = video_stream(container)
        base = stream.time_base
        stated = float(stream.codec_context.framerate or stream.base_rate or 0.0)
        stamps = [packet.pts for packet in container.demux(stream) if packet.pts is not None and packet.size]
    if not stamps:
        raise VideoUnreadable("The video holds no picture.", where=str(path), hint=AGAIN)
    with opened(path) as container:
        first = next(container.decode(video_stream(container)), None)
    if first is None:
        raise VideoUnreadable("No picture of the video can be decoded.", where=str(path), hint=AGAIN)
    size = (first.height, first.width) if quarter_turn(first.rotation) % 180 else (first.width, first.height)
    times = np.unique(np.array(stamps, dtype=np.float64)) * float(base)
    if len(times) <= UNTIMED_SHARE * len(stamps) and stated > 0:
        return VideoInfo(path, size, np.arange(len(stamps)) / stated, timed=False)
    return VideoInfo(path, size, times)


def rate_of(times_s: np.ndarray) -> float:
    """Return pictures a second: one over the mean of the usual intervals (times may be rounded, pictures dropped).

    Args:
        times_s: (F,) ascending; 0 comes back of fewer than two.
    """
    if len(times_s) < 2:
        return 0.0
    gaps = np.diff(times_s)
    usual = float(np.median(gaps))
    return float(1.0 / gaps[np.abs(gaps - usual) <= OFF_SHARE * usual].mean())


def quarter_turn(degrees: float) -> int:
    """Return the nearest of 0, 90, 180 and 270 degrees."""
    return round(degrees / 90.0) * 90 % 360
