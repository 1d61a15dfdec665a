"""The pixels of a camera that turned about its centre come back."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.cameras.projection import project
from solver_backend.cameras.refinement import rotated_back
from solver_backend.geometry.rotations import exp_so3
from tests.support.camera_ring import record, ring


@pytest.mark.parametrize("model", ["opencv", "fisheye"])
@pytest.mark.parametrize("rotation", [[0.0, 0.087, 0.0], [0.05, -0.03, 0.1], [0.0, 0.0, 0.0]])
def test_the_pixels_come_back(model, rotation):
    camera = ring(4, model).subset([1])
    points, _, _ = record(camera, 40, 5, 0.0)
    points = points.reshape(-1, 3)
    turn = exp_so3(np.array(rotation))
    px = project(replace(camera, R=turn @ camera.R, t=(turn @ camera.t[..., None])[..., 0]), points)[0]
    back = rotated_back(camera, px, np.array(rotation))
    before = project(camera, points)[0]
    known = np.isfinite(back).all(-1)
    assert known.mean() > 0.9
    np.testing.assert_allclose(back[known], before[known], atol=1e-4)
