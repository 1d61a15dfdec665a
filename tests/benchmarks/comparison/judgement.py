"""Evaluate a result with the truth of its capture, by the measures of thesis 6.3.4 and some of our own."""

from __future__ import annotations

import numpy as np

from research.baselines import BaselineResult
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.metrics import (
    accel_error_m_s2,
    angle_mae_deg,
    foot_skating_cm_per_frame,
    mpjpe_mm,
    pa_mpjpe_mm,
    pck_percent,
    reprojection_px,
    rmse_mm,
)
from solver_backend.synthesis.simulation.keypoint_detector import exchanged_columns
from solver_backend.types import FLAG_UNSEEN, SMPL_JOINTS, Capture, JointSet, Motion

Row = dict[str, float]
COLUMNS = (
    "mpjpe_mm", "pa_mpjpe_mm", "rmse_mm", "mae_deg", "pck3", "pck7", "accel_m_s2", "kp_mpjpe_mm", "kp_accel_m_s2",
    "skating_cm_f", "reproj_px", "undone", "held50", "held80", "held95",
)  # fmt: skip
"""``kp`` are the keypoints on the body, for methods without joints. ``undone`` is the share of exchanges of at least
three frames without a trace. ``held`` is the share of true joints inside the stated 50, 80 and 95 % ellipsoids."""
HELD = {"held50": 2.366, "held80": 4.642, "held95": 7.815}
"""Quantiles of the chi-square distribution with three degrees of freedom."""
SHORTEST_EXCHANGE = 3
TRACE, TRACE_M = 1.5, 0.01
"""An exchange leaves a trace if the limb's error exceeds ``TRACE`` times its usual value by ``TRACE_M`` metres."""


def judged(capture: Capture, result: BaselineResult) -> Row:
    """Return the figures of a result. Joint and angle figures are NaN for methods without a body."""
    truth, fps = capture.truth, capture.fps
    cameras, keypoints = capture.require_multiview()
    toes = [JointSet.BODY_25.keypoints.index(f"{side}_big_toe") for side in ("left", "right")]
    row: Row = dict.fromkeys(COLUMNS, float("nan"))
    points = result.keypoints3d if result.motion is None else body_points(result.motion)
    row["kp_mpjpe_mm"] = mpjpe_mm(points, truth["keypoints3d"])
    row["kp_accel_m_s2"] = accel_error_m_s2(points, truth["keypoints3d"], fps)
    row["skating_cm_f"] = foot_skating_cm_per_frame(points[:, toes])
    row["reproj_px"] = float(np.nanmedian(reprojection_px(cameras, result.keypoints3d, keypoints)))
    row["undone"] = exchanges_undone(capture, points)
    if result.motion is None:
        return row
    joints, found = truth["joints"], result.motion.joints
    rotations = [exp_so3(pose[:, :63].reshape(-1, 21, 3)) for pose in (result.motion.body_pose, truth["body_pose"])]
    row |= {
        "mpjpe_mm": mpjpe_mm(found, joints), "pa_mpjpe_mm": pa_mpjpe_mm(found, joints),
        "rmse_mm": rmse_mm(found, joints), "pck3": pck_percent(found, joints, 0.03),
        "pck7": pck_percent(found, joints, 0.07),
        "mae_deg": angle_mae_deg(*rotations), "accel_m_s2": accel_error_m_s2(found, joints, fps),
    }  # fmt: skip
    return row | by_sight(result.motion, joints) | coverage(found, joints, result.motion.joint_covariance)


def body_points(motion: Motion) -> np.ndarray:
    """Return the (F, K, 3) keypoints of the solved body, without any detector bias that a method learned."""
    body = load_body()
    landmarks = keypoint_landmarks(body, JointSet.BODY_25)
    local = exp_so3(motion.body_pose[:, :63].reshape(-1, 21, 3))
    return pose_landmarks(body, landmarks, motion.betas, exp_so3(motion.global_orient), local, motion.transl).points


def by_sight(motion: Motion, joints: np.ndarray) -> Row:
    """Return the MPJPE of frames in which the person was visible, and of interpolated frames."""
    if motion.flags is None:
        return {}
    unseen = (motion.flags & FLAG_UNSEEN) > 0
    kinds = {"seen_mm": ~unseen, "unseen_mm": unseen}
    return {name: mpjpe_mm(motion.joints[some], joints[some]) for name, some in kinds.items() if some.any()}


def coverage(found: np.ndarray, joints: np.ndarray, covariance: np.ndarray | None) -> Row:
    """Return the percentages of true joints inside the stated ellipsoids, empty if none are stated."""
    if covariance is None:
        return {}
    error = (found - joints)[..., None]
    squared = (error * np.linalg.solve(unpacked(covariance), error)).sum((-1, -2))
    return {name: 100.0 * float((squared <= quantile).mean()) for name, quantile in HELD.items()}


def exchanges_undone(capture: Capture, points: np.ndarray) -> float:
    """Return the percentage of side exchanges without a trace in the (F, K, 3) points, NaN without exchanges."""
    swaps = capture.truth.get("swaps", np.zeros((0, 4), dtype=int))
    error = np.linalg.norm(points - capture.truth["keypoints3d"], axis=-1)
    limbs = list(exchanged_columns(JointSet.BODY_25).values())
    free = np.ones((len(points), len(limbs)), dtype=bool)
    for _, limb, start, stop in swaps:
        free[start:stop, limb] = False
    usual = [np.nanmedian(error[free[:, number]][:, limb]) for number, limb in enumerate(limbs)]
    undone = [
        float(np.nanmean(error[start:stop][:, limbs[limb]]) <= max(TRACE * usual[limb], usual[limb] + TRACE_M))
        for _, limb, start, stop in swaps
        if stop - start >= SHORTEST_EXCHANGE
    ]
    return 100.0 * float(np.mean(undone)) if undone else float("nan")


def worst_joints(capture: Capture, result: BaselineResult, count: int = 4) -> list[tuple[str, float, int]]:
    """Return the joints with the largest mean error: name, error in mm, and the worst frame of each."""
    if result.motion is None:
        return []
    error = 1000 * np.linalg.norm(result.motion.joints - capture.truth["joints"], axis=-1)
    order = np.argsort(-error.mean(axis=0))[:count]
    return [(SMPL_JOINTS[j], round(float(error[:, j].mean()), 1), int(error[:, j].argmax())) for j in order]
