"""Compute signals that reveal differences of camera clocks: keypoint speeds and sound."""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.reading import limb_keypoints
from solver_backend.types import JointSet
from solver_backend.videos.files.video import Sound
from solver_backend.videos.sync.clocks import Clocks, Signal, at_times, clocks_of_signals, smoothed

BY_SPEEDS = "keypoint speeds"  # Method for clocks that needs no calibration.
SPEED_RATE_HZ = 120.0  # Rate at which speeds are compared.
PIECE_S = 6.0  # Length of a compared piece.
SPEED_FLOOR_S = 0.002  # Shift of a speed peak by perspective.
SPEED_CLIP = 4.0  # Clipping limit in standard deviations. With 3, clocks of mostly still takes are 30 % worse.
SPEED_SMOOTHING_S = 0.04  # Standard deviation of the smoothing, the same for all cameras.


def clocks_by_speeds(
    names: tuple[str, ...], tracks: list[np.ndarray], times_s: list[np.ndarray], joint_set: JointSet, reach_s: float
) -> Clocks:
    """Estimate the clocks of cameras that record one person, from upward speeds.

    Args:
        tracks: (F_c, K, 2) keypoints of the person in each view in px, NaN where missing.
        times_s: (F_c,) times of each view from its first image.

    Raises:
        SyncUnknown: two views agree at no lag.
    """
    signals = [speeds(track, when, joint_set) for track, when in zip(tracks, times_s, strict=True)]
    return clocks_of_signals(names, signals, BY_SPEEDS, reach_s=reach_s, piece_s=PIECE_S, floor_s=SPEED_FLOOR_S)


def speeds(track: np.ndarray, times_s: np.ndarray, joint_set: JointSet) -> Signal:
    """Return the upward speed of each limb's keypoint in pixels per second, 0 where unknown."""
    columns = limb_keypoints(joint_set)
    wanted = times_s[0] + np.arange(int((times_s[-1] - times_s[0]) * SPEED_RATE_HZ) + 1) / SPEED_RATE_HZ
    if len(wanted) < 2:
        return Signal(np.zeros((len(wanted), len(columns))), SPEED_RATE_HZ, float(times_s[0]))
    height = at_times(track[:, columns, 1], times_s, wanted)
    speed = -np.gradient(smoothed(height, SPEED_SMOOTHING_S * SPEED_RATE_HZ), axis=0) * SPEED_RATE_HZ
    speed = np.where(np.isfinite(speed), speed, 0.0)
    spread = np.sqrt((speed**2).mean(axis=0))
    clipped = np.clip(speed, -SPEED_CLIP * spread, SPEED_CLIP * spread)
    return Signal(clipped - clipped.mean(axis=0), SPEED_RATE_HZ, float(times_s[0]))


SOUND_RATE_HZ = 2000  # Samples of the onsets per second. Peaks are located between samples.
BANDS_HZ = ((100.0, 400.0), (400.0, 1600.0), (1600.0, 6400.0))
SOUND_FLOOR_S = 0.005  # Sound needs 3 ms per metre, and microphones are some metres apart.
SOUND_SMOOTHING_S = 0.002  # Standard deviation of the loudness smoothing in seconds, chosen by hand.


def onsets(sound: Sound) -> Signal:
    """Return the rate of increase of log-loudness in three bands, free of gain.

    The rate is ``max(0, d/dt log(e + e₀))`` with e the envelope of a band and e₀ its median.

    Reference: Klapuri 1999 (onsets by relative differences of bands).
    """
    samples = np.asarray(sound.samples, dtype=np.float64)
    step = sound.rate_hz // SOUND_RATE_HZ
    frequency = np.fft.rfftfreq(len(samples), 1.0 / sound.rate_hz)
    spectrum = np.fft.rfft(samples)
    reach = max(round(3 * SOUND_SMOOTHING_S * sound.rate_hz), 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (SOUND_SMOOTHING_S * sound.rate_hz)) ** 2)
    columns = []
    for low, high in BANDS_HZ:
        band = np.fft.irfft(np.where((frequency >= low) & (frequency < high), spectrum, 0.0), len(samples))
        envelope = np.convolve(np.abs(band), kernel / kernel.sum(), "same")[::step]
        rise = np.diff(np.log(envelope + np.median(envelope) + 1e-9), prepend=0.0)
        rise[0] = 0.0
        columns.append(np.maximum(rise, 0.0))
    values = np.stack(columns, axis=1)
    return Signal(values - values.mean(axis=0), float(SOUND_RATE_HZ), sound.start_s)
