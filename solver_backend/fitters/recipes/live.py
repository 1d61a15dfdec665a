"""Live from markers: those that are seen where they are, the others where the network has them, variances learned."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.recipes.live_follow import PersonFollower
from solver_backend.geometry.alignment import umeyama
from solver_backend.labelling.outputs import MARKERS
from solver_backend.residuals.learned_positions import LearnedPositionTerm

MARKER_SIGMA_M = 0.012
"""First standard deviation of a seen marker per axis: how far an uncalibrated body has it from where it is."""
LEAST_SIGMA_M = 0.02
"""The network's positions are never trusted more than this; chosen by hand."""
SAME_ERROR_S = 1.0
"""Time over which the network's positions of unseen markers have the same error: repeated, they add no information.

Deviations 1, 10 and 1,000 times the network's gave joints 21.7, 19.1 and 20.5 mm off in three of decision 26's takes,
at 60 and 120 Hz, where 1 s is 8 and 11 times."""
_TRUNK = ("C7", "T10", "T4", "LAV", "TRN", "SHO", "FWT", "BWT")
"""Ends of the names of markers that a start is laid over."""


@dataclass(frozen=True)
class LiveFrame:
    """One frame, fitted."""

    pose: PosedFrames
    """One pose."""
    landmarks: np.ndarray
    """(53, 3) metres: where the body has the markers."""
    off_m: float
    """Median distance of the seen markers; NaN where none is."""
    markers_off_m: np.ndarray
    """(53,) metres between each seen marker and where the body has it; NaN where it is not seen."""


class LiveFit(PersonFollower):
    """Follows a person by markers."""

    def __init__(
        self, body: Body, landmarks: Landmarks | None = None, offsets: np.ndarray | None = None,
        betas: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Take the body, and where a person was calibrated, the 53 landmarks, their offsets and the shape."""
        subject = Subject.average(body, landmarks or marker_landmarks(body, MARKERS), np.zeros(0))
        super().__init__(subject if offsets is None else replace(subject, offsets=offsets), betas)

    def step(
        self, points: np.ndarray, guess: np.ndarray, guess_sigma: np.ndarray, dt: float, steps: int | None = None
    ) -> LiveFrame:
        """Fit a frame.

        Args:
            points: (53, 3) metres, NaN where a marker is not seen.
            guess: (53, 3) where the network has the markers.
            guess_sigma: (53,) metres.
            dt: seconds since the last frame.
            steps: at least, of Gauss-Newton; as few as follow a person if None.
        """
        seen = np.isfinite(points[:, 0])
        same = 1.0 if self.is_starting else max(SAME_ERROR_S / dt, 1.0) ** 0.5
        guess_sigma = np.maximum(guess_sigma * same, LEAST_SIGMA_M)
        target = np.where(seen[:, None], points, guess)
        term = LearnedPositionTerm(target[None], np.where(seen, MARKER_SIGMA_M, guess_sigma)[None] ** -2)
        landmarks = self.follow(term, dt, partial(self._start, target), steps).points[0]
        off = np.where(seen, np.linalg.norm(landmarks - target, axis=-1), np.nan)
        assert self.pose is not None
        return LiveFrame(self.pose, landmarks, float(np.median(off[seen])) if seen.any() else float("nan"), off)

    def _start(self, target: np.ndarray) -> PosedFrames:
        """Return the rest pose laid over the markers of the trunk."""
        body, rest = self.subject.body, self.subject.landmarks.anchors.sum(axis=1)
        trunk = [i for i, name in enumerate(MARKERS) if name.endswith(_TRUNK)]
        _, R, t = umeyama(rest[trunk], target[trunk])
        pelvis = body.joints_template[0]
        return PosedFrames(R[None], self.rest, (t + R @ pelvis - pelvis)[None])


def fit_average_person() -> LiveFit:
    """Return a fit of the body that ships, whose shape is learned."""
    return LiveFit(load_body())
