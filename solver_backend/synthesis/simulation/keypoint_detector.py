"""A 2D pose detector with the errors of a real one: bias, drift, jitter, self-occlusion, outliers, exchanged limbs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.agreement.label_swaps import EXCHANGED, limb_columns
from solver_backend.synthesis.embedded.temporal_noise import autoregressive, bursts
from solver_backend.synthesis.faults import DetectorFaults
from solver_backend.types import JointSet

_HARMONICS = np.sqrt([0.2, 0.4, 0.4, 0.4, 0.4])
"""Of a bias that turns with the person: constant, cos and sin of the angle and of its double; variance 1 everywhere."""


@dataclass(frozen=True)
class DetectorOutput:
    """What the detector returns, and what it did wrong."""

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
    sight: Sight, joint_set: JointSet, fps: float, faults: DetectorFaults, rng: np.random.Generator
) -> DetectorOutput:
    """Return detections of true pixels.

    Args:
        sight: what there is to see.
        joint_set: names of the K keypoints.
        fps: frames per second.
        faults: of the detector.
        rng: seeded source of randomness.
    """
    px, occluded = sight.px, sight.occluded
    shape = px.shape[:-1]
    uneven = np.exp(faults.unevenness * rng.normal(size=(shape[0], 1, shape[2], 1)) - faults.unevenness**2)
    drift = faults.drift_mm * autoregressive(px.shape, float(np.exp(-1.0 / (faults.drift_s * fps))), rng)
    moving = uneven * (drift + faults.jitter_mm * rng.normal(size=px.shape))
    moving = moving * np.where(occluded, faults.occluded_jitter, 1.0)[..., None]
    error_mm = moving + faults.view_bias_mm * bias_by_direction(sight.seen_from, shape[2], rng)
    outlier = bursts(rng.random(shape), faults.outliers, max(1.0, faults.outlier_s * fps))
    confidence = _confidence(np.linalg.norm(error_mm, axis=-1), outlier, occluded, rng)
    error_mm = error_mm + np.where(outlier[..., None], _elsewhere(shape, faults, rng), 0.0)
    xy = px + error_mm * sight.px_per_mm[..., None]
    swapped, swaps = _swaps(shape, joint_set, fps, faults, rng)
    mirrored = list(joint_set.mirrored())
    xy = np.where(swapped[..., None], xy[:, :, mirrored], xy)
    confidence = np.where(swapped, confidence[:, :, mirrored], confidence)
    frames = max(1.0, faults.burst_s * fps)
    gives_up = occluded & bursts(rng.random(shape), faults.occluded_missing, 2 * frames)
    inside = ((xy >= 0) & (xy < sight.image_size[:, None, None])).all(-1)
    missing = gives_up | bursts(rng.random(shape), faults.missing, frames) | ~inside
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


def _elsewhere(shape: tuple[int, ...], faults: DetectorFaults, rng: np.random.Generator) -> np.ndarray:
    """Return (C, F, K, 2) millimetres to another place, which stays for the length of an outlier's run."""
    hold = np.repeat(np.arange(0, shape[1], 6), 6)[: shape[1]]
    angle, factor = rng.uniform(0, 2 * np.pi, shape)[:, hold], rng.uniform(0.5, 1.5, shape)[:, hold]
    return faults.outlier_mm * factor[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _confidence(
    error_mm: np.ndarray, outlier: np.ndarray, occluded: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return confidences that carry part of the truth: measured rank correlation with the error, -0.29."""
    inlier = 0.68 - 0.0022 * error_mm - 0.15 * occluded + 0.09 * rng.normal(size=error_mm.shape)
    return np.clip(np.where(outlier, rng.uniform(0.1, 0.55, error_mm.shape), inlier), 0.05, 1.0)


def _swaps(
    shape: tuple[int, ...], joint_set: JointSet, fps: float, faults: DetectorFaults, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return (C, F, K) where limbs are exchanged, and (N, 4) the exchanges; they never touch within a view and limb."""
    mask, swaps = np.zeros(shape, dtype=bool), []
    for limb, columns in enumerate(exchanged_columns(joint_set).values()):
        for view in range(shape[0]):
            for _ in range(rng.poisson(faults.swaps_per_minute * shape[1] / fps / 60.0)):
                start = int(rng.integers(shape[1]))
                length = int(rng.integers(faults.swap_frames[0], faults.swap_frames[1] + 1))
                stop = min(start + length, shape[1])
                free = not mask[view, max(0, start - 1) : stop + 1, columns].any()
                if free and stop - start >= faults.swap_frames[0]:
                    mask[view, start:stop, columns] = True
                    swaps.append((view, limb, start, stop))
    return mask, np.array(swaps, dtype=np.int64).reshape(-1, 4)


def exchanged_columns(joint_set: JointSet) -> dict[str, list[int]]:
    """Return the columns that are exchanged together, those of both sides of each pair of limbs."""
    return {limb: sorted(np.concatenate(limb_columns(joint_set, limb)).tolist()) for limb in EXCHANGED}
