"""Detections of undistorted pictures are reported where the calibration has distortion; those as recorded never are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.epipolar_fit import report_lenses
from solver_backend.cameras.projection import distort, undistort
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, Keypoints2D

CAMERAS, KEYPOINTS = demo_capture().require_multiview()
ROWS = slice(240, 360)
"""Frames in which the person walks to the edge of the pictures."""


def pixels(n: np.ndarray) -> Keypoints2D:
    focal = np.stack([CAMERAS.K[:, 0, 0], CAMERAS.K[:, 1, 1]], -1)[:, None, None]
    xy = n * focal + CAMERAS.K[:, None, None, :2, 2]
    return replace(KEYPOINTS, xy=xy[:, ROWS], confidence=KEYPOINTS.confidence[:, ROWS])


def bent(k1: float) -> tuple[Cameras, Keypoints2D, Keypoints2D]:
    """Return cameras with another lens, detections as they record, and those of undistorted pictures."""
    distortion = np.zeros_like(CAMERAS.distortion)
    distortion[:, 0] = k1
    n = undistort(CAMERAS, KEYPOINTS.xy.astype(float))
    return replace(CAMERAS, distortion=distortion), pixels(distort(n, distortion, ("opencv",))), pixels(n)


@pytest.mark.parametrize("k1", [-0.3, -0.2, 0.2])
def test_undistorted_pixels_of_a_wide_lens_are_reported(k1: float) -> None:
    cameras, recorded, undistorted = bent(k1)
    without = replace(cameras, distortion=np.zeros_like(cameras.distortion))
    for calibrated, seen, kind in ((cameras, undistorted, "removed"), (without, recorded, "absent")):
        (found,) = report_lenses(calibrated, seen)
        assert (found.code, found.values["kind"]) == ("pixels_undistorted", kind)
    assert report_lenses(cameras, recorded) == ()
    assert report_lenses(without, undistorted) == ()


def test_the_demos_lenses_are_left_alone() -> None:
    assert report_lenses(CAMERAS, KEYPOINTS) == ()


def test_a_view_that_follows_somebody_who_crosses_is_no_witness() -> None:
    keypoints = demo_capture(120).require_multiview()[1]
    xy = keypoints.xy.copy()
    xy[3, 20:50] = xy[3, 20:50][::-1] + [260.0, 0.0]
    assert report_lenses(CAMERAS, replace(keypoints, xy=xy)) == ()
