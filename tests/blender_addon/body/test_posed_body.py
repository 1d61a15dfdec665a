"""The posed body in NumPy against the solver's own code."""

from __future__ import annotations

from typing import Any

import numpy as np

from blender_addon._exchange.so3 import matrix_from_rotvec
from blender_addon.body.body_file import pose_joints, skin
from tests.support.addon_stand_in import bare_motion


def test_posed_joints_are_the_solvers(files: Any) -> None:
    from solver_backend.body.body import load_body
    from solver_backend.body.kinematics import forward_kinematics

    motion = files.motion
    G, joints = pose_joints(files.body.rest_joints(motion.betas), motion.rotvec, motion.transl)
    R = matrix_from_rotvec(motion.rotvec)
    expected = forward_kinematics(load_body(files.body_path), motion.betas, R[:, 0], R[:, 1:], motion.transl)
    np.testing.assert_allclose(joints, expected.joints, atol=1e-12)
    np.testing.assert_allclose(G, expected.G, atol=1e-12)


def test_skin_moves_rigidly_with_the_root(files: Any) -> None:
    """Every vertex of a body that only turns and moves is turned and moved, correctives or not."""
    still = bare_motion(files.motion, 2)
    turn, shift = np.array([0.3, -1.0, 0.5]), np.array([1.0, 2.0, 3.0])
    rotvec = np.zeros((2, 24, 3))
    rotvec[1, 0] = turn
    moved = bare_motion(files.motion, 2, rotvec=rotvec, transl=np.stack([np.zeros(3), shift]))
    rest = skin(files.body, still, [0])[0]
    np.testing.assert_allclose(rest, files.body.shaped(still.betas), atol=1e-12)
    pelvis = files.body.rest_joints(still.betas)[0]
    expected = (rest - pelvis) @ matrix_from_rotvec(turn).T + pelvis + shift
    np.testing.assert_allclose(skin(files.body, moved, [1])[0], expected, atol=1e-12)
