"""The skeleton that losses are measured on."""

from __future__ import annotations

import numpy as np

from solver_backend.body.rest_skeleton import MIRROR, REST_JOINTS


def test_rest_skeleton_is_symmetric_and_faces_z() -> None:
    np.testing.assert_allclose(REST_JOINTS[list(MIRROR)] * (-1.0, 1.0, 1.0), REST_JOINTS, atol=1e-12)
    assert REST_JOINTS[1, 0] > 0 and REST_JOINTS[10, 2] > REST_JOINTS[7, 2]
