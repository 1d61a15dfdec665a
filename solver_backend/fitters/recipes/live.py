"""Fit live frames to visible markers and to the network's positions for hidden markers, or to several views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import joint_landmarks, keypoint_landmarks
from solver_backend.body.landmarks import Landmarks, PosedLandmarks, pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.cameras.robust_triangulation import Triangulation, triangulate
from solver_backend.exchange.body_layout import SMPL
from solver_backend.fitters.measurements.views import fit_sigma_px
from solver_backend.fitters.model.subject import FrameObjective, PosedFrames, Subject, frame_equations, pose
from solver_backend.geometry.alignment import umeyama
from solver_backend.labelling.outputs import MARKERS
from solver_backend.priors.lifter import load_lifter
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.landmark_loss import LearnedPositionTerm, LearnedVariances
from solver_backend.residuals.pose_mixture import PoseMixtureTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.terms import PointTerm
from solver_backend.types import Cameras, JointSet, Keypoints2D

TURN_RAD_S, MOVE_M_S = 4.0, 6.0  # Deviations per second of joint rotations and body position from their prediction.
VELOCITY_S = 0.1  # Time constant of the velocity that predicts the next frame (0.05 and 0.1 s differ by 0.1 mm).
USUAL_SHAPE = 2.0  # Precision of the average shape, for markers misplaced by a centimetre. Chosen by hand.
START_STEPS, START_PART, STEPS = 24, 3, 2  # Gauss-Newton steps for a start, each of its frames, and later frames.
SHORT_S = 0.012  # Frames at shorter intervals need only one step. Chosen by hand.
SHAPE_FRAMES = 240  # Frames in which the shape is learned before it is fixed. Two seconds at 120 Hz, chosen by hand.
NEW_SHARE = 0.02  # Weight of a frame in the shape's information: misplaced markers have the same error in all frames.
ROBUST_SCALE = np.inf  # The learned variances are robust enough without a kernel.


class PersonFollower:
    """Solver that follows one person, and keeps pose, velocity and body shape between frames."""

    def __init__(self, subject: Subject, betas: np.ndarray | None = None) -> None:
        """Create a follower for a person, with the body shape (10,) if it is known."""
        self.subject = subject
        self._shape_frames = 0
        if betas is not None:
            self.subject = replace(subject, betas=np.asarray(betas, dtype=np.float64))
            self._shape_frames = SHAPE_FRAMES
        self._shape_precision = np.zeros((len(self.subject.betas),) * 2)
        self._prior = PoseMixtureTerm()
        self.pose: PosedFrames | None = None
        self._velocity = np.zeros(0)
        self._steps_to_start = 0
        self._precision = np.zeros((0, 0))

    @property
    def known_shape(self) -> np.ndarray | None:
        """(10,) body shape once it is fixed, or None while it is learned."""
        return self.subject.betas if self._shape_frames >= SHAPE_FRAMES else None

    @property
    def rest(self) -> np.ndarray:
        """(1, n, 3, 3) joint rotations of the rest pose."""
        return np.broadcast_to(np.eye(3), (1, len(self._prior.rest_precision) // 3, 3, 3))

    def restart(self) -> None:
        """Discard the pose. The next frame starts from an initial pose again."""
        self.pose = None

    @property
    def is_starting(self) -> bool:
        """True if there is no pose yet, or the steps after an initial pose are not complete."""
        return self.pose is None or self._steps_to_start > 0

    def follow(
        self, term: PointTerm, dt: float, start: Callable[[], PosedFrames], steps: int | None = None
    ) -> PosedLandmarks:
        """Fit the body to one frame and return its landmarks.

        Args:
            term: data term of the frame's landmarks.
            dt: seconds since the last frame.
            start: returns the initial pose.
            steps: smallest number of Gauss-Newton steps, or None for the default.
        """
        if self.pose is None:
            self._steps_to_start = START_STEPS
        starting = self._steps_to_start > 0
        last = self.pose or start()
        usual = START_PART if starting else 1 if dt < SHORT_S else STEPS
        count = usual if steps is None else max(steps, self._steps_to_start)
        self._steps_to_start -= count
        frame, moved = self._step(last, term, 1.0 if starting else dt, count, still=starting)
        learn = self.known_shape is None
        posed = pose(self.subject, frame, jacobian=learn)
        if learn:
            frame = frame.retract(self._learn_shape(term, posed, frame.local)[None])
        self.pose, self._velocity = frame, np.zeros_like(moved) if starting else moved / dt
        return posed

    def deviations(self) -> np.ndarray:
        """Return the standard deviation (24,) of each joint in metres: ``sqrt(tr(J (H + T)⁻¹ Jᵀ) / 3)``.

        H is the Gauss-Newton matrix of the last frame and its prior, T is the precision of the frame's prediction, and
        J are the derivatives of the joints.
        """
        if self.pose is None or not len(self._precision):
            return np.full(len(self._joints), np.nan)
        frame, body = self.pose, self.subject.body
        posed = pose_landmarks(
            body, self._joints, self.subject.betas, frame.root, frame.local, frame.transl, jacobian=True, by_shape=False
        )
        assert posed.by_rotations is not None
        turned = posed.by_rotations[0]
        J = np.concatenate([turned, np.broadcast_to(np.eye(3), (len(turned), 3, 3))], axis=-1)
        spread = np.einsum("jac,cd,jad->j", J, np.linalg.inv(self._precision), J, optimize=True)
        return np.sqrt(spread / 3.0)

    @cached_property
    def _joints(self) -> Landmarks:
        return joint_landmarks(self.subject.body, SMPL)

    def _step(
        self, last: PosedFrames, term: PointTerm, dt: float, count: int, *, still: bool
    ) -> tuple[PosedFrames, np.ndarray]:
        """Return the pose after ``count`` Gauss-Newton steps from the prediction: ``(H + T) δ = -(g + T m)``.

        H and g are the Hessian and gradient of the frame, T is the precision of the prediction, and m the motion since
        the prediction. Also return the motion since the last frame, multiplied by the measurements' share
        ``H / (H + T)``. Only this part updates the velocity, because motion from the prior alone must not add speed.
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
            self._precision = H + np.diag(tie)
            delta = -np.linalg.solve(self._precision, equations.gradient[0] + tie * moved)
            frame, moved = frame.retract(delta[None]), moved + delta
        return frame, observed * (ahead + moved)

    def _learn_shape(self, term: PointTerm, posed: PosedLandmarks, local: np.ndarray) -> np.ndarray:
        """Update the body shape from one frame's landmarks, and return the step of the pose as a tangent.

        ``S = Bᵀ W B - Bᵀ W J H⁻¹ Jᵀ W B`` is the Schur complement of the pose, and ``δ = -H⁻¹ Jᵀ W B δ_β``, where W is
        the landmarks' information, H the pose's Hessian, and B and J the landmarks' derivatives w.r.t. shape and pose
        (Triggs et al. 2000, section 6.1).
        """
        assert posed.by_rotations is not None and posed.by_betas is not None
        found = term(posed.points, ROBUST_SCALE)
        W, by_points = found.information[0], found.gradient.reshape(-1)
        B, turned = (J[0].reshape(len(by_points), -1) for J in (posed.by_betas, posed.by_rotations))
        J = np.concatenate([turned, np.tile(np.eye(3), (len(W), 1))], axis=1)
        WB, WJ = ((W @ part.reshape(len(W), 3, -1)).reshape(part.shape) for part in (B, J))
        H, across = J.T @ WJ, J.T @ WB
        H[3:-3, 3:-3] += self._prior.hessian(self._prior(local).factors)[0]
        follows = np.linalg.solve(H, across)
        information = B.T @ WB - across.T @ follows
        gradient = B.T @ by_points + USUAL_SHAPE * self.subject.betas
        usual = USUAL_SHAPE * np.eye(B.shape[1])
        step = np.linalg.solve(information + self._shape_precision + usual, gradient)
        self.subject = replace(self.subject, betas=self.subject.betas - step)
        self._shape_precision += NEW_SHARE * (information - self._shape_precision)
        self._shape_frames += 1
        return follows @ step


MARKER_SIGMA_M = 0.012  # Initial deviation of a visible marker per axis: its error on an uncalibrated body.
LEAST_SIGMA_M = 0.02  # Smallest standard deviation of the network's positions. Chosen by hand.
SAME_ERROR_S = 1.0
"""Correlation time of the network's errors in seconds. At 60 and 120 Hz, it multiplies deviations by 8 and 11. Factors
of 1, 10 and 1,000 gave joint errors of 21.7, 19.1 and 20.5 mm in three takes of decision 26."""
_TRUNK = ("C7", "T10", "T4", "LAV", "TRN", "SHO", "FWT", "BWT")  # Endings of the markers that align the initial pose.


@dataclass(frozen=True)
class LiveFrame:
    """Result of fitting one frame of markers."""

    pose: PosedFrames
    landmarks: np.ndarray  # (53, 3) metres: the markers on the body.
    off_m: float  # Median distance of the visible markers, NaN if there are none.
    markers_off_m: np.ndarray  # (53,) metres from each visible marker to its position on the body, otherwise NaN.


class LiveFit(PersonFollower):
    """Live solver for a person with markers."""

    def __init__(
        self,
        body: Body,
        landmarks: Landmarks | None = None,
        offsets: np.ndarray | None = None,
        betas: np.ndarray | None = None,
    ) -> None:
        """Create a fit for a body, or for a calibrated person with a shape (10,) and landmark offsets (53, 3)."""
        subject = Subject.average(body, landmarks or marker_landmarks(body, MARKERS), np.zeros(0))
        super().__init__(subject if offsets is None else replace(subject, offsets=offsets), betas)

    def step(
        self, points: np.ndarray, guess: np.ndarray, guess_sigma: np.ndarray, dt: float, steps: int | None = None
    ) -> LiveFrame:
        """Fit the body to one frame of markers.

        Args:
            points: (53, 3) markers in metres, NaN if hidden.
            guess: (53, 3) the network's positions in metres.
            guess_sigma: (53,) standard deviations of these positions in metres.
            dt: seconds since the last frame.
            steps: smallest number of Gauss-Newton steps, or None for the default.
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
        body, rest = self.subject.body, self.subject.landmarks.anchors.sum(axis=1)
        trunk = [i for i, name in enumerate(MARKERS) if name.endswith(_TRUNK)]
        _, R, t = umeyama(rest[trunk], target[trunk])
        pelvis = body.joints_template[0]
        return PosedFrames(R[None], self.rest, (t + R @ pelvis - pelvis)[None])


def fit_average_person() -> LiveFit:
    """Create a live fit of the built-in body, which learns the person's shape."""
    return LiveFit(load_body())


SIGMA_PX = 4.0  # Initial deviation of a detection per axis at 720 lines. Detectors have 3 to 6.
LINES = 720.0  # Image height to which ``SIGMA_PX`` applies.
FEWEST = 6  # Smallest number of triangulated keypoints for a pose, as in a solve.
UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # Rotation of a standing body's root with Z up.


@dataclass(frozen=True)
class ViewsFrame:
    """Result of fitting one frame of several views."""

    pose: PosedFrames
    points: np.ndarray  # (L, 3) metres: triangulated keypoints, NaN if fewer than two views agree.
    landmarks: np.ndarray  # (L, 3) metres: the keypoints on the body.
    points_off_m: np.ndarray  # (L,) metres between the two, NaN if a keypoint is not triangulated.


class LiveViewsFit(PersonFollower):
    """Live solver for a person in several calibrated views."""

    def __init__(self, body: Body, cameras: Cameras, joint_set: JointSet, betas: np.ndarray | None = None) -> None:
        """Create a fit of a body to detected keypoints, with the body shape (10,) if it is known."""
        super().__init__(Subject.average(body, keypoint_landmarks(body, joint_set), np.zeros(0)), betas)
        self.cameras, self.joint_set = cameras, joint_set
        self._sigma_px = SIGMA_PX * float(np.median(cameras.image_size[:, 1])) / LINES
        self._sposer = prior_on_body(load_sposer(), body.layout)
        self._penalty = LearnedVariances().penalty

    def locate(self, xy: np.ndarray, confidence: np.ndarray) -> Triangulation:
        """Triangulate the keypoints (C, L, 2) of one frame in px, NaN where missing."""
        return triangulate(self.cameras, xy[:, None], confidence[:, None], self._sigma_px)

    def step(self, xy: np.ndarray, confidence: np.ndarray, located: Triangulation, dt: float) -> ViewsFrame:
        """Fit the body to one frame with at least ``FEWEST`` triangulated points (see ``locate``)."""
        points = np.asarray(located.points)
        keypoints = Keypoints2D(xy[:, None], confidence[:, None], self.joint_set, 1.0)
        sigma = fit_sigma_px(self.cameras, points, np.asarray(located.sigma_px))
        term = replace(ReprojectionTerm.of(self.cameras, keypoints, sigma, points), penalty=self._penalty)
        landmarks = self.follow(term, dt, partial(self._start, points)).points[0]
        assert self.pose is not None
        return ViewsFrame(self.pose, points[0], landmarks, np.linalg.norm(landmarks - points[0], axis=-1))

    def _start(self, points: np.ndarray) -> PosedFrames:
        seen = np.isfinite(points).all(-1)
        lifted = load_lifter()(np.where(seen[..., None], points, 0.0), seen, self.subject.landmarks.names)
        rest = self.subject.body.rest_joints(self.subject.betas)[0]
        if not bool(np.asarray(lifted.usable)[0]):
            return PosedFrames(UPRIGHT[None], self.rest, np.nanmedian(points, axis=1) - rest)
        return PosedFrames(lifted.root, self._sposer.decode(lifted.z), lifted.pelvis - rest)
