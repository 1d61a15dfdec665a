"""Measure position errors of points: MPJPE and its aligned form, RMSE and PCK (thesis 6.3.4)."""

from __future__ import annotations

from types import EllipsisType

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.exchange.errors import ShapeMismatch
from solver_backend.geometry.alignment import umeyama
from solver_backend.types import Cameras, Keypoints2D
from solver_backend.types.shapes import Float

Expected = tuple["int | str | EllipsisType", ...]  # Sizes, or names for any size. The first may be '...'.


def same_shape(found: np.ndarray, truth: np.ndarray, expected: Expected) -> tuple[np.ndarray, np.ndarray]:
    """Convert both arrays to float64. Raise ``ShapeMismatch`` if the shapes are not as expected."""
    found, truth = np.asarray(found, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if found.shape != truth.shape:
        message = f"Arrays of shapes {found.shape} and {truth.shape} cannot be compared."
        raise ShapeMismatch(message, where="metrics", hint=f"Both must be {describe(expected)}.")
    return has_shape(found, expected), truth


def has_shape(values: np.ndarray, expected: Expected, name: str = "The array") -> np.ndarray:
    """Convert the array to float64. Raise ``ShapeMismatch`` if its shape is not as expected."""
    values = np.asarray(values, dtype=np.float64)
    free = bool(expected) and expected[0] is ...
    fixed = expected[1:] if free else expected
    fits = values.ndim >= len(fixed) if free else values.ndim == len(fixed)
    sizes = values.shape[values.ndim - len(fixed) :]
    if not fits or any(isinstance(want, int) and want != got for want, got in zip(fixed, sizes, strict=True)):
        raise ShapeMismatch(f"{name} has shape {values.shape}, but {describe(expected)} is expected.", where="metrics")
    return values


def describe(expected: Expected) -> str:
    """Format an expected shape as text, such as '(..., points, 3)'."""
    return "(" + ", ".join("..." if size is ... else str(size) for size in expected) + ")"


def mean_or_nan(values: np.ndarray) -> float:
    """Return the mean of the finite values, or NaN if there are none. Unlike ``numpy.nanmean``, do not warn."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")


POINTS = (..., "points", 3)  # Shape of the compared positions in metres. Other shapes raise ``ShapeMismatch``.
Points = Float[np.ndarray, "*batch points 3"]
Track = Float[np.ndarray, "frames points 3"]


def distances_m(found: Points, truth: Points) -> Float[np.ndarray, "*batch points"]:
    """Return the (..., N) distances in metres between points and the truth, NaN if missing."""
    found, truth = same_shape(found, truth, POINTS)
    return np.linalg.norm(found - truth, axis=-1)


def mpjpe_mm(found: Points, truth: Points) -> float:
    """Return the mean distance in mm between (..., N, 3) points in metres and the truth, without alignment.

    Reference: Ionescu et al. 2014, "Human3.6M", sec. 3.
    """
    return 1000.0 * mean_or_nan(distances_m(found, truth))


def rmse_mm(found: Points, truth: Points) -> float:
    """Return the mean over frames of the RMS distance in millimetres, without alignment.

    The error is ``1/N Σ_i √(1/J Σ_j |found_ij - truth_ij|²)`` for N frames of J points (..., J, 3) in metres. Frames in
    which no point is known in both arrays are excluded. Thesis eq. 4.28 omits the square of the norm and the unit.
    """
    squared = distances_m(found, truth) ** 2
    known = np.isfinite(squared)
    count = known.sum(axis=-1)
    some = count > 0
    samples = np.where(known, squared, 0.0).sum(axis=-1)[some] / count[some]
    return 1000.0 * mean_or_nan(np.sqrt(samples))


def pa_mpjpe_mm(found: Points, truth: Points) -> float:
    """Return the mean distance in mm after aligning each frame to the truth by a similarity (PA-MPJPE, Umeyama 1991).

    Points (..., N, 3) that are missing in either array are excluded. Frames with fewer than three common points are
    also excluded.
    """
    found, truth = same_shape(found, truth, POINTS)
    found, truth = found.reshape(-1, *found.shape[-2:]), truth.reshape(-1, *truth.shape[-2:])
    both = np.isfinite(found).all(-1) & np.isfinite(truth).all(-1)
    enough = both.sum(-1) >= 3
    if not enough.any():
        return float("nan")
    found, truth, both = found[enough], truth[enough], both[enough]
    scale, R, t = umeyama(found, truth, both.astype(np.float64), with_scale=True)
    aligned = scale[:, None, None] * (found @ np.swapaxes(R, -1, -2)) + t[:, None, :]
    return 1000.0 * mean_or_nan(np.where(both, np.linalg.norm(aligned - truth, axis=-1), np.nan))


WORLD_FRAMES = 100  # Number of frames in a segment that is aligned as a whole (WHAM, SLAHMR).


def world_mpjpe_mm(found: Track, truth: Track, fitted: int = WORLD_FRAMES) -> float:
    """Return WA-MPJPE-100 in mm: the mean error after aligning each segment of 100 frames by one similarity.

    ``fitted`` = 2 gives W-MPJPE-100, where the similarity is fitted to the first two frames of each segment. A shorter
    last segment counts if it has at least two frames. References: Ye et al. 2023, "Decoupling human and camera motion
    from videos in the wild", sec. 4 (the metrics); Shin et al. 2024, "WHAM", sec. 4.
    """
    found, truth = same_shape(found, truth, ("frames", "points", 3))
    errors = []
    for start in range(0, len(found), WORLD_FRAMES):
        ours, theirs = found[start : start + WORLD_FRAMES], truth[start : start + WORLD_FRAMES]
        both = np.isfinite(ours).all(-1) & np.isfinite(theirs).all(-1)
        some = both & (np.arange(len(ours)) < fitted)[:, None]
        if some.sum() < 3 or len(ours) < 2:
            continue
        scale, R, t = umeyama(ours[some][None], theirs[some][None], np.ones((1, int(some.sum()))), with_scale=True)
        errors.append(np.linalg.norm(scale[0] * (ours @ R[0].T) + t[0] - theirs, axis=-1)[both])
    return 1000.0 * float(np.concatenate(errors).mean()) if errors else float("nan")


def pck_percent(found: Points, truth: Points, threshold_m: float) -> float:
    """Return PCK: the percentage of points (..., N, 3) within ``threshold_m`` of the truth, without alignment.

    Missing points with a known truth count as wrong. Points without truth are excluded. The thesis (6.3.4, eq. 4.29)
    reports 3 and 7 cm. Reference: Yang and Ramanan 2013, "Articulated human detection with flexible mixtures of parts".
    """
    distance = distances_m(found, truth)
    known = np.isfinite(truth).all(-1)
    return 100.0 * float((distance[known] <= threshold_m).mean()) if known.any() else float("nan")


def geodesic_deg(
    found: Float[np.ndarray, "*batch 3 3"], truth: Float[np.ndarray, "*batch 3 3"]
) -> Float[np.ndarray, " *batch"]:
    """Return angles in degrees (0 to 180) between rotations (..., 3, 3), NaN where missing.

    ``2 asin(|A - B|_F / (2 √2))`` keeps its precision at small angles, unlike the arc cosine of the trace (Hartley et
    al. 2013, "Rotation averaging", sec. 4).
    """
    found, truth = same_shape(found, truth, (..., 3, 3))
    chord = np.linalg.norm(found - truth, axis=(-2, -1)) / np.sqrt(8.0)
    return np.degrees(2.0 * np.arcsin(np.clip(chord, 0.0, 1.0)))


def angle_mae_deg(
    found: Float[np.ndarray, "*batch joints 3 3"], truth: Float[np.ndarray, "*batch joints 3 3"]
) -> float:
    """Return the mean error in degrees of relative joint rotations (..., J, 3, 3) (thesis 6.3.4)."""
    same_shape(found, truth, (..., "joints", 3, 3))
    return mean_or_nan(geodesic_deg(found, truth))


SKATING_HEIGHT_M = 0.025  # Height below which a toe counts as standing (thesis 6.3.4, H_thr).


def accelerations_m_s2(points: Track, fps: float) -> Float[np.ndarray, "accelerations points 3"]:
    """Return (F - 2, N, 3) second differences ``(x_{f+1} - 2 x_f + x_{f-1}) fps²`` in m/s² (thesis 6.3.4).

    A difference is NaN if a point is missing in one of its three frames. The result is empty for fewer than three
    frames.
    """
    points = has_shape(points, ("frames", "points", 3))
    return (points[2:] - 2.0 * points[1:-1] + points[:-2]) * fps**2


def accel_error_m_s2(found: Track, truth: Track, fps: float) -> float:
    """Return the mean acceleration error in m/s², or NaN for fewer than three frames.

    Reference: Kanazawa et al. 2019, "Learning 3D human dynamics from video", sec. 4.
    """
    found, truth = same_shape(found, truth, ("frames", "points", 3))
    difference = accelerations_m_s2(found, fps) - accelerations_m_s2(truth, fps)
    return mean_or_nan(np.linalg.norm(difference, axis=-1))


def foot_skating_cm_per_frame(toes: Float[np.ndarray, "frames toes 3"], floor_m: float = 0.0) -> float:
    """Return how far standing toes (F, N, 3) slide on the floor, in cm per frame (Z up).

    The result is the mean of ``v (2 - 2^(h/H))`` over all toes and frames, with 0 where ``h > H`` (thesis 6.3.4). ``v``
    is the horizontal distance to the next frame, ``h`` is the height above the floor (at least 0), and ``H`` is
    ``SKATING_HEIGHT_M``. The result is NaN for fewer than two frames. Reference: Mir et al. 2023, "Generating continual
    human motion in diverse 3D scenes" (thesis, reference 204).
    """
    toes = has_shape(toes, ("frames", "points", 3))
    way_cm = 100.0 * np.linalg.norm(np.diff(toes[..., :2], axis=0), axis=-1)
    height = np.maximum(toes[:-1, :, 2] - floor_m, 0.0)
    weight = np.where(height <= SKATING_HEIGHT_M, 2.0 - 2.0 ** np.minimum(height / SKATING_HEIGHT_M, 1.0), 0.0)
    return mean_or_nan(np.where(np.isfinite(height), way_cm * weight, np.nan))


_FRAMES = 2000  # Number of frames projected at a time.


def reprojection_px(
    cameras: Cameras, points: Track, keypoints: Keypoints2D
) -> Float[np.ndarray, "views frames points"]:
    """Return the reprojection errors (C, F, K) of 3D points (F, K, 3), in pixels.

    An error is NaN if the keypoint was not detected or the point is not visible. Cameras are in the order of the views.

    Raises:
        ShapeMismatch: the points do not match the detections, or the cameras do not match the views.
    """
    views, frames, count = keypoints.confidence.shape
    points = has_shape(points, (frames, count, 3), "The array of points")
    has_shape(cameras.t, (views, 3), "The cameras' translation")
    error = np.empty((views, frames, count))
    for start in range(0, frames, _FRAMES):
        part = slice(start, start + _FRAMES)
        px = project(cameras.at(part), points[part])
        error[:, part] = np.linalg.norm(px - keypoints.xy[:, part], axis=-1)
    return error


Features = Float[np.ndarray, "samples features"]


def frechet_distance(generated: Features, real: Float[np.ndarray, "others features"]) -> float:
    """Return the Fréchet distance (FID) between (N, D) features, in their squared unit.

    ``|μ_a - μ_b|² + Tr(Σ_a + Σ_b - 2 (Σ_a Σ_b)^½)``, with means μ and covariances Σ. The trace of the root is computed
    from the symmetric ``(Σ_a^½ Σ_b Σ_a^½)^½``. Reference: Heusel et al. 2017, "GANs trained by a two time-scale update
    rule", eq. 6 (thesis eqs. 4.30, 6.11).

    Raises:
        ShapeMismatch: the features are not (N, D) arrays with the same D, or contain NaN.
    """
    generated, real = _features(generated), _features(real)
    if generated.shape[1] != real.shape[1]:
        lengths = f"{generated.shape[1]} and {real.shape[1]}"
        raise ShapeMismatch(f"Features of lengths {lengths} cannot be compared.", where="metrics")
    cov_a, cov_b = (np.atleast_2d(np.cov(f, rowvar=False)) for f in (generated, real))
    values, vectors = np.linalg.eigh(cov_a)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    shared = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ cov_b @ root), 0.0)).sum()
    apart = ((generated.mean(axis=0) - real.mean(axis=0)) ** 2).sum()
    return float(apart + np.trace(cov_a) + np.trace(cov_b) - 2.0 * shared)


def diversity(features: Features, seed: int) -> float:
    """Return the diversity (DIV): the mean distance between random pairs of (N, D) features.

    One half is paired with the other half, as in the thesis (eqs. 4.31, 6.12) with 1,052 generated poses.

    Raises:
        ShapeMismatch: the features are not an (N, D) array, or contain NaN.
    """
    features = _features(features)
    order, half = np.random.default_rng(seed).permutation(len(features)), len(features) // 2
    return float(np.linalg.norm(features[order[:half]] - features[order[half : 2 * half]], axis=1).mean())


def _features(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 2 or len(values) < 2 or not np.isfinite(values).all():
        hint = "Use the shape (samples, features) with at least two samples and no NaN."
        raise ShapeMismatch(f"Features of shape {values.shape} cannot be compared.", where="metrics", hint=hint)
    return values


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """Return Spearman's ρ, the rank correlation of two (N,) lists without ties (Spearman 1904)."""
    ranks = [np.argsort(np.argsort(values)) for values in (a, b)]
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])
