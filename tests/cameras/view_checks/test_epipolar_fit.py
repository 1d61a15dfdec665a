"""Slopes of the distances from epipolar lines are those of central differences; what is off is recovered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.epipolar_fit import ComparedViews
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import JointSet, Keypoints2D
from tests.support.scenes import detected, ring_of_cameras, walker

CAMERAS, KEYPOINTS = demo_capture().require_multiview()


def off_at(views: ComparedViews, x: np.ndarray) -> np.ndarray:
    return np.concatenate([off for _, off, *_ in views.distances(x)])


@pytest.mark.parametrize("model", ["opencv", "fisheye"])
def test_slopes_are_those_of_central_differences(model: str) -> None:
    compared = ComparedViews.of(CAMERAS, KEYPOINTS)
    assert compared is not None
    cameras, xy = compared.cameras, compared.xy
    cameras, xy = replace(cameras, models=(model,), distortion=cameras.distortion * 0.3), xy[:, ::6]
    views = ComparedViews(cameras, xy)
    x = np.random.default_rng(0).normal(0.0, 0.01, 1 + 3 * len(cameras))
    J = np.zeros((len(off_at(views, x)), len(x)))
    row = 0
    for columns, off, slopes, _ in views.distances(x):
        J[row : row + len(off), columns] = slopes
        row += len(off)
    step = 1e-6 * np.eye(len(x))
    central = np.stack([(off_at(views, x + d) - off_at(views, x - d)) / 2e-6 for d in step], axis=-1)
    np.testing.assert_allclose(J, central, atol=1e-4 * np.abs(central).max())


def test_the_fit_recovers_a_factor_and_a_turn() -> None:
    compared = ComparedViews.of(CAMERAS, KEYPOINTS)
    assert compared is not None
    cameras, xy = compared.cameras, compared.xy
    K = cameras.K.copy()
    K[:, [0, 1], [0, 1]] /= 1.08
    fit = ComparedViews(replace(cameras, K=K), xy).fit()
    assert fit is not None and abs(fit.log - np.log(1.08)) < 3 * fit.sigma < 0.1


def test_a_person_between_cameras_that_face_each_other_does_not_make_the_fit_surer() -> None:
    """Close to an epipole, an epipolar line has any direction."""
    cameras, rng = ring_of_cameras(4), np.random.default_rng(1)
    xy, confidence = detected(cameras, walker(JointSet.COCO_17, 120, (0.0, 0.0), (0.0, 0.0)), rng)
    xy = xy + rng.normal(0.0, 6.0, (4, 1, xy.shape[2], 2))  # constant errors of each view's keypoints
    views = ComparedViews.of(cameras, Keypoints2D(xy, confidence, JointSet.COCO_17, 30.0))
    assert views is not None and (fit := views.fit()) is not None
    assert abs(fit.log) < 3 * fit.sigma


def test_nothing_is_known_of_nobody() -> None:
    assert ComparedViews(CAMERAS, np.full((len(CAMERAS), 3, 25, 2), np.nan)).fit() is None


def test_cameras_in_one_place_are_not_compared() -> None:
    t = CAMERAS.t.copy()
    t[1] = -CAMERAS.R[1] @ CAMERAS.centres[0]
    compared = ComparedViews.of(replace(CAMERAS, t=t), KEYPOINTS)
    assert compared is not None and np.isfinite(off_at(compared, np.zeros(1 + 3 * len(CAMERAS)))).all()
    assert (fit := compared.fit()) is None or np.isfinite(fit.log)
