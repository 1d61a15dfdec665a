"""Shape and detector bias: known values recovered from a sample of frames."""

import numpy as np
import pytest

from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.projection import project
from solver_backend.fitters.model.subject import FrameObjective, FrameStates, Subject, pose
from solver_backend.fitters.person_shape import ShapePrior, fit_shape
from solver_backend.fitters.single_frame import posed
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import exp_so3
from solver_backend.residuals.pose_mixture import PoseMixtureTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.solver.levenberg_marquardt import LMSettings
from solver_backend.synthesis.embedded.demo import tripods
from solver_backend.types import JointSet, Keypoints2D
from tests.support.stick_body import stick_body
from tests.support.toy_prior import ToyPrior

FRAMES = 24


@pytest.fixture
def scene():
    rng = np.random.default_rng(5)
    body, prior = stick_body(), ToyPrior()
    landmarks = keypoint_landmarks(body, JointSet.SMPL_24)
    offsets = np.zeros((24, 3))
    offsets[15] = [0.0, 0.02, 0.01]
    truth = Subject(body, landmarks, np.array([1.2, -0.7, *np.zeros(8)]), offsets)
    root = exp_so3(np.array([np.pi / 2, 0, 0])) @ exp_so3(0.3 * rng.normal(size=(FRAMES, 3)))
    transl = np.array([0, 0, 0.95]) + 0.1 * rng.normal(size=(FRAMES, 3))
    states = FrameStates(spherical_normalisation(rng.normal(size=(FRAMES, 32))), root, transl)
    points = pose(truth, posed(prior, states)).points
    cameras = tripods(np.array([0.0, 0.0, 0.95]))
    px = project(cameras, points)
    keypoints = Keypoints2D(px + rng.normal(size=px.shape), np.ones(px.shape[:-1]), JointSet.SMPL_24, 60.0)
    term = ReprojectionTerm.of(cameras, keypoints, np.full(24, 1.0), points)
    start = FrameStates(states.z, states.root, states.transl + 0.01 * rng.normal(size=(FRAMES, 3)))
    # The made-up decoder's poses are no people's: what people's poses are like has no say.
    return truth, prior, FrameObjective((term,), (PoseMixtureTerm(weight=0.0),)), start


def test_shape_and_bias_are_recovered(scene):
    truth, prior, objective, start = scene
    blank = Subject(truth.body, truth.landmarks, np.zeros(10), np.zeros((24, 3)))
    found, states = fit_shape(blank, prior, objective, start, (9.0, 3.0), LMSettings(10), ShapePrior(evidence=1.0))
    np.testing.assert_allclose(found.betas[:2], truth.betas[:2], atol=0.1)
    np.testing.assert_allclose(found.offsets[15], truth.offsets[15], atol=0.006)
    lengths = [np.linalg.norm(np.diff(s.body.rest_joints(s.betas)[[4, 7]], axis=0)) for s in (found, truth)]
    assert lengths[0] == pytest.approx(lengths[1], abs=0.004)
    assert np.linalg.norm(states.transl - start.transl, axis=1).max() < 0.1


def test_a_known_shape_is_kept(scene):
    truth, prior, objective, start = scene
    known = Subject(truth.body, truth.landmarks, truth.betas, np.zeros((24, 3)))
    found, _ = fit_shape(known, prior, objective, start, (3.0,), LMSettings(5), ShapePrior(free_betas=False))
    np.testing.assert_allclose(found.betas, truth.betas, atol=1e-6)
