"""What microphones hear alike: the onsets of sounds in bands of pitch."""

from __future__ import annotations

import numpy as np

from solver_backend.videos.files.video import Sound
from solver_backend.videos.sync.signals import Signal

RATE_HZ = 2000
"""Samples a second of the onsets: half a millisecond, and peaks are found between samples."""
BANDS_HZ = ((100.0, 400.0), (400.0, 1600.0), (1600.0, 6400.0))
PIECE_S = 8.0
FLOOR_S = 0.005
"""Sound needs 3 ms for a metre, and microphones stand some metres apart."""
SMOOTHING_S = 0.002
"""Standard deviation of the smoothing of loudness, seconds; chosen by hand."""


def onsets(sound: Sound) -> Signal:
    """Return how fast the logarithm of the loudness rises in three bands, whatever a microphone's gain.

    ``max(0, d/dt log(e + e₀))`` with e the envelope of a band and e₀ its median; made by one FFT over the whole.

    Reference: Klapuri 1999 (onsets by relative differences of bands).
    """
    samples = np.asarray(sound.samples, dtype=np.float64)
    step = sound.rate_hz // RATE_HZ
    frequency = np.fft.rfftfreq(len(samples), 1.0 / sound.rate_hz)
    spectrum = np.fft.rfft(samples)
    reach = max(round(3 * SMOOTHING_S * sound.rate_hz), 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (SMOOTHING_S * sound.rate_hz)) ** 2)
    columns = []
    for low, high in BANDS_HZ:
        band = np.fft.irfft(np.where((frequency >= low) & (frequency < high), spectrum, 0.0), len(samples))
        envelope = np.convolve(np.abs(band), kernel / kernel.sum(), "same")[::step]
        rise = np.diff(np.log(envelope + np.median(envelope) + 1e-9), prepend=0.0)
        rise[0] = 0.0
        columns.append(np.maximum(rise, 0.0))
    values = np.stack(columns, axis=1)
    return Signal(values - values.mean(axis=0), float(RATE_HZ), sound.start_s)
