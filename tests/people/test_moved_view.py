"""A camera that was knocked after its calibration is no other shape of pictures, and a cut is no knock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.moved_view import agreement_if_turned, meeting_points
from solver_backend.agreement.picture_shapes import NEARER, with_shapes
from solver_backend.agreement.reading_scores import ReadingScores
from solver_backend.cameras.camera_corrections import CameraCorrection
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras

DEMO = demo_capture(80)
assert DEMO.cameras is not None and DEMO.keypoints is not None
CAMERAS = DEMO.cameras.subset([0, 1, 2])
XY, CONFIDENCE = DEMO.keypoints.xy[:3, ::10].copy(), DEMO.keypoints.confidence[:3, ::10]
AS_WRITTEN = [CameraCorrection()] * 3


def knocked(c: int, axis: int, degrees: float) -> Cameras:
    turn = exp_so3(np.radians(degrees) * np.eye(3)[axis])
    R, t = CAMERAS.R.copy(), CAMERAS.t.copy()
    R[c], t[c] = turn @ R[c], turn @ t[c]
    return replace(CAMERAS, R=R, t=t)


@pytest.mark.parametrize(("c", "axis", "degrees"), [(0, 1, 9.0), (2, 0, 13.0), (1, 1, -7.0)])
def test_a_camera_that_was_turned_is_no_other_shape(c: int, axis: int, degrees: float) -> None:
    scores = ReadingScores(knocked(c, axis, degrees), XY, CONFIDENCE)
    as_it_stood = ReadingScores(CAMERAS, XY, CONFIDENCE).within(NEARER).of(AS_WRITTEN)
    assert agreement_if_turned(scores.within(NEARER), AS_WRITTEN, c) >= as_it_stood - 0.02
    assert with_shapes(scores, AS_WRITTEN) == AS_WRITTEN


@pytest.mark.parametrize("shape", ["square", "cut to a square"])
def test_one_camera_of_square_pictures(shape: str) -> None:
    """Cut, as a phone does it for a feed, and squeezed, as a detector's input is."""
    xy = XY.copy()
    xy[1, ..., 0] = (xy[1, ..., 0] + 0.5) * 1080 / 1920 - 0.5 if shape == "square" else xy[1, ..., 0] - 420
    confidence = np.where((xy[..., 0] < 0) | (xy[..., 0] >= [[[1920]], [[1080]], [[1920]]]), 0.0, CONFIDENCE)
    expected = [CameraCorrection(shape=shape if c == 1 else "") for c in range(3)]
    assert with_shapes(ReadingScores(CAMERAS, xy, confidence), AS_WRITTEN) == expected


def test_rays_meet_where_points_are() -> None:
    points = np.random.default_rng(0).normal(size=(2, 5, 3)) + [0, 0, 1]
    views = []
    for R, t in zip(CAMERAS.R, CAMERAS.t, strict=True):
        seen = points @ R.T + t
        views.append((seen[..., :2] / seen[..., 2:], R, t))
    for x, _, _ in views[1:]:
        x[0, 0] = np.nan
    met = meeting_points(views)
    assert np.isnan(met[0, 0]).all()
    np.testing.assert_allclose(met[1], points[1], atol=1e-9)
