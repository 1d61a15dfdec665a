"""What all body baselines start from, the same for each: triangulated points, noise, and a fixed shape.

The thesis seeds shape and first frame with an HMR regressor (6.3.2); here both come from fits to triangulated points
of frames spread over the take, which is the kinder start.
"""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.errors import NoDetections
from solver_backend.fitters.initial import observe
from solver_backend.fitters.problem import Problem, learn_subject
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.subject import Subject
from solver_backend.priors.sposer import load_sposer
from solver_backend.progress import silent
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Capture


def prepare(capture: Capture, sigma_px: float | None = None) -> tuple[Problem, Subject]:
    """Return the problem and the person with a shape that stays.

    Args:
        capture: calibrated cameras and 2D keypoints.
        sigma_px: noise of every detection; None measures each keypoint's.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
    """
    cameras, keypoints = capture.require_multiview()
    observations = observe(cameras, keypoints)
    if not observations.seen.any():
        raise NoDetections("In no frame do two cameras agree on enough keypoints to place a body.", where=capture.name)
    body, prior, like = load_body(), load_sposer(), np.zeros(1)
    count = keypoints.joint_set.num_keypoints
    measured = ReprojectionTerm.of(cameras, keypoints, observations.sigma_px, like)
    problem = Problem(body, prior, observations, measured, keypoints.fps, keypoints.num_frames, capture)
    subject = Subject(body, keypoint_landmarks(body, keypoints.joint_set), np.zeros(10), np.zeros((count, 3)))
    subject = learn_subject(problem, subject, SolveSettings(), silent)
    if sigma_px is None:
        return problem, subject
    term = ReprojectionTerm.of(cameras, keypoints, np.full(count, sigma_px), like)
    return Problem(body, prior, observations, term, keypoints.fps, keypoints.num_frames, capture), subject
