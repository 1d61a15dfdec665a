"""Collars that follow the arms."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.rotations import exp_so3, log_so3
from tests.support.random_poses import poses
from training.data.sources.clips import with_shoulder_rhythm


def test_rhythm_keeps_the_arm() -> None:
    R = poses(20, scale=0.8)
    R[:, [12, 13]] = np.eye(3)
    out = with_shoulder_rhythm(R)
    for collar, shoulder in ((12, 15), (13, 16)):
        np.testing.assert_allclose(out[:, collar] @ out[:, shoulder], R[:, collar] @ R[:, shoulder], atol=1e-12)
    raised = np.broadcast_to(np.eye(3), (1, 21, 3, 3)).copy()
    raised[0, 15] = exp_so3(np.array([0.0, 0.0, 1.2]))
    raised[0, 16] = exp_so3(np.array([0.0, 0.0, -1.2]))
    turned = log_so3(with_shoulder_rhythm(raised)[0, [12, 13]])
    np.testing.assert_allclose(turned, [[0, 0, 0.22 * 1.2], [0, 0, -0.22 * 1.2]], atol=1e-9)
