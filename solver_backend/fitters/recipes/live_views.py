"""Live from views: one moment's keypoints at a time, reprojected as in a solve, variances learned as in chapter 5."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.triangulation.triangulate import Triangulation, triangulate
from solver_backend.fitters.measurements.sources import fit_sigma_px
from solver_backend.fitters.model.states import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.recipes.live import PersonFollower
from solver_backend.priors.lifter import load_lifter
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.landmark_loss import LearnedVariances
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Cameras, JointSet, Keypoints2D

SIGMA_PX = 4.0
"""Standard deviation of a detection per axis at 720 lines, before its variance is learned; detectors have 3 to 6."""
LINES = 720.0
"""Height of a picture that ``SIGMA_PX`` is for."""
FEWEST = 6
"""Located keypoints without which a moment has no pose of its own, as in a solve."""

UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Root of a body that stands with Z up."""


@dataclass(frozen=True)
class ViewsFrame:
    """One moment, fitted."""

    pose: PosedFrames
    """One pose."""
    points: np.ndarray
    """(L, 3) metres: located keypoints, NaN where fewer than two views agree."""
    landmarks: np.ndarray
    """(L, 3) metres: where the body has the keypoints."""
    points_off_m: np.ndarray
    """(L,) metres between each of them and where the body has it; NaN where it is not located."""


class LiveViewsFit(PersonFollower):
    """Follows a person by the keypoints of calibrated views."""

    def __init__(self, body: Body, cameras: Cameras, joint_set: JointSet, betas: np.ndarray | None = None) -> None:
        """Take the body, the cameras, what is detected, and the (10,) shape of a person who is known."""
        super().__init__(Subject.average(body, keypoint_landmarks(body, joint_set), np.zeros(0)), betas)
        self.cameras, self.joint_set = cameras, joint_set
        self._sigma_px = SIGMA_PX * float(np.median(cameras.image_size[:, 1])) / LINES
        self._sposer = prior_on_body(load_sposer(), body.layout)
        self._penalty = LearnedVariances().penalty

    def locate(self, xy: np.ndarray, confidence: np.ndarray) -> Triangulation:
        """Return one moment's keypoints in space.

        Args:
            xy: (C, L, 2) px, NaN where missing.
            confidence: (C, L), 0 where missing.
        """
        return triangulate(self.cameras, xy[:, None], confidence[:, None], self._sigma_px)

    def step(self, xy: np.ndarray, confidence: np.ndarray, located: Triangulation, dt: float) -> ViewsFrame:
        """Fit a moment.

        Args:
            xy: (C, L, 2) px, NaN where missing.
            confidence: (C, L), 0 where missing.
            located: what ``locate`` returns of them; at least ``FEWEST`` points.
            dt: seconds since the last moment.
        """
        points = np.asarray(located.points)
        keypoints = Keypoints2D(xy[:, None], confidence[:, None], self.joint_set, 1.0)
        sigma = fit_sigma_px(self.cameras, points, np.asarray(located.sigma_px))
        term = replace(ReprojectionTerm.of(self.cameras, keypoints, sigma, points), penalty=self._penalty)
        landmarks = self.follow(term, dt, partial(self._start, points)).points[0]
        off = np.linalg.norm(landmarks - points[0], axis=-1)
        assert self.pose is not None
        return ViewsFrame(self.pose, points[0], landmarks, off)

    def _start(self, points: np.ndarray) -> PosedFrames:
        """Return the pose that the lifter sees in (1, L, 3) points, or the rest pose at their middle."""
        seen = np.isfinite(points).all(-1)
        lifted = load_lifter()(np.where(seen[..., None], points, 0.0), seen, self.subject.landmarks.names)
        rest = self.subject.body.rest_joints(self.subject.betas)[0]
        if not bool(np.asarray(lifted.usable)[0]):
            return PosedFrames(UPRIGHT[None], self.rest, np.nanmedian(points, axis=1) - rest)
        return PosedFrames(lifted.root, self._sposer.decode(lifted.z), lifted.pelvis - rest)
