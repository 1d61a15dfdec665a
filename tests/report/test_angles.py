"""Joint angles of poses whose angles are known."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.joint_sets import SIDES
from solver_backend.geometry.rotations import exp_so3
from solver_backend.report import angles
from solver_backend.types import SMPL_JOINTS

STANDING = {
    "pelvis": (0, 0, 1.0), "neck": (0, 0, 1.5), "left_hip": (-0.1, 0, 0.95), "right_hip": (0.1, 0, 0.95),
    "left_knee": (-0.1, 0, 0.5), "right_knee": (0.1, 0, 0.5), "left_ankle": (-0.1, 0, 0.08),
    "right_ankle": (0.1, 0, 0.08), "left_shoulder": (-0.2, 0, 1.4), "right_shoulder": (0.2, 0, 1.4),
    "left_elbow": (-0.2, 0, 1.1), "right_elbow": (0.2, 0, 1.1), "left_wrist": (-0.2, 0, 0.85),
    "right_wrist": (0.2, 0, 0.85), "left_foot": (-0.1, 0.12, 0.02), "right_foot": (0.1, 0.12, 0.05),
}  # fmt: skip
"""A person who faces +Y, arms hanging."""
HINGES = [
    (angles.knee_flexion_deg, "left_knee", ("left_ankle",), -1),
    (angles.elbow_flexion_deg, "right_elbow", ("right_wrist",), 1),
    (angles.hip_flexion_deg, "left_hip", ("left_knee", "left_ankle"), 1),
    (angles.shoulder_elevation_deg, "right_shoulder", ("right_elbow", "right_wrist"), 1),
]


def standing(bend: str = "", carried: tuple[str, ...] = (), degrees: float = 0.0) -> np.ndarray:
    """Return one frame in which the points after a joint are turned about the side axis, forwards if positive."""
    points = {name: np.array(point, dtype=float) for name, point in STANDING.items()}
    R = exp_so3(np.radians([degrees, 0.0, 0.0]))
    for name in carried:
        points[name] = points[bend] + R @ (points[name] - points[bend])
    return np.array([[points.get(name, (0.0, 0.0, 0.0)) for name in SMPL_JOINTS]])


@pytest.mark.parametrize(("measure", "joint", "carried", "sign"), HINGES)
@pytest.mark.parametrize("degrees", [0.0, 1e-4, 30.0, 90.0, 140.0])
def test_bending_a_joint_shows_that_angle_and_no_other(measure, joint, carried, sign, degrees):
    joints = standing(joint, carried, sign * degrees)
    side, other = joint.split("_")[0], "right" if joint.startswith("left") else "left"
    assert measure(joints, side)[0] == pytest.approx(degrees, abs=1e-6)
    assert measure(joints, other)[0] == pytest.approx(0.0, abs=1e-6)


def test_the_hip_extends_to_negative_angles():
    joints = standing("right_hip", ("right_knee", "right_ankle"), -20.0)
    assert angles.hip_flexion_deg(joints, "right")[0] == pytest.approx(-20.0)


@pytest.mark.parametrize("rotvec", [(0, 0, 2.0), (0.4, -0.3, 1.0)])
def test_angles_between_limbs_do_not_depend_on_the_heading(rotvec):
    joints = standing("left_hip", ("left_knee", "left_ankle"), 35.0)
    turned = joints @ exp_so3(np.array(rotvec)).T + [1.0, 2.0, 0.0]
    for measure in (angles.knee_flexion_deg, angles.hip_flexion_deg, angles.elbow_flexion_deg):
        for side in SIDES:
            np.testing.assert_allclose(measure(turned, side), measure(joints, side), atol=1e-6)


def test_lean_and_height():
    assert angles.trunk_lean_deg(standing())[0] == pytest.approx(0.0)
    assert angles.trunk_lean_deg(standing("pelvis", ("neck",), 25.0))[0] == pytest.approx(25.0)
    assert [angles.foot_height_cm(standing(), side)[0] for side in SIDES] == pytest.approx([2.0, 5.0])
