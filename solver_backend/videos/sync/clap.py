"""Synchronise by claps of the hands, flashes of light, and sound."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.types import FEET, LIMBS, JointSet
from solver_backend.videos.files.video import Sound, VideoInfo, read_pictures
from solver_backend.videos.sync.clocks import (
    RATE_SIGMA,
    Clocks,
    PairLag,
    Signal,
    at_times,
    clocks_of_pairs,
    clocks_of_signals,
    smoothed,
)

BY_SPEEDS = "keypoint speeds"  # Method of clocks that need no calibration.
SPEED_RATE_HZ = 120.0  # Speeds are compared at so many moments per second.
SPEED_PIECE_S = 6.0
SPEED_FLOOR_S = 0.002  # Shift of a speed's peak by perspective.
SPEED_SMOOTHING_S = 0.04  # Standard deviation of the smoothing, the same for all cameras.
SPEED_CLIP_SIGMAS = 4.0  # Spreads at which a speed is clipped, chosen by hand.


def clocks_by_speeds(
    names: tuple[str, ...], tracks: list[np.ndarray], times_s: list[np.ndarray], joint_set: JointSet, reach_s: float
) -> Clocks:
    """Return the clocks of cameras that film one person, by upward speeds in sizes of the person.

    Args:
        tracks: (F_c, K, 2) px of the person in each view, NaN where missing.
        times_s: (F_c,) of each view, from its first picture.

    Raises:
        SyncUnknown: two views do not agree at any lag.
    """
    signals = [speeds(track, when, joint_set) for track, when in zip(tracks, times_s, strict=True)]
    return clocks_of_signals(names, signals, BY_SPEEDS, reach_s=reach_s, piece_s=SPEED_PIECE_S, floor_s=SPEED_FLOOR_S)


def speeds(track: np.ndarray, times_s: np.ndarray, joint_set: JointSet) -> Signal:
    """Return the upward speed of each limb's keypoint in sizes of the person a second. 0 where unknown."""
    compared = LIMBS["arms"] + LIMBS["legs"] + FEET
    columns = [k for k, name in enumerate(joint_set.keypoints) if name.endswith(compared)]
    wanted = times_s[0] + np.arange(int((times_s[-1] - times_s[0]) * SPEED_RATE_HZ) + 1) / SPEED_RATE_HZ
    if len(wanted) < 2:
        return Signal(np.zeros((len(wanted), len(columns))), SPEED_RATE_HZ, float(times_s[0]))
    points = at_times(track[:, columns], times_s, wanted)
    known = np.isfinite(points).all(-1)
    size = person_size(points)
    height = smoothed(np.where(known, points[..., 1], np.nan), SPEED_SMOOTHING_S * SPEED_RATE_HZ)
    speed = -np.gradient(height, axis=0) * SPEED_RATE_HZ / size
    speed = np.where(np.isfinite(speed), speed, 0.0)
    spread = np.sqrt((speed**2).mean(axis=0))
    clipped = np.clip(speed, -SPEED_CLIP_SIGMAS * spread, SPEED_CLIP_SIGMAS * spread)
    return Signal(clipped - clipped.mean(axis=0), SPEED_RATE_HZ, float(times_s[0]))


def person_size(points: np.ndarray) -> float:
    """Return the median height of the person in px, of (N, K, 2) points."""
    low, high = (np.where(np.isfinite(points[..., 1]), points[..., 1], v) for v in (np.inf, -np.inf))
    span = high.max(axis=1) - low.min(axis=1)
    span = span[np.isfinite(span) & (span > 0)]
    return float(np.median(span)) if len(span) else 1.0


RATE_HZ = 240.0  # The wrists are looked at at so many moments per second.
FLOOR_S = 0.008  # Standard deviation of a clap's moment in a view. Wrists are not palms.
SMOOTHING_S = 0.035  # Standard deviation of the smoothing. Hands approach each other for about 0.1 s.
NEAR = 0.25  # Largest distance of wrists in a clap, in sizes of the person in the picture.
WRISTS = ("left_wrist", "right_wrist")
LEAST_AGREEMENT = 0.3  # Least correlation of the same claps in two views.
MEDIAN_S = 0.15  # Length of the running median.
TOP_LAGS, KEPT = 8, 40  # New lags that are tried for each camera, and sets of lags that are kept.
ALIKE = 0.85  # Share of the best sum of correlations from which other lags may be true, too.
APART_S = 0.1  # Least distance of a tried lag to a better one.


def claps(track: np.ndarray, times_s: np.ndarray, joint_set: JointSet) -> Signal:
    """Return the positive second derivative of the wrists' distance, 0 where they are apart or unknown.

    ``max(0, d²/dt² |l - r| / size)`` with the distance smoothed by a running median and a Gaussian. Left and right may
    be exchanged.

    Args:
        track: (F, K, 2) px of the person, NaN where missing.
        times_s: (F,) from the video's first picture.
    """
    left, right = (joint_set.keypoints.index(name) for name in WRISTS)
    apart = np.linalg.norm(track[:, left] - track[:, right], axis=-1) / person_size(track)
    fps = (len(times_s) - 1) / max(float(times_s[-1] - times_s[0]), 1e-9)
    apart = _median(apart, 2 * max(round(0.5 * MEDIAN_S * fps), 1) + 1)
    wanted = times_s[0] + np.arange(int((times_s[-1] - times_s[0]) * RATE_HZ) + 1) / RATE_HZ
    smooth = smoothed(at_times(apart, times_s, wanted), SMOOTHING_S * RATE_HZ)
    turn = np.gradient(np.gradient(smooth)) * RATE_HZ**2
    sharp = np.where(np.isfinite(turn) & (smooth < NEAR), np.maximum(np.nan_to_num(turn), 0.0), 0.0)
    return Signal((sharp / max(float(np.sqrt((sharp**2).sum())), 1e-9))[:, None], RATE_HZ, float(times_s[0]))


def _median(values: np.ndarray, length: int) -> np.ndarray:
    """Return (F,) running medians, NaN where most values are missing."""
    padded = np.pad(values, length // 2, constant_values=np.nan)
    around = np.sort(np.lib.stride_tricks.sliding_window_view(padded, length), axis=-1)  # what is missing comes last
    count = np.isfinite(around).sum(-1)
    middle = np.take_along_axis(around, np.maximum(count - 1, 0)[:, None] // 2, axis=-1)[:, 0]
    return np.where(2 * count > length, middle, np.nan)


def clocks_by_claps(names: tuple[str, ...], signals: list[Signal], reach_s: float) -> Clocks:
    """Return the clocks of cameras by claps. Rates cannot be found.

    Sets of lags are built camera by camera. The sets with the largest sums of correlations over all pairs are kept.
    Least squares of the pairs' lags near the best set give the clocks.

    Args:
        signals: of each, see ``claps``.

    Raises:
        SyncUnknown: a camera saw no clap that another saw.
    """
    pairs = {
        pair: _agreement(signals[pair[0]], signals[pair[1]], reach_s) for pair in combinations(range(len(names)), 2)
    }
    sets: list[tuple[float, list[int]]] = [(0.0, [0])]
    for c in range(1, len(names)):
        longer = []
        for score, lags in sets:
            # What camera c would see of a clap at lag l of the first one, by all cameras before it.
            summed = sum((_shifted(pairs[i, c], lag) for i, lag in enumerate(lags)), np.zeros_like(pairs[0, 1]))
            longer += [(score + float(summed[at]), [*lags, at - len(summed) // 2]) for at in _tops(summed)]
        sets = sorted(longer, key=lambda item: -item[0])[:KEPT]
    best, lags = sets[0]
    by_pair = {}
    for (i, j), agreement in pairs.items():
        found = _near(agreement, lags[j] - lags[i])
        if found is not None:
            shift = signals[j].start_s - signals[i].start_s
            spread = np.diag([2.0 * FLOOR_S**2, RATE_SIGMA**2])
            by_pair[i, j] = PairLag(found[0] / RATE_HZ + shift, 0.0, spread, 0.0, found[1])
    clocks = clocks_of_pairs(names, by_pair, "claps")
    return replace(clocks, findings=(*clocks.findings, *_doubts(names, best, lags, sets[1:])))


def _doubts(
    names: tuple[str, ...], best: float, lags: list[int], others: list[tuple[float, list[int]]]
) -> list[Diagnostic]:
    """Report each camera with claps that fit nearly as well at another lag."""
    found: list[Diagnostic] = []
    for c in range(1, len(names)):
        rivals = [
            other[c] - lags[c]
            for score, other in others
            if score > ALIKE * best and abs(other[c] - lags[c]) > APART_S * RATE_HZ
        ]
        if rivals:
            off_ms = 1e3 * rivals[0] / RATE_HZ
            found.append(diagnostic("claps_ambiguous", cameras=[names[c]], off_ms=off_ms))
    return found


def _agreement(first: Signal, second: Signal, reach_s: float) -> np.ndarray:
    """Return (2 L + 1,) correlations at lags of -L to L samples.

    They are not normalised by the overlap: claps are few, and a single one agrees with any other.
    """
    a, b = first.values, second.values
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    product = np.fft.irfft(np.fft.rfft(b, size, axis=0) * np.conj(np.fft.rfft(a, size, axis=0)), size, axis=0)
    reach = min(round(reach_s * RATE_HZ), size // 2 - 1)
    return product[:, 0][np.arange(-reach, reach + 1)]


def _shifted(values: np.ndarray, by: int) -> np.ndarray:
    """Return values moved up by so many samples, 0 where unknown."""
    moved = np.zeros_like(values)
    if abs(by) < len(values):
        moved[max(by, 0) : len(values) + min(by, 0)] = values[max(-by, 0) : len(values) - max(by, 0)]
    return moved


def _tops(values: np.ndarray) -> list[int]:
    """Return the places of the highest values that are apart."""
    left, tops = values.copy(), []
    for _ in range(TOP_LAGS):
        at = int(np.argmax(left))
        tops.append(at)
        left[max(at - round(APART_S * RATE_HZ), 0) : at + round(APART_S * RATE_HZ) + 1] = -np.inf
    return tops


def _near(agreement: np.ndarray, lag: int) -> tuple[float, float] | None:
    """Return the best lag near one in samples, between samples by a parabola, and how well it agrees. None if badly."""
    middle, reach = len(agreement) // 2 + lag, round(0.5 * APART_S * RATE_HZ)
    low, high = max(middle - reach, 1), min(middle + reach + 1, len(agreement) - 1)
    if high <= low:
        return None
    at = low + int(np.argmax(agreement[low:high]))
    if agreement[at] < LEAST_AGREEMENT:
        return None
    before, top, after = agreement[at - 1 : at + 2]
    bend = before - 2.0 * top + after
    part = float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
    return at - len(agreement) // 2 + part, float(top)


FLASH_RATE_HZ, FLASH_PIECE_S = 240.0, 10.0  # Rate of the compared brightness, and length of a piece.
COARSE = 16  # Step of rows and columns.
CLIP_SIGMAS = 8.0  # Spreads at which a change of brightness is clipped, chosen by hand.


def brightness_signal(info: VideoInfo) -> Signal:
    """Return the rate of change of a video's median brightness."""
    times, level = [], []
    for picture in read_pictures(info):
        times.append(picture.time_s)
        level.append(float(np.median(picture.rgb[::COARSE, ::COARSE])))
    times_s = np.array(times) - times[0]
    wanted = np.arange(int(times_s[-1] * FLASH_RATE_HZ) + 1) / FLASH_RATE_HZ
    change = np.gradient(np.interp(wanted, times_s, np.array(level))) if len(wanted) > 1 else np.zeros(1)
    spread = max(float(np.std(change)), 1e-9)
    change = np.clip(change, -CLIP_SIGMAS * spread, CLIP_SIGMAS * spread)
    return Signal((change - change.mean())[:, None], FLASH_RATE_HZ)


SOUND_RATE_HZ = 2000  # Samples per second of the onsets: half a millisecond, and peaks are found between samples.
BANDS_HZ = ((100.0, 400.0), (400.0, 1600.0), (1600.0, 6400.0))
PIECE_S = 8.0  # Length of a compared piece of sound.
SOUND_FLOOR_S = 0.005  # Sound needs 3 ms for a metre, and microphones stand some metres apart.
SOUND_SMOOTHING_S = 0.002  # Standard deviation of the smoothing of loudness, seconds, chosen by hand.


def onsets(sound: Sound) -> Signal:
    """Return how fast the logarithm of the loudness rises in three bands, independent of a microphone's gain.

    ``max(0, d/dt log(e + e₀))`` with e the envelope of a band and e₀ its median.

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
