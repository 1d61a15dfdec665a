"""The solved poses as a Motion: joints, keypoints, residuals and what deserves a look."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.output.frame_flags import flagged
from solver_backend.fitters.single_frame.start import Observations
from solver_backend.geometry.arrays import to_numpy
from solver_backend.geometry.rotations import log_so3
from solver_backend.geometry.symmetric import mean_sigma
from solver_backend.types import NUM_JOINTS, Capture, Motion


def build_motion(
    capture: Capture,
    subject: Subject,
    frames: PosedFrames,
    observations: Observations,
    *,
    key_times: np.ndarray,
    covariance: Any | None,
    scale: float,
    contacts: np.ndarray | None = None,
    provenance: dict[str, Any],
) -> Motion:
    """Return the Motion of F solved frames.

    Args:
        capture: what was solved.
        subject: the person.
        frames: F poses.
        observations: triangulation and noise.
        key_times: frame numbers of the keyframes (may fall between frames).
        covariance: (F, 24, 6) of each joint in square metres (see ``packed``), if the method knows it.
        scale: robust scale in standard deviations, beyond which a detection counts as an outlier.
        contacts: (F, 2) bool, left and right foot stand, if the method knows it.
        provenance: stored as it is.
    """
    cameras, keypoints = capture.require_multiview()
    posed = pose(subject, frames)
    points, joints = to_numpy(posed.points), to_numpy(posed.skeleton.joints)
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, points, cameras.distortion_model)
    error = np.linalg.norm(px - keypoints.xy, axis=-1)
    rotvec = to_numpy(log_so3(frames.local)).reshape(len(points), -1)
    body_pose = np.concatenate([rotvec, np.zeros((len(points), 3 * (NUM_JOINTS - 1) - rotvec.shape[1]))], axis=1)
    keyframes = np.zeros(len(points), dtype=bool)
    keyframes[np.round(key_times).astype(int)] = True
    normalised = error / observations.sigma_px
    spread = None if covariance is None else to_numpy(covariance)
    sigma = None if spread is None else mean_sigma(spread)
    outliers = normalised[np.isfinite(normalised)] > 2 * scale
    statistics = {
        "reprojection_median_px": _rounded(np.nanmedian(error)),
        "reprojection_rmse_px": _rounded(np.sqrt(np.nanmean(error**2))),
        "outliers_percent": _rounded(100 * outliers.mean()),
        "offsets_mm": [_rounded(v) for v in 1000 * np.linalg.norm(to_numpy(subject.offsets), axis=-1)],
    }
    return Motion(
        betas=to_numpy(subject.betas),
        global_orient=to_numpy(log_so3(frames.root)),
        body_pose=body_pose,
        transl=to_numpy(frames.transl),
        fps=keypoints.fps,
        body=subject.body.id,
        joints=joints,
        keypoints3d=points,
        joint_set=keypoints.joint_set,
        joint_sigma=sigma,
        joint_covariance=spread,
        keyframes=keyframes,
        contacts=contacts,
        flags=flagged(normalised, observations.seen, sigma),
        reprojection_px=error.astype(np.float32),
        provenance={**provenance, "statistics": statistics},
    )


def _rounded(value: float) -> float:
    return round(float(value), 3)
