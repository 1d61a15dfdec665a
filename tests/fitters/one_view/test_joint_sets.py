"""Any detector's points will do for one camera: what a set lacks of head and feet costs little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.cameras.projection import project
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.lifted_take import lift_take
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.view_lifter import FACE, known_points
from solver_backend.types import Capture, JointSet, Keypoints2D
from tests.support.limb_errors import limb_errors
from tests.support.one_view_situations import filmed_walk
from tests.support.short_solves import QUICK

FRAMES = 24


@pytest.fixture(scope="module")
def walked() -> Capture:
    return filmed_walk(FRAMES)


@pytest.fixture(scope="module")
def body() -> Body:
    return load_body()


def seen_as(walked: Capture, body: Body, joint_set: JointSet) -> Capture:
    """Return the walk as a detector without errors has it whose points are of this set."""
    cameras, truth = walked.require_views()[0], walked.truth
    local = exp_so3(truth["body_pose"].reshape(FRAMES, -1, 3))[:, :21]
    landmarks = keypoint_landmarks(body, joint_set)
    posed = pose_landmarks(body, landmarks, truth["betas"], exp_so3(truth["global_orient"]), local, truth["transl"])
    xy = project(cameras, np.asarray(posed.points))
    return replace(walked, keypoints=Keypoints2D(xy, np.ones(xy.shape[:3]), joint_set, 30.0))


def lifted_mm(capture: Capture, body: Body) -> float:
    cameras, keypoints = capture.require_views()
    prior = prior_on_body(load_sposer(), body.layout)
    lifted = lift_take(cameras, keypoints, body, prior, cameras.R[0, :, 2])
    still = np.zeros((FRAMES, 3))
    joints = forward_kinematics(body, np.zeros(10), lifted.view.root, lifted.local, still).joints
    return limb_errors(np.asarray(joints), capture.truth["joints"])[0]


@pytest.mark.parametrize(
    "joint_set",
    [JointSet.COCO_17, JointSet.HALPE_26, JointSet.H36M_17, JointSet.MPII_15, JointSet.LSP_14, JointSet.SMPL_24],
)
def test_a_pose_is_lifted_from_any_set_about_as_well(walked: Capture, body: Body, joint_set: JointSet) -> None:
    most = lifted_mm(seen_as(walked, body, JointSet.BODY_25), body)
    assert lifted_mm(seen_as(walked, body, joint_set), body) < 1.15 * most


def test_a_take_without_ears_and_feet_is_solved(walked: Capture, body: Body) -> None:
    motion = solve(seen_as(walked, body, JointSet.H36M_17), QUICK).motion
    assert limb_errors(motion.joints, walked.truth["joints"])[0] < 80.0


def test_the_heads_middle_stands_for_ears_and_nose_where_a_set_has_none_and_only_there() -> None:
    points = np.array([[[0.0, 0.0], [0.0, -1.0], [0.3, -0.5]], [[0.0, 0.0], [np.nan, np.nan], [0.3, -0.5]]])
    found, sure = known_points(points, np.ones((2, 3)), ("neck", "head_top", "nose"))
    nose, ears = found[:, -1], found[:, [12, 13]]
    np.testing.assert_allclose(nose, points[:, 2])
    np.testing.assert_allclose(ears[0], [[0.0, -0.55]] * 2)
    assert sure[1, [12, 13]].tolist() == [0.0, 0.0] and set(FACE) == {"left_ear", "right_ear", "nose"}
