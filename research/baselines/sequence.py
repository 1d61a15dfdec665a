"""Build and solve the equations of frames with Gaussian pose codes, separately or linked over time.

The unknowns of a frame are ``(z (32,), R (3, 3), t (3,))`` with 38 tangents: 32 for the code, 3 for the root's rotation
(world), and 3 for the translation. The cost is the robust data term and ``w/2 |z|²``, the negative log density of the
code (Bogo et al. 2016; Pavlakos et al. 2019), plus the terms that link frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from research.baselines.person import Prepared
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.state_layout import CODE, RESIDUAL, ROOT, TRANSL, StateLayout
from solver_backend.fitters.model.subject import (
    FrameObjective,
    PosedFrames,
    Subject,
    d_pose_d_state,
    decoded,
    decoder_jacobian,
    frame_equations,
)
from solver_backend.fitters.single_frame import bridged_states, fit_to_points, posed
from solver_backend.geometry.arrays import Rows
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.base import PosePrior
from solver_backend.priors.gaussian_vae import LATENT_DIM, GaussianVAE, load_vae
from solver_backend.priors.weights import BODY_JOINTS
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.solver.levenberg_marquardt import DenseBlocks, LMSettings, levenberg_marquardt
from solver_backend.types import JointSet

STATE = StateLayout.of(LATENT_DIM, len(BODY_JOINTS)).without(RESIDUAL)  # Layout of a frame's state (38 values).
DOF = STATE.dof
_FLOOR = 1e-2  # Value added to the diagonal, so that unobserved parts do not move.


@dataclass(frozen=True)
class States(Rows):
    """Codes, root rotations and translations of F frames."""

    z: np.ndarray  # (F, 32) codes.
    root: np.ndarray  # (F, 3, 3) body to world.
    transl: np.ndarray  # (F, 3) metres.

    def retract(self, step: np.ndarray) -> States:
        """Update the states by tangent steps (F, 38)."""
        root = exp_so3(step[:, STATE[ROOT]]) @ self.root
        return States(self.z + step[:, STATE[CODE]], root, self.transl + step[:, STATE[TRANSL]])

    def replaced(self, frames: np.ndarray, new: States) -> States:
        """Return a copy with new states in some frames."""
        parts = {name: getattr(self, name).copy() for name in ("z", "root", "transl")}
        for name, values in parts.items():
            values[frames] = getattr(new, name)
        return States(**parts)


@dataclass(frozen=True)
class Equations:
    """Gauss-Newton model of F frames. ``upper`` couples neighbouring frames."""

    cost: np.ndarray  # (F,) costs.
    H: np.ndarray  # (F, 38, 38) diagonal blocks.
    g: np.ndarray  # (F, 38) gradients.
    upper: np.ndarray | None = None  # (F - 1, 38, 38) blocks above the diagonal.

    def __add__(self, other: Equations) -> Equations:
        upper = self.upper if other.upper is None else other.upper
        return Equations(self.cost + other.cost, self.H + other.H, self.g + other.g, upper)


Link = Callable[[States, PosedFrames, np.ndarray], Equations]
"""Function that returns the linking terms, given states, poses and derivatives (F, 69, 38) of the pose tangents."""


def pose_prior() -> GaussianVAE:
    """Load VPoser with the architecture of its public code, which the published methods used."""
    return load_vae("vposer")


@dataclass(frozen=True)
class Sequence:
    """Person, prior and objective of the frames to fit."""

    subject: Subject
    prior: PosePrior
    objective: FrameObjective  # Objective for the F frames.
    latent_weight: float  # Weight w.

    def poses(self, states: States) -> PosedFrames:
        """Decode the states to poses."""
        return PosedFrames(states.root, decoded(self.prior, states.z), states.transl)

    def d_pose_d_state(self, states: States) -> np.ndarray:
        """Return the (F, 69, 38) derivative of the pose tangents w.r.t. the state tangents."""
        return d_pose_d_state(STATE, decoder_jacobian(self.prior, states.z)[0])

    def equations(self, states: States, scale: float, link: Link | None) -> Equations:
        """Return the Gauss-Newton model of the cost at these states."""
        poses, C = self.poses(states), self.d_pose_d_state(states)
        data = frame_equations(self.subject, poses, self.objective, scale)
        C_T = C.swapaxes(-1, -2)
        H = C_T @ (data.hessian @ C) + _FLOOR * np.eye(DOF)
        g = (C_T @ data.gradient[..., None])[..., 0]
        H[:, STATE[CODE], STATE[CODE]] += self.latent_weight * np.eye(LATENT_DIM)
        g[:, STATE[CODE]] += self.latent_weight * states.z
        cost = data.cost + 0.5 * self.latent_weight * (states.z**2).sum(-1)
        own = Equations(cost, H, g)
        return own if link is None else own + link(states, poses, C)

    def solve(self, states: States, scale: float, iterations: int, link: Link | None = None) -> States:
        """Minimise the cost, for each frame separately or, with a link, for all frames together."""

        def linearise(s: States) -> tuple[np.ndarray, DenseBlocks | BlockTridiagonal]:
            found = self.equations(s, scale, link)
            if found.upper is None:
                return found.cost, DenseBlocks(found.H, found.g)
            return found.cost.sum()[None], BlockTridiagonal(found.H, found.upper, found.g)

        def retract(s: States, step: np.ndarray) -> States:
            return s.retract(step.reshape(-1, DOF))

        def select(mask: np.ndarray, new: States, old: States) -> States:
            return old.replaced(np.flatnonzero(mask), _masked(new, mask))

        return levenberg_marquardt(states, linearise, retract, LMSettings(max_iterations=iterations), select).state


def _masked(states: States, mask: np.ndarray) -> States:
    return states.select(np.flatnonzero(mask))


def initial_states(prepared: Prepared, prior: PosePrior) -> States:
    """Return states fitted to the triangulated points. Frames without points are interpolated."""
    problem = prepared.problem
    fitted = fit_to_points(problem, prepared.subject, prepared.seen)
    start = posed(problem.prior, bridged_states(fitted, prepared.seen, problem.num_frames))
    return States(prior.encode(start.local), start.root, start.transl)


@dataclass(frozen=True)
class PosedJoints:
    """Joint positions of the posed body, and their derivatives w.r.t. the states."""

    joints: np.ndarray  # (F, 72) joint positions in metres.
    by_states: np.ndarray  # (F, 72, 38) derivatives w.r.t. the states.

    @classmethod
    def of(cls, subject: Subject, poses: PosedFrames, by_states: np.ndarray) -> PosedJoints:
        """Compute the 24 joints and their derivatives."""
        landmarks = keypoint_landmarks(subject.body, JointSet.SMPL_24)
        found = pose_landmarks(
            subject.body, landmarks, subject.betas, poses.root, poses.local, poses.transl, jacobian=True
        )
        assert found.by_rotations is not None
        eye = np.broadcast_to(np.eye(3), (*found.points.shape[:2], 3, 3))
        J = np.concatenate([found.by_rotations, eye], axis=-1)
        J = J.reshape(len(by_states), -1, J.shape[-1])
        return cls(found.points.reshape(len(J), -1), J @ by_states)


def with_weight(sequence: Sequence, latent_weight: float) -> Sequence:
    """Return the sequence with another weight of the codes' density."""
    return replace(sequence, latent_weight=latent_weight)
