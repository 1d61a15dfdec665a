"""Live: each frame from the one before, by the terms of a single frame with learned variances, as markers come."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.landmarks import Landmarks, PosedLandmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, frame_equations, pose
from solver_backend.fitters.objective import FrameObjective
from solver_backend.geometry.alignment import umeyama
from solver_backend.labelling.outputs import MARKERS
from solver_backend.residuals.learned_positions import LearnedPositionTerm
from solver_backend.residuals.pose_mixture import PoseMixtureTerm

MARKER_SIGMA_M = 0.012
"""First standard deviation of a seen marker per axis: how far an uncalibrated body has it from where it is."""
LEAST_SIGMA_M = 0.02
"""The network's positions are never trusted more than this."""
SAME_ERROR_S = 1.0
"""Time over which the network's positions of unseen markers have the same error: repeated, they say nothing new.

Deviations 1, 10 and 1,000 times the network's gave joints 21.7, 19.1 and 20.5 mm off in three of decision 26's takes,
at 60 and 120 Hz, where 1 s is 8 and 11 times."""
TURN_RAD_S, MOVE_M_S = 4.0, 6.0
"""Standard deviations of how joints and the body leave where the last frames were going, a second."""
VELOCITY_S = 0.1
"""Time in which the velocity that predicts the next frame fades (0.05 and 0.1 s differ by 0.1 mm)."""
USUAL_SHAPE = 2.0
"""Pull towards the mean shape: places that are off by a centimetre must not make another person."""
START_STEPS, START_PART, STEPS = 24, 3, 2
"""Steps of a start in all, those of a frame of it, so that none comes late by it, and those of later frames."""
SHORT_S = 0.012
"""Frames that follow sooner need one step."""
SHAPE_FRAMES = 240
"""Frames over which the shape is learned; then it stays."""
NEW_SHARE = 0.02
"""Share of a frame in the shape's information: the errors of placed markers are the same in all frames."""
ROBUST_SCALE = np.inf
"""The learned variances are robust enough; no further kernel."""
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


class LiveFit:
    """Fits frames one after the other; the state between them is a pose, its velocity and the shape."""

    def __init__(
        self, body: Body, landmarks: Landmarks | None = None, offsets: np.ndarray | None = None,
        betas: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Take a body, and where a person was calibrated, the 53 landmarks, their offsets and the shape."""
        landmarks = landmarks or marker_landmarks(body, MARKERS)
        self.subject = Subject.average(body, landmarks, np.zeros(0))
        if offsets is not None:
            self.subject = replace(self.subject, offsets=offsets)
        self._shape_frames = 0
        if betas is not None:
            self.subject = replace(self.subject, betas=np.asarray(betas, dtype=np.float64))
            self._shape_frames = SHAPE_FRAMES
        self._shape_precision = np.zeros((len(self.subject.betas),) * 2)
        self._prior = PoseMixtureTerm()
        self.pose: PosedFrames | None = None
        self._velocity = np.zeros(0)
        self._steps_to_start = 0

    @property
    def known_shape(self) -> np.ndarray | None:
        """(10,) shape that will not change any more; None while it is learned."""
        return self.subject.betas if self._shape_frames >= SHAPE_FRAMES else None

    def restart(self) -> None:
        """Forget the pose: the next frame starts from what the network sees."""
        self.pose = None

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
        if self.pose is None:
            self._steps_to_start = START_STEPS
        starting = self._steps_to_start > 0
        seen = np.isfinite(points[:, 0])
        guess_sigma = np.maximum(guess_sigma * (1.0 if starting else max(SAME_ERROR_S / dt, 1.0) ** 0.5), LEAST_SIGMA_M)
        target = np.where(seen[:, None], points, guess)
        term = LearnedPositionTerm(target[None], np.where(seen, MARKER_SIGMA_M, guess_sigma)[None] ** -2)
        last = self.pose or self._start(target)
        usual = START_PART if starting else 1 if dt < SHORT_S else STEPS
        count = usual if steps is None else max(steps, self._steps_to_start)
        self._steps_to_start -= count
        frame, moved = self._follow(last, term, 1.0 if starting else dt, count, still=starting)
        learn = self.known_shape is None
        posed = pose(self.subject, frame, jacobian=learn)
        if learn:
            frame = frame.retract(self._learn_shape(term, posed, frame.local)[None])
        self.pose, self._velocity = frame, np.zeros_like(moved) if starting else moved / dt
        off = np.where(seen, np.linalg.norm(posed.points[0] - target, axis=-1), np.nan)
        return LiveFrame(frame, posed.points[0], float(np.median(off[seen])) if seen.any() else float("nan"), off)

    def _follow(
        self, last: PosedFrames, term: LearnedPositionTerm, dt: float, count: int, *, still: bool
    ) -> tuple[PosedFrames, np.ndarray]:
        """Return the pose after some Gauss-Newton steps from where the last ones were going.

        ``(H + T) δ = -(g + T m)`` with the precision T of the prediction and what was moved since it, m. Its motion is
        returned with the shares ``H / (H + T)`` that the frame itself knows of it: what only the prior moves, as an
        unseen limb, must not gain speed by it.
        """
        objective = FrameObjective((term,), (self._prior,))
        rotations = 3 * (1 + last.local.shape[1])
        tie = np.repeat([(TURN_RAD_S * dt) ** -2, (MOVE_M_S * dt) ** -2], [rotations, 3])
        ahead = np.zeros(rotations + 3) if still else np.exp(-dt / VELOCITY_S) * dt * self._velocity
        frame, moved = (last if still else last.retract(ahead[None])), np.zeros_like(ahead)
        observed = moved
        for _ in range(count):
            equations = frame_equations(self.subject, frame, objective, ROBUST_SCALE)
            H = equations.hessian[0]
            observed = np.diag(H) / (np.diag(H) + tie)
            delta = -np.linalg.solve(H + np.diag(tie), equations.gradient[0] + tie * moved)
            frame, moved = frame.retract(delta[None]), moved + delta
        return frame, observed * (ahead + moved)

    def _start(self, target: np.ndarray) -> PosedFrames:
        """Return the rest pose laid over the markers of the trunk."""
        body, rest = self.subject.body, self.subject.landmarks.anchors.sum(axis=1)
        trunk = [i for i, name in enumerate(MARKERS) if name.endswith(_TRUNK)]
        _, R, t = umeyama(rest[trunk], target[trunk])
        pelvis = body.joints_template[0]
        local = np.broadcast_to(np.eye(3), (1, len(self._prior.rest_precision) // 3, 3, 3))
        return PosedFrames(R[None], local, (t + R @ pelvis - pelvis)[None])

    def _learn_shape(self, term: LearnedPositionTerm, posed: PosedLandmarks, local: np.ndarray) -> np.ndarray:
        """Step the shape by one frame's markers, and return the tangent by which the pose follows it.

        ``S = Bᵀ W B - Bᵀ W J H⁻¹ Jᵀ W B``, the Schur complement of the pose, and ``δ = -H⁻¹ Jᵀ W B δ_β`` (Triggs et al.
        2000, section 6.1); the pose's own gradient is zero where it was fitted.
        """
        assert posed.by_rotations is not None and posed.by_betas is not None
        error, weight = posed.points - term.positions, np.repeat(term.precisions(posed.points)[0], 3)[:, None]
        B, turned = (J[0].reshape(len(weight), -1) for J in (posed.by_betas, posed.by_rotations))
        J = np.concatenate([turned, np.tile(np.eye(3), (len(weight) // 3, 1))], axis=1)
        H, across = J.T @ (weight * J), J.T @ (weight * B)
        H[3:-3, 3:-3] += self._prior.hessian(self._prior(local).factors)[0]
        follows = np.linalg.solve(H, across)
        information = B.T @ (weight * B) - across.T @ follows
        gradient = (B.T @ (weight * error.reshape(-1, 1)))[:, 0] + USUAL_SHAPE * self.subject.betas
        usual = USUAL_SHAPE * np.eye(B.shape[1])
        step = np.linalg.solve(information + self._shape_precision + usual, gradient)
        self.subject = replace(self.subject, betas=self.subject.betas - step)
        self._shape_precision += NEW_SHARE * (information - self._shape_precision)
        self._shape_frames += 1
        return follows @ step


def fit_average_person() -> LiveFit:
    """Return a fit of the body that ships, whose shape is learned."""
    return LiveFit(load_body())
