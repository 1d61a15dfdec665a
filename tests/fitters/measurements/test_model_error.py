"""What a fit allows beside a detector's noise: the body's own error at the person's distance."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.measurements.views import MODEL_ERROR_M, fit_sigma_px
from tests.support.camera_ring import ring


def test_exact_detections_are_trusted_as_far_as_the_body_can_follow() -> None:
    cameras = ring(3)
    points = np.zeros((4, 5, 3))
    points[2] = np.nan
    points[3, :2] = np.nan
    sigma = fit_sigma_px(cameras, points, np.array([0.0, 0.1, 1.0, 5.0, 50.0]))
    assert sigma.shape == (3, 4, 5)
    assert np.isfinite(sigma).all() and np.array_equal(sigma[:, 2], sigma[:, 0])
    depth = cameras.t[:, 2]
    np.testing.assert_allclose(sigma[:, :, 0], np.tile(MODEL_ERROR_M * cameras.K[:, 0, 0] / depth, (4, 1)).T)
    assert (np.diff(sigma[0, 0]) > 0).all()
    assert 50.0 < sigma[0, 0, -1] < 50.3


def test_a_person_nearby_may_be_missed_by_more_pixels() -> None:
    cameras = ring(2)
    towards = cameras.R[0, 2]
    near, far = (np.tile(-metres * towards, (1, 5, 1)) for metres in (1.5, -1.5))
    sigma_near, sigma_far = (fit_sigma_px(cameras, points, np.zeros(5))[0, 0, 0] for points in (near, far))
    assert sigma_near > 1.5 * sigma_far
