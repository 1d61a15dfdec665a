"""What does not average out at a joint: said by the plan of the solve, not by which unknowns are free."""

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.fitters import SolveSettings, resolve_range, solve
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.measurements.markers import measure_motion
from solver_backend.fitters.measurements.views import CONSTANT_M, OF_MARKERS_M
from solver_backend.fitters.problem import Problem
from solver_backend.priors.sposer import load_sposer
from solver_backend.synthesis.embedded.demo import record_markers
from solver_backend.types import SMPL_JOINTS, Capture
from tests.support.short_solves import QUICK

ELBOW, ANKLE = SMPL_JOINTS.index("left_elbow"), SMPL_JOINTS.index("left_ankle")


@pytest.mark.slow
def test_a_calibrated_persons_joints_are_told_alike_by_every_solve():
    """On the manifold alone, off it, and solved again: elbows are what a calibration knows least."""
    take = Capture("take", markers=record_markers(100, seed=4).cloud)
    told = solve(take, SolveSettings()).motion
    on_manifold = solve(take, SolveSettings(residual_rotations=False)).motion
    again = resolve_range(take, told, FrameRange(20, 80)).motion
    for motion in (told, on_manifold, again):
        sigma = motion.joint_sigma[25:75]
        assert (sigma[:, ELBOW] >= OF_MARKERS_M["elbow"]).all()
        assert np.median(sigma[:, ANKLE]) < CONSTANT_M
        apart = OF_MARKERS_M["elbow"] - OF_MARKERS_M["ankle"]
        assert np.median(sigma[:, ELBOW] - sigma[:, ANKLE]) > 0.75 * apart > 0.002


@pytest.mark.slow
def test_points_of_a_motion_are_no_calibrated_persons():
    """A motion without its recording is solved again from its own points: nobody calibrated markers."""
    motion = solve(Capture("take", markers=record_markers(40, seed=4).cloud), QUICK).motion
    body = load_body()
    problem = Problem.of(body, load_sposer(), measure_motion(body, motion, [], np.zeros(1)))
    np.testing.assert_array_equal(problem.measurements.source.constant_m(body.layout.recorded), np.full(24, CONSTANT_M))
