"""Variances of every view's keypoints, learned from residuals whose true variances are known."""

from dataclasses import dataclass

import numpy as np
import pytest

from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.projection import project_with_jacobian
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.person_shape import RANGE, reweighted
from solver_backend.geometry.rotations import exp_so3
from solver_backend.residuals.positions import PositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.synthesis.embedded.demo import tripods
from solver_backend.types import JointSet, Keypoints2D
from tests.support.stick_body import stick_body

CAMERAS = tripods(np.array([0.0, 0.0, 0.95]))
FRAMES, VIEWS, POINTS, SIGMA_PX = 3000, len(CAMERAS), 24, 2.0
ALL = np.arange(FRAMES)


@dataclass(frozen=True)
class Recorded:
    """What the cameras see of the person, and the term of noisy detections."""

    subject: Subject
    frames: PosedFrames
    px: np.ndarray
    J: np.ndarray

    def fitted(self, noise: np.ndarray) -> np.ndarray:
        """Return what points fitted to all views leave of the noise: ``(I - J S⁻¹ Jᵀ) n`` with equal weights."""
        S = np.einsum("cflai,cflaj->flij", self.J, self.J)
        moved = np.linalg.solve(S, np.einsum("cflai,cfla->fli", self.J, noise)[..., None])
        return noise - (self.J @ moved)[..., 0]

    def learned(self, noise: np.ndarray, scale: float = 1e3) -> np.ndarray:
        """Return the (C, L) variances that are learned, in units of those assumed, which are the same for all."""
        keypoints = Keypoints2D(self.px + noise, np.ones(self.px.shape[:-1]), JointSet.SMPL_24, 60.0)
        term = ReprojectionTerm.of(CAMERAS, keypoints, np.full(POINTS, SIGMA_PX), self.px)
        after = reweighted(self.subject, self.frames, term, scale, ALL)
        assert isinstance(after, ReprojectionTerm)
        found = term.weight / after.weight
        np.testing.assert_allclose(found, found[:, :1] * np.ones((1, FRAMES, 1)), rtol=1e-9)
        return found[:, 0]

    def noise(self, variance: np.ndarray, seed: int = 3) -> np.ndarray:
        """Return noise with these (C, L) variances, in units of those assumed."""
        white = np.random.default_rng(seed).normal(size=self.px.shape)
        return SIGMA_PX * white * np.sqrt(variance)[:, None, :, None]


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    body, rng = stick_body(), np.random.default_rng(2)
    subject = Subject.average(body, keypoint_landmarks(body, JointSet.SMPL_24), np.zeros(1))
    upright = exp_so3(np.array([np.pi / 2, 0, 0]))
    frames = PosedFrames(
        upright @ exp_so3(0.3 * rng.normal(size=(FRAMES, 3))),
        exp_so3(0.2 * rng.normal(size=(FRAMES, 21, 3))),
        np.array([0, 0, 0.95]) + 0.2 * rng.normal(size=(FRAMES, 3)),
    )
    px, J, _ = project_with_jacobian(CAMERAS, pose(subject, frames).points)
    return Recorded(subject, frames, px, J)


def test_equal_views_stay_equal(recorded):
    """A point fitted to four views takes over three eighths of their errors, unevenly: the leverage accounts for it."""
    noise = recorded.fitted(recorded.noise(np.ones((VIEWS, POINTS))))
    share = (noise**2).mean((1, 3)) / SIGMA_PX**2
    assert share.min() < 0.57 < 0.68 < share.max()
    np.testing.assert_allclose(recorded.learned(noise), 1.0, atol=0.06)


def test_known_variances_are_recovered(recorded):
    """Relative to the keypoint's mean over the views, which is how they are defined.

    The body does not follow the noise here, which multiplies each view's variance by 1 / (1 - h), known from equal
    views.
    """
    variance = np.random.default_rng(4).uniform(0.5, 1.5, (VIEWS, POINTS))
    expected = variance / variance.mean(axis=0)
    equal = recorded.learned(recorded.noise(np.ones((VIEWS, POINTS))))
    found = recorded.learned(recorded.noise(variance)) / equal
    np.testing.assert_allclose(found / found.mean(axis=0), expected, rtol=0.06)


def test_one_bad_view_is_named_and_no_view_leaves_the_range(recorded):
    variance = np.ones((VIEWS, POINTS))
    variance[1, 7] = 400.0
    found = recorded.learned(recorded.noise(variance))
    # The mean over the four views is about 100: one of four hundred times its assumed variance is within the range,
    # the others are lifted to its lower end.
    lowest = np.delete(found[:, 7], 1)
    np.testing.assert_allclose(lowest, lowest[0], rtol=1e-9)
    assert 15.0 < found[1, 7] / lowest[0] <= RANGE[1] / RANGE[0] * (1 + 1e-9)
    assert 0.7 < np.delete(found, 7, axis=1).min() < np.delete(found, 7, axis=1).max() < 1.4


def test_outliers_teach_nothing(recorded):
    """Far-off detections of one view are no noise: within the robust scale the view is as good as it was."""
    noise = recorded.noise(np.ones((VIEWS, POINTS)))
    far = noise.copy()
    far[2][np.random.default_rng(5).random(noise.shape[1:-1]) < 0.2] += 100.0
    before, after = recorded.learned(noise, 4.0), recorded.learned(far, 4.0)
    np.testing.assert_allclose(after, before, rtol=0.1)
    assert np.abs(recorded.learned(far) / recorded.learned(noise) - 1).max() > 1.0


def test_points_that_are_measured_once_teach_nothing(recorded):
    subject, frames = recorded.subject, recorded.frames
    points = pose(subject, frames).points
    term = PositionTerm(points + 0.01, np.full(points.shape[:2], 1e4))
    assert reweighted(subject, frames, term, 4.0, ALL) is term
