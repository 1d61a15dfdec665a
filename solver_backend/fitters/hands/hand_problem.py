"""One hand over a take: its objective, frame by frame, and the equations of its keys."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.hand_angles import NUM_ANGLES
from solver_backend.body.hand_skeleton import BONES, PAIRS, HandSites, HandSkeleton, finger_gaps
from solver_backend.body.state_layout import Block, StateLayout
from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations, differences, matrices_by_keys
from solver_backend.fitters.model.keyframe_curve import summed_by_keys
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows, lagrange
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, skew
from solver_backend.priors.hand_prior import HandPrior
from solver_backend.residuals.terms import DataTerm
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.types.shapes import Bool, Float

TURN, SHIFT, FINGERS = slice(0, 3), slice(3, 6), slice(6, 6 + NUM_ANGLES)
"""Parts of a key: rotation vector of the wrist against the body's (world), its shift in metres, and finger angles."""
DOF = FINGERS.stop  # Numbers of a key.
KEY = StateLayout((Block("turn", 3), Block("shift", 3), Block("fingers", NUM_ANGLES)))  # Layout of a key.
FLOOR = 1e-3  # Least precision of every unknown.


def states_at(keys: Float[np.ndarray, "keys d"], rows: WindowRows) -> Float[np.ndarray, "n d"]:
    """Return (N n, D) states of the frames of N windows, on the parabolas through their three keys."""
    triples = np.stack([keys[i : len(keys) - 2 + i : 2] for i in range(3)], axis=1)
    return (lagrange(rows.time) @ triples).reshape(-1, keys.shape[1])


def covariance_at(system: BlockTridiagonal, layout: KeyframeLayout) -> tuple[np.ndarray, WindowRows]:
    """Return (N n, D, D) covariances of the frames of N windows, and these frames.

    ``Σ_ab w_a w_b S_ab`` over the three keys of each window, from the inverse's blocks (see ``marginals``).
    """
    diagonal, upper = system.marginals()
    rows = layout.rows()
    own = diagonal[:-1].reshape(-1, 2, DOF, 2, DOF)
    after = upper.reshape(-1, 2, DOF, 2, DOF)[:, :, :, 0]
    last = diagonal[1:].reshape(-1, 2, DOF, 2, DOF)[:, 0, :, 0]
    S = np.zeros((len(own), 3, 3, DOF, DOF))
    S[:, :2, :2] = own.transpose(0, 1, 3, 2, 4)
    S[:, :2, 2] = after
    S[:, 2, :2] = np.swapaxes(after, -1, -2)
    S[:, 2, 2] = last
    shares = lagrange(rows.time)
    mixes = (shares[..., :, None] * shares[..., None, :]).reshape(*rows.time.shape, 9)
    return (mixes @ S.reshape(len(S), 9, -1)).reshape(-1, DOF, DOF), rows


GIVES_WAY_M, SIGMA_M = 0.002, 0.001
"""Overlap that costs nothing, as the skin of fingers that lie side by side, and the standard deviation of the rest:
half of the difference of fingers' breadths between people, so that contradicting detections do not press fingers
together."""


def contact_equations(
    points: Float[np.ndarray, "n 21 3"], jacobian: Float[np.ndarray, "n 21 3 d"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return costs (n,), gradients (n, D) and Gauss-Newton matrices (n, D, D) of ``½ Σ max(depth - δ, 0)² / σ²``.

    The nearest points of two bones move along these without a first-order effect on their distance.

    Args:
        points: (n, 21, 3) metres of ``HAND_POINTS``.
        jacobian: (n, 21, 3, D) of them by the state.
    """
    count, dof = len(points), jacobian.shape[-1]
    cost, gradient, hessian = np.zeros(count), np.zeros((count, dof)), np.zeros((count, dof, dof))
    gaps = finger_gaps(points)
    frame, pair = np.nonzero(gaps.depth > GIVES_WAY_M)
    if not len(frame):
        return cost, gradient, hessian
    over = (gaps.depth[frame, pair] - GIVES_WAY_M) / SIGMA_M
    apart = gaps.apart[frame, pair]
    normal = apart / np.maximum(np.linalg.norm(apart, axis=-1, keepdims=True), 1e-6)
    moved = np.zeros((len(frame), 3, dof))
    for which, sign in enumerate((1.0, -1.0)):
        share = gaps.along[frame, pair, which, None, None]
        first, last = BONES[PAIRS[which][pair]].T
        moved += sign * ((1.0 - share) * jacobian[frame, first] + share * jacobian[frame, last])
    rows = -(normal[:, None] @ moved)[:, 0] / SIGMA_M
    np.add.at(cost, frame, 0.5 * over**2)
    np.add.at(gradient, frame, over[:, None] * rows)
    np.add.at(hessian, frame, rows[:, :, None] * rows[:, None])
    return cost, gradient, hessian


SIZES = (0.75, 1.35)  # Limits of hands' size by the body's own: seven standard deviations. Another size is a fault.
TURN_SIGMA = float(np.deg2rad(35.0))
"""Deviation of a wrist's turn from the body's, whose keypoints barely constrain twist."""
ACCELERATION = {"turn": 120.0, "shift": 12.0, "fingers": 30.0}
"""Standard deviations of accelerations over a tenth of a second, rad/s² and m/s². Those of fingers in the recorded
exercises (Ganguly et al. 2021) are 5 rad/s² RMS, 22 in one frame of a hundred, 150 at most."""


@dataclass(frozen=True)
class WristPath:
    """A body's wrist over F frames."""

    rotations: Float[np.ndarray, "frames 3 3"]  # (F, 3, 3) from the hand's frame at rest to the world.
    places: Float[np.ndarray, "frames 3"]  # (F, 3) metres.
    covariance: Float[np.ndarray, "frames 3 3"] | None = None
    """(F, 3, 3) m² of the place, None where the path is only a start and constrains neither place nor turn."""


@dataclass(frozen=True)
class HandProblem:
    """One hand over F frames."""

    skeleton: HandSkeleton
    sites: HandSites  # The L measured points.
    wrist: WristPath  # Origin of the hand's turns and shifts.
    term: DataTerm  # Of the L points.
    prior: HandPrior
    fps: float
    keeps_apart: bool = False  # The points are those of ``HAND_POINTS``, and fingers keep out of one another.

    @property
    def num_frames(self) -> int:
        """F."""
        return len(self.wrist.places)

    def select(self, frames: np.ndarray) -> HandProblem:
        """Return the hand in these frames alone."""
        wrist = self.wrist
        covariance = None if wrist.covariance is None else wrist.covariance[frames]
        path = WristPath(wrist.rotations[frames], wrist.places[frames], covariance)
        return replace(self, wrist=path, term=self.term.select(frames))

    def points(self, states: np.ndarray, frames: np.ndarray | None = None) -> Float[np.ndarray, "frames sites 3"]:
        """Return (n, L, 3) world places of the points in states (n, D) of these frames, or of all."""
        frames = np.arange(self.num_frames) if frames is None else frames
        own = self.skeleton.sites(self.skeleton.pose(states[:, FINGERS]), self.sites)
        arms = own @ np.swapaxes(self._turns(states, frames), 1, 2)
        return (self.wrist.places[frames] + states[:, SHIFT])[:, None] + arms

    def evaluate(
        self, states: np.ndarray, frames: np.ndarray, scale: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return costs (n,), gradients (n, D) and Gauss-Newton matrices (n, D, D) of the data at states of frames."""
        points, jacobian = self._placed(states, frames)
        found = self.term.select(frames)(points, scale)
        flat = jacobian.reshape(len(states), -1, DOF)
        carried = (found.information @ jacobian).reshape(len(states), -1, DOF)
        flat_T = np.swapaxes(flat, 1, 2)
        gradient = (flat_T @ found.gradient.reshape(len(states), -1, 1))[..., 0]
        hessian = flat_T @ carried
        if found.shared is not None:
            rows = found.shared.reshape(*found.shared.shape[:2], -1) @ flat
            hessian -= np.swapaxes(rows, 1, 2) @ rows
        # In every frame, not at the keys alone: a spline swings beyond them where no view shows the fingers.
        held, pull, stiffness = self.prior.limits(states[:, FINGERS])
        gradient[:, FINGERS] += pull
        hessian[:, FINGERS, FINGERS] += np.eye(NUM_ANGLES) * stiffness[:, None]
        cost = found.cost + held
        if self.keeps_apart:
            contact = contact_equations(points, jacobian)
            return cost + contact[0], gradient + contact[1], hessian + contact[2]
        return cost, gradient, hessian

    def jacobian(self, states: np.ndarray) -> Float[np.ndarray, "frames sites 3 d"]:
        """Return (F, L, 3, D) derivatives of the points by the states of all frames."""
        return self._placed(states, np.arange(self.num_frames))[1]

    def at(self, sites: HandSites) -> HandProblem:
        """Return the problem with other points. Its term is not theirs."""
        return replace(self, sites=sites)

    def _placed(self, states: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points (n, L, 3) and their derivatives (n, L, 3, D): ``y = t + δ + exp(ω) R q(angles)``."""
        posed = self.skeleton.pose(states[:, FINGERS])
        own = self.skeleton.sites(posed, self.sites)
        R = self._turns(states, frames)
        arms = own @ np.swapaxes(R, 1, 2)
        jacobian = np.zeros((*own.shape, DOF))
        jacobian[..., TURN] = -skew(arms) @ left_jacobian_so3(states[:, TURN])[:, None]
        jacobian[..., SHIFT] = np.eye(3)
        jacobian[..., FINGERS] = self.skeleton.site_jacobian(posed, self.sites, own, R)
        return (self.wrist.places[frames] + states[:, SHIFT])[:, None] + arms, jacobian

    def _turns(self, states: np.ndarray, frames: np.ndarray) -> np.ndarray:
        return exp_so3(states[:, TURN]) @ self.wrist.rotations[frames]


@dataclass(frozen=True)
class KeyModel:
    """A hand's keys and their objective."""

    problem: HandProblem
    layout: KeyframeLayout
    moving: Bool[np.ndarray, " keys"] | None = None  # (K,) keys that move, None for all.

    def linearise(self, state: np.ndarray, scale: float) -> tuple[np.ndarray, BlockTridiagonal]:
        """Return the (1,) cost and the normal equations of keys (K, D)."""
        cost, equations = self.equations(state, scale)
        return np.array([cost]), equations.block_tridiagonal()

    def retract(self, state: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return the keys moved by a step."""
        return state + step.reshape(-1, DOF)[: len(state)]

    def equations(self, keys: np.ndarray, scale: float) -> tuple[float, KeyframeNormalEquations]:
        """Return the cost of keys and their equations: data, the body's wrist, the prior of hands, accelerations.

        With keys h and h' apart, ``a_k = 2 (x_{k-1} / (h (h + h')) - x_k / (h h') + x_{k+1} / (h' (h + h')))``.
        """
        rows, count = self.layout.rows(), self.layout.num_windows
        costs, gradient, hessian = self.problem.evaluate(states_at(keys, rows), rows.frames.reshape(-1), scale)
        cost = float((costs * rows.weight.reshape(-1)).sum())
        equations = KeyframeNormalEquations.empty(count, KEY, keys, floor=FLOOR, precision=np.float64)
        each = np.broadcast_to(np.eye(DOF), (len(keys), DOF, DOF))
        by_keys = matrices_by_keys(rows, hessian, each)
        equations.add_windows(slice(0, count), by_keys)
        shares = np.swapaxes(lagrange(rows.time) * rows.weight[..., None], 1, 2)
        gradient = summed_by_keys(shares @ gradient.reshape(*rows.frames.shape, DOF))
        equations.add_ends(by_keys[:, 2 * DOF :, 2 * DOF :], gradient)
        held, pull, precision = self.problem.prior.equations(keys[:, FINGERS])
        equations.add_each(FINGERS, precision, pull)
        cost += float(held.sum()) + self._hold_wrist(keys, equations)
        h = np.diff(self.layout.key_times / self.problem.fps)
        before, after, both = h[:-1], h[1:], h[:-1] + h[1:]
        stencil = 2.0 / (before * both), -2.0 / (before * after), 2.0 / (after * both)
        sigma = np.repeat(list(ACCELERATION.values()), (3, 3, NUM_ANGLES))
        equations.add_differences(keys / sigma, each / sigma, stencil, 1.0)
        cost += 0.5 * float((differences(keys / sigma, stencil, 1.0)[0] ** 2).sum())
        return cost, equations if self.moving is None else equations.with_fixed(~self.moving)

    def _hold_wrist(self, keys: np.ndarray, equations: KeyframeNormalEquations) -> float:
        covariance = self.problem.wrist.covariance
        if covariance is None:
            return 0.0
        frames = np.round(self.layout.key_times).astype(int)
        precision = np.zeros((len(keys), 6, 6))
        precision[:, TURN, TURN] = np.eye(3) / TURN_SIGMA**2
        precision[:, SHIFT, SHIFT] = np.linalg.inv(covariance[frames])
        pull = (precision @ keys[:, :6, None])[..., 0]
        equations.add_each(slice(0, 6), precision, pull)
        return 0.5 * float((pull * keys[:, :6]).sum())
