"""A 2D pose detector with the errors of a real one: bias, drifting jitter, self-occlusion, outliers, exchanged limbs.

Numbers marked "measured" are those of ``python -m tests.benchmarks.noise`` on the balancing trial of Pose2Sim's example
data (Pagnon et al. 2021; four cameras at 60 Hz, OpenPose BODY_25B, 100 frames). With four views the residuals against
a triangulated reference hold sqrt(5/8) of an error; measured lengths are divided by that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types import JointSet

REFERENCE_FPS = 60.0
_ARM, _LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "big_toe", "small_toe", "heel")


@dataclass(frozen=True)
class DetectorModel:
    """What the detector does wrong; lengths in millimetres at the person's distance."""

    view_bias_mm: float = 24.0
    """Standard deviation per axis of each view's slow error: measured 27 mm root mean square length."""
    view_bias_s: float = 1.0
    """Time constant of that error as the person turns: chosen, the recording is too short to tell."""
    jitter_mm: float = 10.9
    """Standard deviation of the jitter per axis: measured 8.6 mm."""
    correlation: float = 0.80
    """Lag-one correlation of the jitter at 60 Hz: measured."""
    occluded_missing: float = 0.5
    """Share of stretches out of sight in which the detector gives up: chosen; the face is missing 0-36 % in the
    recording, limbs at most 1 %."""
    occluded_jitter: float = 2.5
    """Factor on the jitter where it guesses instead: chosen."""
    missing: float = 0.005
    """Share of misses for no reason: measured, limbs and feet."""
    burst_frames: float = 12.0
    """Mean length of a run of misses: measured."""
    outliers: float = 0.02
    """Share of detections that are elsewhere: measured 3.3 % beyond 100 mm, of which bias explains a part."""
    outlier_mm: float = 180.0
    """How far elsewhere on average, at least a third of it: chosen; the measured ones lie at 117 mm."""
    swaps_per_minute: float = 6.0
    """Exchanges of left and right per limb pair and view: chosen; none in the recording's 1.7 s."""
    swap_frames: tuple[int, int] = (2, 30)
    """Shortest and longest exchange."""


@dataclass(frozen=True)
class Detections:
    """What the detector says, and what it did wrong."""

    xy: np.ndarray
    """(C, F, K, 2) px, NaN where missing."""
    confidence: np.ndarray
    """(C, F, K), 0 where missing."""
    swapped: np.ndarray
    """(C, F, K) bool: the detection is the other side's."""
    outlier: np.ndarray
    """(C, F, K) bool."""


def detect_keypoints(
    px: np.ndarray, px_per_mm: np.ndarray, occluded: np.ndarray, image_size: np.ndarray, joint_set: JointSet,
    fps: float, model: DetectorModel, rng: np.random.Generator,
) -> Detections:  # fmt: skip
    """Return detections of true pixels.

    Args:
        px: (C, F, K, 2) true pixels.
        px_per_mm: (C, F, K) pixels a millimetre spans at the point.
        occluded: (C, F, K) bool, from ``self_occluded``.
        image_size: (C, 2).
        joint_set: names of the K keypoints.
        fps: frames per second; correlations are converted from 60 Hz.
        model: the detector.
        rng: seeded source of randomness.
    """
    shape = px.shape[:-1]
    ratio = REFERENCE_FPS / fps
    slow = model.view_bias_mm * autoregressive(px.shape, float(np.exp(-1.0 / (model.view_bias_s * fps))), rng)
    fast = model.jitter_mm * autoregressive(px.shape, model.correlation**ratio, rng)
    fast = fast * np.where(occluded, model.occluded_jitter, 1.0)[..., None]
    outlier = rng.random(shape) < model.outliers
    angle, radius = rng.uniform(0, 2 * np.pi, shape), model.outlier_mm * rng.uniform(1 / 3, 5 / 3, shape)
    elsewhere = np.where(outlier, radius, 0.0)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    error_mm = slow + fast + elsewhere
    xy = px + error_mm * px_per_mm[..., None]
    confidence = _confidence(np.linalg.norm(slow + fast, axis=-1), outlier, occluded, rng)
    swapped = _swaps(shape, joint_set, fps, model, rng)
    mirrored = list(joint_set.mirrored())
    xy = np.where(swapped[..., None], xy[:, :, mirrored], xy)
    confidence = np.where(swapped, confidence[:, :, mirrored], confidence)
    frames = max(1.0, model.burst_frames / ratio)
    gives_up = occluded & bursts(shape, model.occluded_missing, 2 * frames, rng)
    inside = ((xy >= 0) & (xy < image_size[:, None, None])).all(-1)
    missing = gives_up | bursts(shape, model.missing, frames, rng) | ~inside
    xy, confidence = np.where(missing[..., None], np.nan, xy), np.where(missing, 0.0, confidence)
    return Detections(xy, confidence, swapped & ~missing, outlier & ~missing)


def _confidence(
    error_mm: np.ndarray, outlier: np.ndarray, occluded: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return confidences that tell part of the truth: measured rank correlation with the error, -0.14."""
    told = 0.82 - 0.0012 * error_mm - 0.15 * occluded + 0.09 * rng.normal(size=error_mm.shape)
    return np.clip(np.where(outlier, rng.uniform(0.2, 0.85, error_mm.shape), told), 0.05, 1.0)


def _swaps(
    shape: tuple[int, ...], joint_set: JointSet, fps: float, model: DetectorModel, rng: np.random.Generator
) -> np.ndarray:
    """Return (C, F, K) where a pair of limbs is exchanged in a view, for stretches of ``swap_frames``."""
    names = joint_set.keypoints
    mask = np.zeros(shape, dtype=bool)
    for parts in (_ARM, _LEG):
        columns = [k for k, name in enumerate(names) if name.split("_", 1)[-1] in parts and "_" in name]
        for view in range(shape[0]):
            for _ in range(rng.poisson(model.swaps_per_minute * shape[1] / fps / 60.0)):
                start = int(rng.integers(shape[1]))
                length = int(rng.integers(model.swap_frames[0], model.swap_frames[1] + 1))
                mask[view, start : start + length, columns] = True
    return mask


def autoregressive(shape: tuple[int, ...], correlation: float, rng: np.random.Generator) -> np.ndarray:
    """Return unit-variance noise along axis 1: ``x_t = a x_{t-1} + sqrt(1 - a²) e_t``."""
    noise = rng.normal(size=shape)
    for f in range(1, shape[1]):
        noise[:, f] = correlation * noise[:, f - 1] + np.sqrt(1 - correlation**2) * noise[:, f]
    return noise


def bursts(shape: tuple[int, ...], share: float, length: float, rng: np.random.Generator) -> np.ndarray:
    """Return a mask with runs along axis 1: a two-state Markov chain of this share and mean run length."""
    leave = 1.0 / length
    enter = leave * share / (1.0 - share)
    draws = rng.random(shape)
    mask = draws < share
    for f in range(1, shape[1]):
        mask[:, f] = np.where(mask[:, f - 1], draws[:, f] >= leave, draws[:, f] < enter)
    return mask
