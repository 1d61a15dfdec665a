"""Fits to 2D keypoints from one known camera: Pose-NDF's prior and VPoser's (Tiwari et al. 2022, table 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.cameras.projection import project
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.pose_ndf.complete import KeypointSettings, bending, fit_keypoints
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics.positions import pa_mpjpe_mm
from solver_backend.priors.base import PosePrior
from solver_backend.priors.pose_ndf import PoseNDF
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.terms import PointTerm, graduated_scales
from solver_backend.solver.levenberg_marquardt import Arrowhead, LMSettings, levenberg_marquardt
from solver_backend.types import Cameras, JointSet, Keypoints2D

JOINTS = JointSet.BODY_25
NOISE_PX, DISTANCE_M, FOCAL_PX = 5.0, 4.5, 1400.0
TURN_DEG, SHIFT_M = 15.0, 0.1
"""Standard deviations of the initial errors of the person's rotation and position, per axis."""
_BODY = load_body()


@dataclass(frozen=True)
class Sighting:
    """Some poses of one person, seen by one camera."""

    truth: PosedFrames
    betas: np.ndarray
    term: ReprojectionTerm
    start: PosedFrames
    """Equal rest poses with approximately the person's rotations and positions."""


def sighting(frames: PosedFrames, rest: np.ndarray, seed: int) -> Sighting:
    """Simulate a front camera for F recorded poses (Y up), with normal noise on every keypoint."""
    rng = np.random.default_rng(seed)
    betas = rng.standard_normal(10)
    middle = frames.transl.mean(axis=0)
    R = np.diag([1.0, -1.0, -1.0])
    centre = middle + np.array([0.0, 0.0, DISTANCE_M])
    K = np.array([[FOCAL_PX, 0.0, 959.5], [0.0, FOCAL_PX, 539.5], [0.0, 0.0, 1.0]])
    cameras = Cameras(("front",), K[None], np.zeros((1, 5)), R[None], -(R @ centre)[None], np.array([[1920, 1080]]))
    points = pose(_person(betas), frames).points
    xy = project(cameras, points)
    xy = xy + NOISE_PX * rng.standard_normal(xy.shape)
    keypoints = Keypoints2D(xy, np.ones(xy.shape[:3]), JOINTS, 30.0)
    count = len(frames.transl)
    turn = exp_so3(np.radians(TURN_DEG) * rng.standard_normal((count, 3)))
    start = PosedFrames(
        turn @ frames.root, np.tile(rest, (count, 1, 1, 1)),
        frames.transl + SHIFT_M * rng.standard_normal((count, 3)),
    )  # fmt: skip
    term = ReprojectionTerm.of(cameras, keypoints, np.full(JOINTS.num_keypoints, NOISE_PX), np.zeros(1))
    return Sighting(frames, betas, term, start)


def manifold_fit(prior: PoseNDF, seen: Sighting, settings: KeypointSettings) -> float:
    """Return the error in mm of the fit by equation (10) with Pose-NDF's term."""
    found = fit_keypoints(_person(np.zeros(10)), prior, seen.term, seen.start, settings)
    return _error_mm(seen, found.frames, found.betas)


def latent_fit(prior: PosePrior, seen: Sighting, pull: float, settings: KeypointSettings) -> float:
    """Return the error in mm of the fit by (10) with ``λ_θ |z|²`` over codes, as fitted by VPoser's authors."""
    z = np.tile(prior.encode(seen.start.local[:1]), (len(seen.start.root), 1))
    state: _State = (PosedFrames(seen.start.root, prior.decode(z), seen.start.transl), z, np.zeros(10))
    for scale in graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3):
        objective = _LatentObjective(prior, seen.term, pull, settings, scale)
        state = levenberg_marquardt(
            state, objective.linearise, objective.retract,
            LMSettings(max_iterations=settings.iterations, tolerance=1e-5),
        ).state  # fmt: skip
    return _error_mm(seen, state[0], state[2])


_State = tuple[PosedFrames, np.ndarray, np.ndarray]  # Poses, their codes (F, d), shape (10,).


@dataclass(frozen=True)
class _LatentObjective:
    prior: PosePrior
    term: PointTerm
    pull: float
    settings: KeypointSettings
    scale: float

    def linearise(self, state: _State) -> tuple[np.ndarray, Arrowhead]:
        """Return the cost and its equations: root (3), code (d) and position (3) per frame, and the common shape."""
        frames, z, betas = state
        _, by_code = self.prior.decode_with_jacobian(z)
        posed = pose(_person(betas), frames, jacobian=True)
        assert posed.by_rotations is not None and posed.by_betas is not None
        evidence = self.term(posed.points, self.scale)
        count, landmarks = posed.points.shape[:2]
        turns = by_code.reshape(count, 63, -1)
        eye = np.broadcast_to(np.eye(3), (count, landmarks, 3, 3))
        by_z = posed.by_rotations[..., 3:] @ turns[:, None]
        J = np.concatenate([posed.by_rotations[..., :3], by_z, eye, posed.by_betas], axis=-1)
        Jt = np.swapaxes(J.reshape(count, 3 * landmarks, -1), 1, 2)
        H = Jt @ (evidence.information @ J).reshape(count, 3 * landmarks, -1)
        g = (Jt @ evidence.gradient.reshape(count, -1, 1))[..., 0]
        bend_cost, bend_g, bend_H = bending(frames.local, self.settings.bending)
        own, n, s = slice(3, 3 + z.shape[1]), 6 + z.shape[1], self.settings
        g[:, own] += (np.swapaxes(turns, 1, 2) @ bend_g[..., None])[..., 0] + self.pull * z
        H[:, own, own] += np.swapaxes(turns, 1, 2) @ bend_H @ turns + self.pull * np.eye(z.shape[1])
        cost = evidence.cost.sum() + bend_cost + 0.5 * self.pull * (z * z).sum() + 0.5 * s.shape * (betas @ betas)
        shared = H[:, n:, n:].sum(axis=0) + s.shape * np.eye(10)
        g_shared = g[:, n:].sum(axis=0) + s.shape * betas
        return np.array([cost]), Arrowhead(H[:, :n, :n], H[:, :n, n:], shared, g[:, :n], g_shared)

    def retract(self, state: _State, step: np.ndarray) -> _State:
        """Return the state after (1, 10 + F (6 + d)) steps, starting with the shape."""
        frames, z, betas = state
        moves = step[0, 10:].reshape(len(z), -1)
        codes = z + moves[:, 3:-3]
        root = exp_so3(moves[:, :3]) @ frames.root
        moved = PosedFrames(root, self.prior.decode(codes), frames.transl + moves[:, -3:])
        return moved, codes, betas + step[0, :10]


def _person(betas: np.ndarray) -> Subject:
    return Subject(_BODY, keypoint_landmarks(_BODY, JOINTS), betas, np.zeros((JOINTS.num_keypoints, 3)))


def _error_mm(seen: Sighting, frames: PosedFrames, betas: np.ndarray) -> float:
    """Return the mean distance of the skin's vertices after the best similarity of each frame."""
    skins = [
        pose_mesh(_BODY, shape, x.root, x.local, x.transl)[:, ::7]
        for shape, x in ((betas, frames), (seen.betas, seen.truth))
    ]
    return pa_mpjpe_mm(*skins)
