"""A solve against known truth, beside the yardstick of triangulation and filtering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.evaluation.butterworth import triangulate_and_filter
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm
from solver_backend.types import Capture, Motion


@dataclass(frozen=True)
class Evaluation:
    """Errors of a solve and of the yardstick on the same capture."""

    joints_mpjpe_mm: float
    """Solve: mean error of SMPL's 24 joints."""
    joints_accel_m_s2: float
    """Solve: mean acceleration error of the 24 joints."""
    keypoints_mpjpe_mm: float
    """Solve: mean error of the observed keypoints."""
    keypoints_accel_m_s2: float
    """Solve: mean acceleration error of the observed keypoints."""
    baseline_mpjpe_mm: float
    """Triangulation + 6 Hz Butterworth: mean error of the observed keypoints (it knows no others)."""
    baseline_accel_m_s2: float
    """Triangulation + 6 Hz Butterworth: mean acceleration error of the observed keypoints."""

    @property
    def mpjpe_ratio(self) -> float:
        """The worse of the solve's two errors over the yardstick's."""
        return max(self.joints_mpjpe_mm, self.keypoints_mpjpe_mm) / self.baseline_mpjpe_mm

    @property
    def accel_ratio(self) -> float:
        """The worse of the solve's two acceleration errors over the yardstick's."""
        return max(self.joints_accel_m_s2, self.keypoints_accel_m_s2) / self.baseline_accel_m_s2

    def lines(self) -> list[str]:
        """Return the figures as sentences for a person."""
        rows = [
            ("24 joints", self.joints_mpjpe_mm, self.joints_accel_m_s2),
            ("observed keypoints", self.keypoints_mpjpe_mm, self.keypoints_accel_m_s2),
            ("triangulation + filter", self.baseline_mpjpe_mm, self.baseline_accel_m_s2),
        ]
        lines = [f"{name:<24} {mm:7.2f} mm   acceleration error {accel:6.2f} m/s²" for name, mm, accel in rows]
        return [*lines, f"{'ratio to the filter':<24} {self.mpjpe_ratio:7.2f}      {'':<18} {self.accel_ratio:6.2f}"]


def evaluate(capture: Capture, motion: Motion) -> Evaluation:
    """Compare a solve with the truth of a synthetic capture.

    Raises:
        MotionInvalid: the capture knows no truth, or the motion has other frames.
    """
    if "joints" not in capture.truth or motion.keypoints3d is None:
        raise MotionInvalid("The capture holds no truth to compare with.", where=capture.name)
    cameras, keypoints = capture.require_multiview()
    points = np.asarray(capture.truth["keypoints3d"])
    solved, joints, _ = motion.beside_truth(np.asarray(capture.truth["joints"]))
    baseline = triangulate_and_filter(cameras, keypoints)
    return Evaluation(
        mpjpe_mm(solved, joints),
        accel_error_m_s2(solved, joints, motion.fps),
        mpjpe_mm(motion.keypoints3d, points),
        accel_error_m_s2(motion.keypoints3d, points, motion.fps),
        mpjpe_mm(baseline, points),
        accel_error_m_s2(baseline, points, motion.fps),
    )
