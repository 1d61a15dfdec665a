"""Synchronise the cameras of a take by keypoints, keypoint speeds or sound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.evidence import SIGMAS
from solver_backend.agreement.lags import RATE_SIGMA, Signal
from solver_backend.agreement.reading import limb_keypoints
from solver_backend.agreement.synchronisation import estimate_delays
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.types import Cameras, JointSet
from solver_backend.videos.files.video import Sound, VideoWithoutSound, read_sound
from solver_backend.videos.sync.clocks import (
    Clocks,
    SyncUnknown,
    at_times,
    clocks_of_signals,
    smoothed,
)
from solver_backend.videos.video_detections import VideoDetections

BY_SPEEDS = "keypoint speeds"  # Name of the method that needs no calibration.
SPEED_RATE_HZ = 120.0  # Sample rate of the speeds.
FLOOR_S = 0.005
"""Smallest standard deviation of a lag in seconds. Sound takes 3 ms per metre, and perspective shifts speed peaks."""
SMOOTHED = 4.0  # Standard deviation of the smoothing of all signals in samples.


def clocks_by_speeds(
    names: tuple[str, ...], tracks: list[np.ndarray], times_s: list[np.ndarray], joint_set: JointSet, reach_s: float
) -> Clocks:
    """Estimate the clocks of cameras without a calibration, from the upward speeds of a person's limbs.

    Args:
        tracks: (F_c, K, 2) keypoints of the person in each view in px, NaN where missing.
        times_s: (F_c,) times of the images of each view from its first image.

    Raises:
        SyncUnknown: the speeds in a view agree with no other view.
    """
    signals = [speeds(track, when, joint_set) for track, when in zip(tracks, times_s, strict=True)]
    return clocks_of_signals(names, signals, BY_SPEEDS, reach_s=reach_s, floor_s=FLOOR_S)


def speeds(track: np.ndarray, times_s: np.ndarray, joint_set: JointSet) -> Signal:
    """Return the upward speeds of the limb keypoints in px/s, 0 where unknown."""
    columns = limb_keypoints(joint_set)
    wanted = times_s[0] + np.arange(int((times_s[-1] - times_s[0]) * SPEED_RATE_HZ) + 1) / SPEED_RATE_HZ
    if len(wanted) < 2:
        return Signal(np.zeros((len(wanted), len(columns))), SPEED_RATE_HZ, float(times_s[0]))
    height = at_times(track[:, columns, 1], times_s, wanted)
    speed = -np.gradient(smoothed(height, SMOOTHED), axis=0) * SPEED_RATE_HZ
    speed = np.where(np.isfinite(speed), speed, 0.0)
    return Signal(speed - speed.mean(axis=0), SPEED_RATE_HZ, float(times_s[0]))


SOUND_RATE_HZ = 2000  # Sample rate of the onsets.
BANDS_HZ = ((100.0, 400.0), (400.0, 1600.0), (1600.0, 6400.0))


def onsets(sound: Sound) -> Signal:
    """Return the onsets of sounds in three frequency bands, independent of the gain of the microphone.

    An onset is ``max(0, d/dt log(e + e₀))`` with the envelope e of the band and its median e₀.

    Reference: Klapuri 1999 (onsets by relative differences of bands).
    """
    samples = np.asarray(sound.samples, dtype=np.float64)
    step = sound.rate_hz // SOUND_RATE_HZ
    frequency = np.fft.rfftfreq(len(samples), 1.0 / sound.rate_hz)
    spectrum = np.fft.rfft(samples)
    columns = []
    for low, high in BANDS_HZ:
        band = np.fft.irfft(np.where((frequency >= low) & (frequency < high), spectrum, 0.0), len(samples))
        envelope = smoothed(np.abs(band), SMOOTHED * step)[::step]
        rise = np.diff(np.log(envelope + np.median(envelope) + 1e-9), prepend=0.0)
        rise[0] = 0.0
        columns.append(np.maximum(rise, 0.0))
    values = np.stack(columns, axis=1)
    return Signal(values - values.mean(axis=0), float(SOUND_RATE_HZ), sound.start_s)


MOST_FRAMES = 4000  # Largest number of frames from which clocks are refined.


@dataclass(frozen=True)
class FilmedTracks:
    """Keypoints of one person in calibrated cameras with separate clocks."""

    cameras: Cameras
    tracks: list[np.ndarray]  # (F_c, K, 2) keypoints in each view in px, NaN where missing.
    times_s: list[np.ndarray]  # (F_c,) times of the images of each view from its first image, seconds.
    joint_set: JointSet
    fps: float  # Frame rate at which the views are compared.


def clocks_by_geometry(filmed: FilmedTracks, reach_s: float) -> Clocks:
    """Estimate the clocks of calibrated cameras from a person's limbs (see ``estimate_delays``).

    Raises:
        SyncUnknown: the person moves too little, or the views agree at no offset.
    """
    names, cameras = filmed.cameras.names, filmed.cameras
    longest = max(float(when[-1]) for when in filmed.times_s)
    wanted = np.arange(int(longest * filmed.fps) + 1) / filmed.fps
    columns = limb_keypoints(filmed.joint_set)
    views = zip(filmed.tracks, filmed.times_s, strict=True)
    xy = np.stack([at_times(track[:, columns], when, wanted) for track, when in views])
    half_s = 0.5 * float(wanted[-1])
    reach = max(round(reach_s * filmed.fps), 2)
    found = estimate_delays(cameras, xy, reach, rate_sigma=RATE_SIGMA, samples=MOST_FRAMES)
    if np.isnan(found.frames).any():
        raise SyncUnknown(
            "The person moves too little or is visible too rarely to synchronise the cameras.", where=", ".join(names),
            hint="Wave both arms in view of all cameras, check that the calibration is for these cameras, or use "
            "sound: --sync sound.",
        )  # fmt: skip
    offset_s, rate = (found.frames - found.frames[0]) / filmed.fps, (found.drift - found.drift[0]) / filmed.fps / half_s
    covariance = np.zeros((len(cameras), 2, 2))
    for n, sigma in enumerate((found.sigma / filmed.fps, found.drift_sigma / filmed.fps / half_s)):
        covariance[1:, n, n] = sigma[1:] ** 2 + sigma[0] ** 2
    covariance[1:, 1, 1] /= 1 + covariance[1:, 1, 1] / (2.0 * RATE_SIGMA**2)  # both clocks of a difference vary
    return Clocks(names, offset_s, rate, covariance, half_s, "keypoints and cameras")


WAYS = ("auto", "keypoints", "sound", "none")
"""Methods. ``auto`` uses keypoints, or sound if the keypoints are not sufficient."""
REACH_S = 6.5  # Largest offset between two cameras in seconds.
IN_STEP_FRAMES = 1.0  # Largest certain offset of synchronous cameras in frames. Cameras started by hand differ by more.
ROLLING_SHUTTER = diagnostic("rolling_shutter")


def synchronise(
    found: Sequence[VideoDetections], cameras: Cameras | None, way: str = "auto", progress: Progress = silent
) -> Clocks:
    """Estimate the clocks of the cameras of a take.

    Args:
        cameras: calibrated cameras in the order of ``found``, or None without a calibration.
        way: one of ``WAYS``. If neither keypoints nor sound suffice, "auto" assumes equal clocks and warns.

    Raises:
        SyncUnknown: the method cannot determine the clocks.
        VideoWithoutSound: the method is sound, and a video has none.
    """
    names = tuple(item.name for item in found)
    if way not in WAYS:
        raise CommandLineInvalid(f"'{way}' is not a synchronisation method.", hint=f"Choose one of {', '.join(WAYS)}.")
    if way == "none" or len(found) == 1:
        return Clocks.alike(names)
    progress("Synchronising", 0, 1)
    try:
        clocks = by_sound(found) if way == "sound" else by_keypoints(found, cameras)
    except SyncUnknown as why:
        if way != "auto":
            raise
        try:
            clocks = by_sound(found)
        except (SyncUnknown, VideoWithoutSound):
            clocks = replace(Clocks.alike(names), findings=(diagnostic("clocks_assumed", reason=why.message),))
    progress("Synchronising", 1, 1)
    return in_step(clocks, float(np.median([item.fps for item in found])))


def by_keypoints(found: Sequence[VideoDetections], cameras: Cameras | None) -> Clocks:
    """Estimate the clocks from the main person's keypoints, and from the calibration unless it is None.

    Raises:
        SyncUnknown: no person moves enough, or the views do not agree.
    """
    names = tuple(item.name for item in found)
    if any(item.num_frames < 2 for item in found):
        raise SyncUnknown("A video with only one frame cannot be synchronised. Omit it.", where=", ".join(names))
    tracks = [item.of_track(item.main_track())[0] for item in found]
    times = [item.times_s - item.times_s[0] for item in found]
    if cameras is None:
        return clocks_by_speeds(names, tracks, times, found[0].joint_set, REACH_S)
    fps = float(np.median([item.fps for item in found]))
    filmed = FilmedTracks(replace(cameras, names=names), tracks, times, found[0].joint_set, fps)
    return clocks_by_geometry(filmed, REACH_S)


def by_sound(found: Sequence[VideoDetections]) -> Clocks:
    """Estimate the clocks from the sound of the videos.

    Raises:
        VideoWithoutSound: a video has no sound.
        SyncUnknown: the videos have no common sound.
    """
    signals = []
    for item in found:
        heard = read_sound(item.video)
        signals.append(onsets(replace(heard, start_s=heard.start_s - float(item.times_s[0]))))
    return clocks_of_signals(tuple(item.name for item in found), signals, "sound", reach_s=REACH_S, floor_s=FLOOR_S)


def in_step(clocks: Clocks, fps: float) -> Clocks:
    """Return the clocks, or equal clocks if their differences are uncertain, so that detections are not resampled."""
    sigma = np.sqrt(clocks.covariance[:, 0, 0])
    allowed = np.minimum(np.maximum(SIGMAS * sigma, IN_STEP_FRAMES / fps), 2.0 * IN_STEP_FRAMES / fps)
    sure = np.abs(clocks.rate) > SIGMAS * np.sqrt(clocks.covariance[:, 1, 1])
    if (np.abs(clocks.offset_s) <= allowed).all() and not sure.any():
        method = f"{clocks.method}, in sync" if clocks.method != "as filmed" else clocks.method
        return replace(Clocks.alike(clocks.names), method=method, findings=clocks.findings)
    return replace(clocks, findings=(*clocks.findings, ROLLING_SHUTTER))
