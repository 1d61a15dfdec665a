"""Where a solve starts: poses fitted to points, with and without the lifter's help, and the shape it sees."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.fitters.measurements.views import LocatedPoints
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Measurements, Problem
from solver_backend.fitters.single_frame import fit_to_points, lifted_betas, posed
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.positions import PositionTerm
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import JointSet

FRAMES = np.arange(8)


@pytest.fixture(scope="module")
def truth() -> dict[str, np.ndarray]:
    return demo_capture().truth


def subject(joint_set: JointSet) -> Subject:
    body = load_body()
    landmarks = keypoint_landmarks(body, joint_set)
    return Subject(body, landmarks, np.zeros(10), np.zeros((len(landmarks), 3)))


def located(person: Subject, points: np.ndarray) -> Measurements:
    covariance = np.broadcast_to(1e-4 * np.eye(3), (*points.shape, 3))
    term = PositionTerm(np.nan_to_num(points), np.isfinite(points).all(-1) * 1e4)
    return Measurements(
        person.landmarks, points, covariance, term, 60.0, LocatedPoints.of(points, person.landmarks.names)
    )


@pytest.mark.parametrize("lost", [None, "left_shoulder"])
def test_poses_meet_the_points_with_and_without_the_whole_trunk(truth, lost):
    """Without a shoulder the lifter cannot say where to start, and the start poses serve."""
    person = subject(JointSet.SMPL_24)
    points = truth["joints"][:: len(truth["joints"]) // len(FRAMES)][: len(FRAMES)].copy()
    if lost is not None:
        points[:, person.landmarks.names.index(lost)] = np.nan
    problem = Problem.of(person.body, load_sposer(), located(person, points))
    states = fit_to_points(problem, person, FRAMES)
    found = pose(person, posed(load_sposer(), states)).points
    assert np.nanmean(np.linalg.norm(found - points, axis=-1)) < 0.04


def test_shape_is_the_subjects_where_nothing_is_lifted(truth):
    person = subject(JointSet.SMPL_24)
    points = truth["joints"][: len(FRAMES)].copy()
    points[:, 16] = np.nan
    assert not np.asarray(lifted_betas(person, located(person, points), FRAMES)).any()
