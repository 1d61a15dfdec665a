"""The sound of a video on the clock of its pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.videos.files.container import library, opened
from solver_backend.videos.files.errors import VideoWithoutSound

RATE_HZ = 16_000
"""Samples a second that sound is brought to."""
SILENCE = 1e-5
"""Root mean square, of full scale 1, below which there is only silence."""


@dataclass(frozen=True)
class Sound:
    """Sound of one channel."""

    samples: np.ndarray
    """(N,) float32, full scale 1."""
    start_s: float
    """When the first sample is heard, on the clock of the pictures."""
    rate_hz: int = RATE_HZ
    """Samples a second."""


def read_sound(path: Path | str) -> Sound:
    """Return the sound of a video, mixed to one channel.

    Raises:
        BackendMissing, VideoUnreadable: see ``opened``.
        VideoWithoutSound: there is none, or it is silent.
    """
    path, parts, start = Path(path), [], None
    hint = "Film with the microphone on, or synchronise by keypoints."
    with opened(path) as container:
        if not container.streams.audio:
            raise VideoWithoutSound("The video has no sound.", where=str(path), hint=hint)
        resampler = library().AudioResampler(format="flt", layout="mono", rate=RATE_HZ)
        for frame in container.decode(container.streams.audio[0]):
            start = frame.time if start is None else start
            parts += [piece.to_ndarray()[0] for piece in resampler.resample(frame)]
        if parts:
            parts += [piece.to_ndarray()[0] for piece in resampler.resample(None)]
    samples = np.concatenate(parts).astype(np.float32) if parts else np.zeros(0, np.float32)
    if not len(samples) or float(np.sqrt(np.mean(samples.astype(np.float64) ** 2))) < SILENCE:
        raise VideoWithoutSound("The sound of the video is silence.", where=str(path), hint=hint)
    return Sound(samples, float(start or 0.0), RATE_HZ)
