"""The deviation of each angle: against differences, for resting parts, and against the errors of a solve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.biomechanics.joint_angles import ISB, isb_angles, successive_turns, turn_deviations
from solver_backend.biomechanics.segments import SEGMENTS, posed_segments, turn_covariance, turn_covariances
from solver_backend.body.body import load_body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.geometry.small_matrices import packed
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Motion
from tests.support.still_pose import still

DOF, STEP = 3 * 22 + 3, 1e-6


def posed() -> Motion:
    rng = np.random.default_rng(3)
    pose = np.zeros((1, 23, 3))
    pose[:, :21] = 0.5 * rng.normal(size=(1, 21, 3))
    return replace(still(), body_pose=pose.reshape(1, -1), global_orient=rng.normal(size=(1, 3)))


def moved(motion: Motion, tangent: np.ndarray) -> Motion:
    """Return a motion with every rotation turned from the left by its part of a tangent."""
    turns = exp_so3(tangent[: 3 * 22].reshape(22, 3))
    pose = motion.body_pose.reshape(1, 23, 3).copy()
    pose[0, :21] = log_so3(turns[1:] @ exp_so3(pose[0, :21]))
    root = log_so3(turns[:1] @ exp_so3(motion.global_orient))
    return replace(motion, global_orient=root, body_pose=pose.reshape(1, -1))


def covariance_of(motion: Motion, pose: np.ndarray) -> np.ndarray:
    local = exp_so3(motion.body_pose.reshape(1, 23, 3)[:, :21])
    return turn_covariance(load_body(), local, pose[None], np.zeros(24))


def test_deviations_of_all_angles_are_their_derivatives_along_a_step():
    """A covariance d dᵀ makes each deviation the size of the angle's derivative along d."""
    motion, rng = posed(), np.random.default_rng(0)
    for _ in range(3):
        d = rng.normal(size=DOF)
        known = covariance_of(motion, np.outer(d, d))
        segments = posed_segments(motion, load_body())
        covariances = dict(zip(SEGMENTS, np.moveaxis(known, 1, 0), strict=True))
        for segment in SEGMENTS:
            rule = ISB.get(segment.removeprefix("left_").removeprefix("right_"))
            if rule is None:
                continue
            turns = [
                successive_turns(posed_segments(m, load_body()).relative(segment), rule.axes)
                for m in (motion, moved(motion, STEP * d), moved(motion, -STEP * d))
            ]
            if segment.endswith(("upper_arm", "forearm")):
                continue  # The elbow's hinge is found in the take and turns with it, see below.
            stated = turn_deviations(turns[0], rule.axes, segments, segment, covariances)
            numeric = np.abs(turns[1] - turns[2]) / (2 * STEP)
            assert np.abs(np.minimum(numeric, np.pi) - stated).max() < 1e-4 * (1 + numeric.max()), segment


def test_arms_have_derivatives_too_while_their_hinge_is_known():
    bend = still(1, left_elbow=np.array([0.0, -1.0, 0.0]), right_elbow=np.array([0.0, 1.0, 0.0]))
    d = np.zeros(DOF)
    d[3 * SMPL.joints.index("right_elbow") : 3 * SMPL.joints.index("right_elbow") + 3] = [0.0, 1.0, 0.0]
    covariances = dict(zip(SEGMENTS, np.moveaxis(covariance_of(bend, np.outer(d, d)), 1, 0), strict=True))
    found = isb_angles(posed_segments(bend, load_body()), covariances)
    deviation = dict(zip(found.names, found.deviations[0], strict=True))
    assert deviation["right_elbow_flexion"] == pytest.approx(np.degrees(1.0), rel=0.01)
    assert deviation["left_elbow_flexion"] < 1e-9 and deviation["right_knee_flexion"] < 1e-9


def test_parts_at_rest_have_no_deviation():
    resting = np.zeros((1, 24), dtype=bool)
    resting[:, SMPL.joints.index("right_ankle")] = True
    motion = replace(
        still(), turn_covariance=packed(np.tile(1e-4 * np.eye(3), (1, len(SEGMENTS), 1, 1))), resting=resting
    )
    found = isb_angles(posed_segments(motion, load_body()), turn_covariances(motion))
    unknown = {name for name, sd in zip(found.names, found.deviations[0], strict=True) if np.isnan(sd)}
    assert unknown == {name for name in found.names if name.startswith("right_knee")}
    assert turn_covariances(still()) is None


@pytest.mark.slow
def test_deviations_cover_the_errors_of_a_simulated_take():
    """Simulated views. Turns about a limb's long axis are left out: keypoints do not show them (biomechanics.md)."""
    capture = demo_capture()
    motion, truth = solve(capture).motion, capture.truth
    body, names = load_body(), ("betas", "global_orient", "body_pose", "transl")
    true = isb_angles(posed_segments(replace(motion, **{name: truth[name] for name in names}), body))
    found = isb_angles(posed_segments(motion, body), turn_covariances(motion))
    kept = [k for k, name in enumerate(found.names) if not name.endswith(("rotation", "pronation"))]
    off = np.abs((found.degrees - true.degrees + 180.0) % 360.0 - 180.0)[:, kept]
    assert (off < 1.96 * found.deviations[:, kept]).mean() > 0.9
    assert (off < 0.3 * found.deviations[:, kept]).mean() < 0.6  # and they are not far too wide
