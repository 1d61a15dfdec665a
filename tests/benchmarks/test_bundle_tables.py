"""The tables of the method comparison: the truth scores perfectly, a method without a body leaves its cells empty."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.fitters.baselines import BaselineResult
from solver_backend.synthetic.demo import demo_capture
from solver_backend.types import Capture, Motion
from tests.benchmarks.bench_bundle import COLUMNS, judged, table, worst_joints


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=12)


def _motion(capture: Capture, joints: np.ndarray) -> Motion:
    truth = capture.truth
    return Motion(truth["betas"], truth["global_orient"], truth["body_pose"], truth["transl"], capture.fps, "b", joints)


def test_the_truth_scores_perfectly(capture: Capture) -> None:
    truth = capture.truth
    row = judged(capture, BaselineResult(truth["keypoints3d"], _motion(capture, truth["joints"])), 1.5)
    zeros = ("mpjpe_mm", "pa_mpjpe_mm", "mae_deg", "accel_m_s2", "kp_mpjpe_mm", "kp_accel_m_s2")
    assert [row[c] for c in zeros] == pytest.approx([0.0] * len(zeros), abs=1e-6)
    assert (row["pck3"], row["pck7"], row["seconds"]) == (100.0, 100.0, 1.5)
    assert tuple(row) == COLUMNS


def test_points_without_a_body_leave_cells_empty(capture: Capture) -> None:
    row = judged(capture, BaselineResult(capture.truth["keypoints3d"]), 0.1)
    assert np.isnan(row["mpjpe_mm"]) and np.isnan(row["mae_deg"]) and row["kp_mpjpe_mm"] == 0.0
    assert table({"filter": row}).splitlines()[1].split()[:3] == ["filter", "-", "-"]


def test_the_worst_joint_is_named_with_its_frame(capture: Capture) -> None:
    joints = capture.truth["joints"].copy()
    joints[:, 4, 0] += 0.02
    joints[7, 4, 0] += 0.2
    name, error_mm, frame = worst_joints(capture, BaselineResult(joints, _motion(capture, joints)), 1)[0]
    assert (name, frame) == ("left_knee", 7)
    assert error_mm == pytest.approx(20.0 + 200.0 / 12, abs=0.1)
