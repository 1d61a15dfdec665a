"""One frame's pose from the last one's: a few Gauss-Newton steps on the markers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.landmarks import PosedLandmarks, pose_landmarks
from solver_backend.body.markers import marker_landmarks
from solver_backend.geometry.rotations import exp_so3
from solver_backend.labelling.outputs import MARKERS

MARKER_SIGMA_M = 0.012
"""How far a seen marker is from where an uncalibrated body has it, per axis."""
LEAST_SIGMA_M = 0.02
"""The network's positions are never taken for better than this."""
STEP_RAD_S, STEP_M_S = 12.0, 6.0
"""How fast joints turn and the body moves, standard deviations: what ties a frame to the last one."""
REST_RAD = 1.2
"""Pull of every joint towards the rest pose, weak: markers leave twists open."""
ROBUST_M = 0.05
"""Markers farther off than this lose weight (Geman and McClure 1987)."""
USUAL_SHAPE = 2.0
"""Pull towards the mean shape: places that are off by a centimetre must not make another person."""
START_STEPS, START_PART, STEPS = 24, 3, 2
"""Steps of a start in all, those of a frame at its begin, so that none comes late by it, and those of later ones."""
SHORT_S = 0.012
"""Frames that follow sooner need one step."""
_ROTATIONS = 22
_SHAPE_FRAMES = 240
"""Frames over which the shape is learned; then it stays."""


@dataclass(frozen=True)
class LivePose:
    """A pose, and the shape as far as it is known."""

    root: np.ndarray
    """(1, 3, 3)."""
    local: np.ndarray
    """(1, 21, 3, 3)."""
    transl: np.ndarray
    """(1, 3) metres."""
    betas: np.ndarray
    """(10,)"""


class FrameFit:
    """Fits frames one after the other."""

    def __init__(
        self, body: Body, landmarks: Landmarks | None = None, offsets: np.ndarray | None = None,
        betas: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """Take a body, and where a person was calibrated, the 53 landmarks, their offsets and the shape."""
        self.body = body
        self.landmarks = landmarks or marker_landmarks(body, MARKERS)
        self.offsets = np.zeros((len(self.landmarks), 3)) if offsets is None else offsets
        self.known_shape = betas is not None
        self._shape = np.zeros(10) if betas is None else np.asarray(betas, dtype=np.float64)
        self._shape_precision = np.zeros((10, 10))
        self._frames = 0
        self._to_start = 0
        self.pose: LivePose | None = None

    @property
    def settled_shape(self) -> np.ndarray | None:
        """(10,) shape that will not change any more; None while it is learned."""
        return self._shape if self.known_shape or self._frames >= _SHAPE_FRAMES else None

    def restart(self) -> None:
        """Forget the pose: the next frame starts from what the network sees."""
        self.pose = None

    def step(
        self, points: np.ndarray, guess: np.ndarray, guess_sigma: np.ndarray, dt: float, steps: int | None = None
    ) -> tuple[LivePose, PosedLandmarks, float]:
        """Return the pose of a frame, where it has the landmarks, and the median distance of the markers in metres.

        Args:
            points: (53, 3) metres, NaN where a marker is not seen.
            guess: (53, 3) where the network has the markers.
            guess_sigma: (53,) metres.
            dt: seconds since the last frame.
            steps: at least, of Gauss-Newton; as few as follow a person if None.
        """
        seen = np.isfinite(points[:, 0])
        target = np.where(seen[:, None], points, guess)
        sigma = np.where(seen, MARKER_SIGMA_M, np.maximum(guess_sigma, LEAST_SIGMA_M))
        if self.pose is None:
            self._to_start = START_STEPS
        pose = self.pose or self._start(target)
        fixed = pose
        starting = self._to_start > 0
        usual = START_PART if starting else 1 if dt < SHORT_S else STEPS
        count = usual if steps is None else max(steps, self._to_start)
        self._to_start -= count
        for _ in range(count):
            pose = self._improved(pose, fixed, target, sigma, 1.0 if starting else dt)
        posed = pose_landmarks(
            self.body, self.landmarks, pose.betas, pose.root, pose.local, pose.transl, offsets=self.offsets
        )
        off = np.linalg.norm(posed.points[0] - target, axis=-1)
        self.pose = pose
        return pose, posed, float(np.median(off[seen])) if seen.any() else float("nan")

    def _start(self, target: np.ndarray) -> LivePose:
        """Return the rest pose laid over the markers."""
        rest = self.landmarks.anchors.sum(axis=1)
        trunk = [
            i for i, name in enumerate(MARKERS) if name[-3:] in ("C7", "T10", "T4", "LAV", "TRN", "SHO", "FWT", "BWT")
        ]
        R, t, _ = _laid_over(rest[trunk], target[trunk])
        pelvis = self.body.joints_template[0]
        return LivePose(
            R[None], np.broadcast_to(np.eye(3), (1, 21, 3, 3)), (t + R @ pelvis - pelvis)[None], self._shape
        )

    def _improved(self, pose: LivePose, fixed: LivePose, target: np.ndarray, sigma: np.ndarray, dt: float) -> LivePose:
        """Return the pose after one Gauss-Newton step, tied to the frame before."""
        learning = not self.known_shape and self._frames < _SHAPE_FRAMES
        posed = pose_landmarks(
            self.body, self.landmarks, pose.betas, pose.root, pose.local, pose.transl, offsets=self.offsets,
            jacobian=True, by_shape=learning,
        )  # fmt: skip
        assert posed.by_rotations is not None
        residual = target - posed.points[0]
        off = (residual * residual).sum(-1)
        weight = (1.0 / (1.0 + off / ROBUST_M**2)) / sigma
        parts = [posed.by_rotations[0], np.broadcast_to(np.eye(3), (len(target), 3, 3))]
        if posed.by_betas is not None:
            parts.append(posed.by_betas[0])
        J = (np.concatenate(parts, axis=-1) * weight[:, None, None]).reshape(3 * len(target), -1)
        r = (residual * weight[:, None]).ravel()
        H, g = J.T @ J, J.T @ r
        turn, move = (STEP_RAD_S * dt) ** -2, (STEP_M_S * dt) ** -2
        diagonal = np.concatenate([np.full(3 * _ROTATIONS, turn), np.full(3, move)])
        diagonal[3 : 3 * _ROTATIONS] += REST_RAD**-2
        size = len(diagonal)
        H[range(size), range(size)] += diagonal
        g[3 : 3 * _ROTATIONS] -= REST_RAD**-2 * _turns(pose.local)
        g[: 3 * _ROTATIONS] += turn * np.concatenate([_left(fixed.root, pose.root), _left(fixed.local, pose.local)])
        g[3 * _ROTATIONS : size] += move * (fixed.transl - pose.transl)[0]
        if learning:
            H[size:, size:] += self._shape_precision + USUAL_SHAPE * np.eye(10)
            g[size:] += self._shape_precision @ (self._shape - pose.betas) - USUAL_SHAPE * pose.betas
        step = np.linalg.solve(H, g)
        if learning and fixed is not pose:
            self._learn(H, size, pose.betas + step[size:])
        return LivePose(
            exp_so3(step[None, :3]) @ pose.root,
            exp_so3(step[3 : 3 * _ROTATIONS].reshape(1, 21, 3)) @ pose.local,
            pose.transl + step[3 * _ROTATIONS : size],
            pose.betas + step[size:] if learning else pose.betas,
        )

    def _learn(self, H: np.ndarray, size: int, betas: np.ndarray) -> None:
        """Let one frame's markers tell of the shape, with what the pose leaves open taken out; frames err alike."""
        inner = H[size:, size:] - H[size:, :size] @ np.linalg.solve(H[:size, :size], H[:size, size:])
        self._shape, self._frames = betas, self._frames + 1
        self._shape_precision = self._shape_precision + 0.02 * (inner - self._shape_precision)

    def moved_to(self, pose: LivePose) -> None:
        """Go on from a pose."""
        self.pose = replace(pose)


def _laid_over(rest: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the rotation and translation that bring rest points over targets (Umeyama 1991, without scale)."""
    a, b = rest.mean(0), target.mean(0)
    U, _, Vt = np.linalg.svd((target - b).T @ (rest - a))
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = U @ sign @ Vt
    return R, b - R @ a, 1.0


def _left(fixed: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return the flat left tangents from now to fixed, small ones: the antisymmetric part of ``fixed nowᵀ``."""
    D = fixed[0] @ np.swapaxes(now[0], -1, -2)
    return (
        0.5
        * np.stack(
            [D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], axis=-1
        ).ravel()
    )


def _turns(local: np.ndarray) -> np.ndarray:
    """Return (63,) how far joints are turned: the sine of the angle along its axis, which is enough to lean back."""
    return _left(local, np.broadcast_to(np.eye(3), local.shape))
