"""The solved poses as a Motion: joints, keypoints, residuals and what deserves a look."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.body.kinematics import recorded_vectors
from solver_backend.fitters.marker_calibration.gap_filling import bone_rotations, filled
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.measurements.lost_limbs import lost_landmarks
from solver_backend.fitters.model.posed_frames import BLOCK_POSES
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.output.frame_flags import flagged
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.geometry.arrays import Array, to_numpy
from solver_backend.geometry.rotations import log_so3
from solver_backend.geometry.symmetric import mean_sigma
from solver_backend.types import MARKER_FILLED, MARKER_SEEN, Motion


def build_motion(
    measurements: Measurements, solved: SolvedFrames, *, scale: float, provenance: dict[str, Any]
) -> Motion:
    """Return the Motion of F solved frames.

    Args:
        measurements: what was solved from.
        solved: F poses.
        scale: robust scale in standard deviations, beyond twice which a measurement counts as an outlier.
        provenance: stored as it is.
    """
    subject, frames = solved.subject, solved.frames
    points, joints, bones, deviations = _posed(measurements, solved)
    reprojection_px, statistics = measurements.report(points)
    outliers = deviations[np.isfinite(deviations)] > 2 * scale
    statistics = {
        **{name: _rounded(value) for name, value in statistics.items()},
        "outliers_percent": _rounded(100 * outliers.mean()),
        "offsets_mm": [_rounded(v) for v in 1000 * np.linalg.norm(to_numpy(subject.offsets), axis=-1)],
    }
    keyframes = np.zeros(len(points), dtype=bool)
    keyframes[np.round(solved.key_times).astype(int)] = True
    covariance = None if solved.covariance is None else to_numpy(solved.covariance)
    sigma = None if covariance is None else mean_sigma(covariance)
    lost = lost_landmarks(points, measurements.points, measurements.covariance)
    return Motion(
        betas=to_numpy(subject.betas),
        global_orient=_turns(frames.root),
        body_pose=recorded_vectors(subject.body, _turns(frames.local)).reshape(len(points), -1),
        transl=to_numpy(frames.transl),
        fps=measurements.fps,
        body=subject.body.id,
        joints=joints[:, list(subject.body.recorded_joints)],
        body_layout=subject.body.layout.recorded,
        **_points(measurements, points, subject, bones),
        joint_set=measurements.joint_set,
        joint_sigma=sigma,
        joint_covariance=covariance,
        keyframes=keyframes,
        contacts=solved.contacts,
        flags=flagged(deviations, measurements.seen, sigma, lost.any(axis=1), solved.resting),
        resting=solved.resting,
        reprojection_px=None if reprojection_px is None else reprojection_px.astype(np.float32),
        provenance={**provenance, **_found(provenance, solved), "statistics": statistics},
    )


def _posed(measurements: Measurements, solved: SolvedFrames) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return points (F, L, 3), joints, bones and deviations (C, F, K), some frames at a time.

    Bones are of takes of markers alone; nobody asks for others, and they take more memory than all else.
    """
    parts = []
    for start in range(0, len(solved.frames.transl), BLOCK_POSES):
        part = slice(start, start + BLOCK_POSES)
        posed = pose(solved.subject, solved.frames.select(part))
        fitted = posed if solved.fitted is None else pose(solved.subject, solved.fitted.select(part))
        bones = posed.skeleton.G if measurements.marker_labels is not None else posed.skeleton.G[:0]
        left = measurements.term.select(part).residuals(fitted.points).deviations
        parts.append([to_numpy(a) for a in (fitted.points, posed.skeleton.joints, bones, left)])
    points, joints, bones, deviations = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(joints), np.concatenate(bones), np.concatenate(deviations, axis=1)


def _turns(rotations: Array) -> np.ndarray:
    """Return the axis-angle vectors of (F, ..., 3, 3) rotations, some frames at a time."""
    starts = range(0, rotations.shape[0], BLOCK_POSES)
    return np.concatenate([to_numpy(log_so3(rotations[start : start + BLOCK_POSES])) for start in starts])


def _points(measurements: Measurements, points: np.ndarray, subject: Subject, bones: np.ndarray) -> dict[str, Any]:
    """Return the motion's (F, L, 3) points as what they are: markers with their residuals, or keypoints."""
    if measurements.marker_labels is None:
        return {"keypoints3d": points}
    recorded, seen = measurements.points, measurements.located
    flags = np.where(seen, MARKER_SEEN, MARKER_FILLED).astype(np.uint8)
    return {
        "markers": points,
        "marker_labels": measurements.marker_labels,
        "marker_residual_mm": 1000 * np.linalg.norm(points - recorded, axis=-1),
        "marker_flags": flags if measurements.marker_flags is None else flags | measurements.marker_flags,
        "marker_sigma": measurements.marker_sigma,
        "cleaned_markers": filled(recorded, points, bone_rotations(subject.landmarks, bones), measurements.fps),
        "offsets": to_numpy(subject.offsets),
        "layout": subject.landmarks.names,
    }


def _found(provenance: dict[str, Any], solved: SolvedFrames) -> dict[str, Any]:
    """Return the diagnostics that a motion records, where these poses add any."""
    if not solved.diagnostics:
        return {}
    return {"diagnostics": [*provenance.get("diagnostics", ()), *(item.as_dict() for item in solved.diagnostics)]}


def _rounded(value: float) -> float:
    return round(float(value), 3)
