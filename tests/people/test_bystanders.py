"""A detector that took a passer-by for the person: those frames are left out, and nothing else is."""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.view_faults import exclude_bystanders
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.types import Cameras, JointSet, Keypoints2D
from tests.support.scenes import detected, ring_of_cameras, walker

COCO, FPS, FRAMES = JointSet.COCO_17, 30.0, 90


def filmed(cameras: Cameras, stolen: dict[int, slice]) -> Keypoints2D:
    """Return the detections of one walker, in some views those of another for a while."""
    rng = np.random.default_rng(0)
    xy, confidence = detected(cameras, walker(COCO, FRAMES, (-0.5, 0.0), (0.4, 0.1)), rng)
    other, sure = detected(cameras, walker(COCO, FRAMES, (1.0, 1.5), (0.1, -0.9), phase=1.0), rng)
    for view, frames in stolen.items():
        xy[view, frames], confidence[view, frames] = other[view, frames], sure[view, frames]
    return Keypoints2D(xy, confidence, COCO, FPS)


def without_strangers(cameras: Cameras, keypoints: Keypoints2D):
    return exclude_bystanders(cameras, keypoints, triangulate(cameras, keypoints.xy, keypoints.confidence))


def test_views_that_agree_on_a_passerby_are_left_out_though_they_are_as_many():
    cameras = ring_of_cameras()
    stolen = {0: slice(30, 60), 2: slice(35, 70)}
    keypoints = filmed(cameras, stolen)
    found = without_strangers(cameras, keypoints)
    assert [(s.view, s.first, s.last) for s in found.found] == [(0, 30, 59), (2, 35, 69)]
    expected = keypoints.confidence.copy()
    for view, frames in stolen.items():
        expected[view, frames] = 0.0
    np.testing.assert_array_equal(found.keypoints.confidence, expected)
    points = found.triangulation.points
    truth = walker(COCO, FRAMES, (-0.5, 0.0), (0.4, 0.1))
    assert np.nanmedian(np.linalg.norm(points - truth, axis=-1)) < 0.02


def test_thefts_that_follow_each_other_closely_are_one_stretch_and_brief_ones_are_none():
    cameras = ring_of_cameras()
    keypoints = filmed(cameras, {1: np.r_[20:26, 28:34], 3: slice(50, 53)})  # type: ignore[dict-item]
    found = without_strangers(cameras, keypoints)
    assert [(s.view, s.first, s.last) for s in found.found] == [(1, 20, 33)]
    left = found.keypoints.confidence.max(axis=-1) > 0
    assert left[1, 26:28].all() and not left[1, 20:26].any() and left[3].all()


def test_good_views_a_wrong_camera_and_two_views_are_left_as_they_are():
    cameras = ring_of_cameras()
    keypoints = filmed(cameras, {})
    assert without_strangers(cameras, keypoints).keypoints is keypoints
    elsewhere = filmed(cameras, {1: slice(None)})
    assert without_strangers(cameras, elsewhere).keypoints is elsewhere
    few = cameras.subset([0, 2])
    pair = Keypoints2D(elsewhere.xy[:2], elsewhere.confidence[:2], COCO, FPS)
    assert without_strangers(few, pair).keypoints is pair
