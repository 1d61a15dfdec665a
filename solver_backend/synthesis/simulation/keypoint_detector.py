"""A 2D pose detector with the errors of a real one: bias, drift, jitter, self-occlusion, outliers, exchanged limbs.

Numbers marked "measured" are those of ``python -m tests.benchmarks.noise`` on the balancing trial of Pose2Sim's example
data (Pagnon et al. 2021; four cameras at 60 Hz, OpenPose BODY_25B, 100 frames). With four views the residuals against
a triangulated reference hold sqrt(5/8) of an error; measured lengths are divided by that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.view_checks.label_swaps import EXCHANGED, limb_columns
from solver_backend.synthesis.embedded.temporal_noise import autoregressive, bursts
from solver_backend.types import JointSet

_HARMONICS = np.sqrt([0.2, 0.4, 0.4, 0.4, 0.4])
"""Of a bias that turns with the person: constant, cos and sin of the angle and of its double; variance 1 everywhere."""


@dataclass(frozen=True)
class DetectorModel:
    """What the detector does wrong; lengths in millimetres at the person's distance, standard deviations per axis."""

    view_bias_mm: float = 9.0
    """Of the error that depends on where the person is seen from: measured, 21 % of the variance of 15.8 mm."""
    drift_mm: float = 17.0
    """Of the error that comes and goes: measured, 72 %."""
    drift_s: float = 0.19
    """Time constant of that: measured."""
    jitter_mm: float = 5.0
    """Of the error that is new in every frame: measured, 7 %."""
    unevenness: float = 0.43
    """Standard deviation of the logarithm of drift and jitter over views and keypoints: measured."""
    occluded_missing: float = 0.5
    """Share of runs out of sight in which the detector gives up: chosen; the face is missing 0-36 % in the
    recording, limbs at most 1 %."""
    occluded_jitter: float = 2.0
    """Factor on drift and jitter where it guesses instead: chosen."""
    missing: float = 0.005
    """Share of misses for no reason: measured, limbs and feet."""
    burst_s: float = 0.2
    """Mean length of a run of misses: measured."""
    outliers: float = 0.01
    """Share of detections that are elsewhere: measured 0.95 % beyond 100 mm."""
    outlier_mm: float = 220.0
    """How far elsewhere on average, half to one and a half times as far: measured median 223 mm."""
    outlier_s: float = 0.047
    """Mean length of their runs: measured 2.8 frames at 60 Hz."""
    swaps_per_minute: float = 6.0
    """Exchanges of left and right per limb pair and view: chosen; none in the recording's 1.7 s."""
    swap_frames: tuple[int, int] = (2, 30)
    """Shortest and longest exchange."""


@dataclass(frozen=True)
class DetectorOutput:
    """What the detector says, and what it did wrong."""

    xy: np.ndarray
    """(C, F, K, 2) px, NaN where missing."""
    confidence: np.ndarray
    """(C, F, K), 0 where missing."""
    swapped: np.ndarray
    """(C, F, K) bool: the detection is the other side's."""
    outlier: np.ndarray
    """(C, F, K) bool."""
    swaps: np.ndarray
    """(N, 4) whole numbers: view, index into ``EXCHANGED``, first frame, one past the last."""


@dataclass(frozen=True)
class Sight:
    """What there is to see of K keypoints from C cameras."""

    px: np.ndarray
    """(C, F, K, 2) true pixels."""
    px_per_mm: np.ndarray
    """(C, F, K) pixels a millimetre spans at the point."""
    seen_from: np.ndarray
    """(C, F) radians, the camera's direction about the body's upright axis, 0 in front."""
    occluded: np.ndarray
    """(C, F, K) bool, from ``self_occluded``."""
    image_size: np.ndarray
    """(C, 2)."""


def detect_keypoints(
    sight: Sight, joint_set: JointSet, fps: float, model: DetectorModel, rng: np.random.Generator
) -> DetectorOutput:
    """Return detections of true pixels.

    Args:
        sight: what there is to see.
        joint_set: names of the K keypoints.
        fps: frames per second.
        model: the detector.
        rng: seeded source of randomness.
    """
    px, occluded = sight.px, sight.occluded
    shape = px.shape[:-1]
    uneven = np.exp(model.unevenness * rng.normal(size=(shape[0], 1, shape[2], 1)) - model.unevenness**2)
    drift = model.drift_mm * autoregressive(px.shape, float(np.exp(-1.0 / (model.drift_s * fps))), rng)
    moving = uneven * (drift + model.jitter_mm * rng.normal(size=px.shape))
    moving = moving * np.where(occluded, model.occluded_jitter, 1.0)[..., None]
    error_mm = moving + model.view_bias_mm * bias_by_direction(sight.seen_from, shape[2], rng)
    outlier = bursts(rng.random(shape), model.outliers, max(1.0, model.outlier_s * fps))
    confidence = _confidence(np.linalg.norm(error_mm, axis=-1), outlier, occluded, rng)
    error_mm = error_mm + np.where(outlier[..., None], _elsewhere(shape, model, rng), 0.0)
    xy = px + error_mm * sight.px_per_mm[..., None]
    swapped, swaps = _swaps(shape, joint_set, fps, model, rng)
    mirrored = list(joint_set.mirrored())
    xy = np.where(swapped[..., None], xy[:, :, mirrored], xy)
    confidence = np.where(swapped, confidence[:, :, mirrored], confidence)
    frames = max(1.0, model.burst_s * fps)
    gives_up = occluded & bursts(rng.random(shape), model.occluded_missing, 2 * frames)
    inside = ((xy >= 0) & (xy < sight.image_size[:, None, None])).all(-1)
    missing = gives_up | bursts(rng.random(shape), model.missing, frames) | ~inside
    xy, confidence = np.where(missing[..., None], np.nan, xy), np.where(missing, 0.0, confidence)
    return DetectorOutput(xy, confidence, swapped & ~missing, outlier & ~missing, swaps)


def bias_by_direction(seen_from: np.ndarray, num_keypoints: int, rng: np.random.Generator) -> np.ndarray:
    """Return (C, F, K, 2) of unit variance: one smooth random function of the direction for each keypoint and axis.

    Cameras that see the person from the same side are wrong alike.
    """
    waves = rng.normal(size=(5, num_keypoints, 2)) * _HARMONICS[:, None, None]
    angle = seen_from[..., None]
    basis = np.concatenate(
        [np.ones_like(angle), np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)], axis=-1
    )
    return np.tensordot(basis, waves, axes=1)


def _elsewhere(shape: tuple[int, ...], model: DetectorModel, rng: np.random.Generator) -> np.ndarray:
    """Return (C, F, K, 2) millimetres to another place, which stays for the length of an outlier's run."""
    hold = np.repeat(np.arange(0, shape[1], 6), 6)[: shape[1]]
    angle, factor = rng.uniform(0, 2 * np.pi, shape)[:, hold], rng.uniform(0.5, 1.5, shape)[:, hold]
    return model.outlier_mm * factor[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _confidence(
    error_mm: np.ndarray, outlier: np.ndarray, occluded: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return confidences that tell part of the truth: measured rank correlation with the error, -0.29."""
    inlier = 0.68 - 0.0022 * error_mm - 0.15 * occluded + 0.09 * rng.normal(size=error_mm.shape)
    return np.clip(np.where(outlier, rng.uniform(0.1, 0.55, error_mm.shape), inlier), 0.05, 1.0)


def _swaps(
    shape: tuple[int, ...], joint_set: JointSet, fps: float, model: DetectorModel, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, F, K) where limbs are exchanged, and (N, 4) the exchanges; they never touch within a view and limb."""
    mask, swaps = np.zeros(shape, dtype=bool), []
    for limb, columns in enumerate(exchanged_columns(joint_set).values()):
        for view in range(shape[0]):
            for _ in range(rng.poisson(model.swaps_per_minute * shape[1] / fps / 60.0)):
                start = int(rng.integers(shape[1]))
                length = int(rng.integers(model.swap_frames[0], model.swap_frames[1] + 1))
                stop = min(start + length, shape[1])
                free = not mask[view, max(0, start - 1) : stop + 1, columns].any()
                if free and stop - start >= model.swap_frames[0]:
                    mask[view, start:stop, columns] = True
                    swaps.append((view, limb, start, stop))
    return mask, np.array(swaps, dtype=np.int64).reshape(-1, 4)


def exchanged_columns(joint_set: JointSet) -> dict[str, list[int]]:
    """Return the columns that are exchanged together, those of both sides of each pair of limbs."""
    return {limb: sorted(np.concatenate(limb_columns(joint_set, limb)).tolist()) for limb in EXCHANGED}
