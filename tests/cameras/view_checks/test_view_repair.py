"""Cameras that bear each other's names are found wherever the person walks."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.agreement.view_faults import repair_views
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.types import JointSet, Keypoints2D
from tests.support.scenes import detected, ring_of_cameras, walker

CAMERAS = ring_of_cameras(4)


@pytest.mark.parametrize(
    ("one", "other"), [pytest.param(0, 1, marks=pytest.mark.slow), pytest.param(0, 2, marks=pytest.mark.slow), (2, 3)]
)
def test_two_cameras_that_exchange_names_while_the_others_agree(one: int, other: int) -> None:
    """The views scatter little: those that are right outvote the two, and neither helps alone."""
    points = walker(JointSet.COCO_17, 90, (1.0, 0.8), (-0.3, -0.2))
    xy, confidence = detected(CAMERAS, points, np.random.default_rng(0))
    order = list(range(4))
    order[one], order[other] = other, one
    named = Keypoints2D(xy[order], confidence[order], JointSet.COCO_17, 30.0)
    found = repair_views(CAMERAS, named, triangulate(CAMERAS, named.xy, named.confidence))
    assert len(found.found) == 1
    if one + other == 2:  # of a ring of four, exchanging either pair that faces each other fits alike
        assert found.found[0].reading.owners in ((2, 1, 0, 3), (0, 3, 2, 1))
        assert np.asarray(found.triangulation.inliers).mean() > 0.9
    else:
        assert found.found[0].reading.owners == tuple(order)
        np.testing.assert_array_equal(found.keypoints.xy, xy)
