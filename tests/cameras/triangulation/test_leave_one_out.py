"""What a view is expected to see comes from the others alone, with an honest covariance."""

import numpy as np
import pytest

from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import predict_views, triangulate
from tests.support.camera_ring import record, ring


@pytest.mark.parametrize("count", [3, 4, 6])
def test_it_is_the_projection_of_the_others_triangulation(count):
    cameras = ring(count)
    _, xy, confidence = record(cameras, 60, 4, 2.0)
    confidence = np.ones_like(confidence)
    found = predict_views(cameras, xy, confidence, triangulate(cameras, xy, confidence, 2.0))
    for c in range(count):
        others = [i for i in range(count) if i != c]
        points = triangulate(cameras.subset(others), xy[others], confidence[others], 2.0).points
        own = cameras.subset([c])
        expected = project(own, points)[0]
        apart = np.linalg.norm(found.px[c] - expected, axis=-1)
        assert np.nanmedian(apart) < 0.15 and np.nanquantile(apart, 0.9) < 1.5


@pytest.mark.parametrize("count", [3, 4, 6])
def test_the_distances_have_the_stated_covariance(count):
    """The squared Mahalanobis distance of the detections has the median of χ² with two degrees of freedom, 2 ln 2."""
    cameras = ring(count)
    _, xy, confidence = record(cameras, 400, 4, 2.0)
    found = predict_views(cameras, xy, confidence, triangulate(cameras, xy, np.ones_like(confidence), 2.0))
    apart = xy - found.px
    distance = np.einsum("cfki,cfkij,cfkj->cfk", apart, np.linalg.inv(found.covariance), apart)
    assert np.median(distance) == pytest.approx(2 * np.log(2), rel=0.1)


def test_a_view_does_not_tell_its_own_prediction():
    cameras = ring(4)
    _, xy, confidence = record(cameras, 50, 4, 1.0)
    off = xy.copy()
    off[2] += 300.0
    one, other = (predict_views(cameras, d, confidence, triangulate(cameras, d, confidence, 1.0)) for d in (xy, off))
    apart = np.linalg.norm(other.px[2] - one.px[2], axis=-1)
    assert np.quantile(apart, 0.95) < 0.1 and apart.max() < 10.0


def test_what_no_other_view_sees_is_unknown():
    cameras = ring(3)
    _, xy, confidence = record(cameras, 30, 2, 1.0)
    confidence[1:, 10:20, 0] = 0
    xy[1:, 10:20, 0] = np.nan
    found = predict_views(cameras, xy, confidence, triangulate(cameras, xy, confidence, 1.0))
    assert np.isnan(found.px[0, 10:20, 0]).all() and np.isfinite(found.px[1:, 10:20, 0]).all()
    assert np.isfinite(found.px[:, :10]).all() and np.isfinite(found.covariance).all()
