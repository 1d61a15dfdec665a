"""One hand over a take: its objective, frame by frame, and the equations of its keys."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.hand_angles import NUM_ANGLES
from solver_backend.body.hand_skeleton import HandSites, HandSkeleton
from solver_backend.fitters.hands.finger_contact import contact_equations
from solver_backend.fitters.hands.hand_keys import DOF, FINGERS, SHIFT, TURN, KeyEquations, states_at
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, skew
from solver_backend.priors.hand_prior import HandPrior
from solver_backend.residuals.point_term import DataTerm
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.types.shapes import Bool, Float

TURN_SIGMA = float(np.deg2rad(35.0))
"""How far a wrist is turned from where the body's keypoints have it: they hardly constrain twist."""
ACCELERATION = {"turn": 120.0, "shift": 12.0, "fingers": 30.0}
"""Standard deviations of accelerations over a tenth of a second, rad/s² and m/s². Those of fingers in the recorded
exercises (Ganguly et al. 2021) are 5 rad/s² RMS, 22 in one frame of a hundred, 150 at most."""


@dataclass(frozen=True)
class WristPath:
    """Where a body has a wrist over F frames, and how sure that is."""

    rotations: Float[np.ndarray, "frames 3 3"]
    """(F, 3, 3) from the hand's frame at rest to the world."""
    places: Float[np.ndarray, "frames 3"]
    """(F, 3) metres."""
    covariance: Float[np.ndarray, "frames 3 3"] | None = None
    """(F, 3, 3) m² of the place; None where the path constrains neither place nor turn and is only a start."""


@dataclass(frozen=True)
class HandProblem:
    """One hand over F frames."""

    skeleton: HandSkeleton
    """Its bones."""
    sites: HandSites
    """The L points that are measured."""
    wrist: WristPath
    """What the hand's turns and shifts are from."""
    term: DataTerm
    """How far the points are from what was measured."""
    prior: HandPrior
    """What fingers do together."""
    fps: float
    """Frames per second."""
    keeps_apart: bool = False
    """Whether the points are those of ``HAND_POINTS``, whose fingers keep out of one another."""

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
        """Return the problem with other points; its term is not theirs."""
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
        """Return (n, 3, 3) rotations from the hand's frame to the world."""
        return exp_so3(states[:, TURN]) @ self.wrist.rotations[frames]


@dataclass(frozen=True)
class KeyModel:
    """A hand's keys and their objective."""

    problem: HandProblem
    """The hand."""
    layout: KeyframeLayout
    """Windows of its keys."""
    moving: Bool[np.ndarray, " keys"] | None = None
    """(K,) which keys move; None: all do."""

    @property
    def rows(self) -> WindowRows:
        """The frames of all windows."""
        return self.layout.rows()

    def linearise(self, keys: np.ndarray, scale: float) -> tuple[np.ndarray, BlockTridiagonal]:
        """Return the (1,) cost and the normal equations of keys (K, D)."""
        cost, equations = self.equations(keys, scale)
        return np.array([cost]), equations.block_tridiagonal()

    def equations(self, keys: np.ndarray, scale: float) -> tuple[float, KeyEquations]:
        """Return the cost of keys and their equations: data, the body's wrist, the prior of hands, accelerations."""
        rows, equations = self.rows, KeyEquations.empty(len(keys))
        costs, gradient, hessian = self.problem.evaluate(states_at(keys, rows), rows.frames.reshape(-1), scale)
        equations.add_frames(rows, gradient, hessian)
        cost = float((costs * rows.weight.reshape(-1)).sum())
        held, pull, precision = self.problem.prior.equations(keys[:, FINGERS])
        equations.add_keys(pull, precision, FINGERS)
        cost += float(held.sum()) + self._hold_wrist(keys, equations)
        sigma = np.repeat(list(ACCELERATION.values()), (3, 3, NUM_ANGLES))
        cost += equations.add_acceleration(keys, self.layout.key_times / self.problem.fps, sigma**-2.0)
        if self.moving is not None:
            equations.hold(~self.moving)
        return cost, equations

    def _hold_wrist(self, keys: np.ndarray, equations: KeyEquations) -> float:
        """Add the body's constraint on the wrist at each key, and return its cost."""
        covariance = self.problem.wrist.covariance
        if covariance is None:
            return 0.0
        frames = np.round(self.layout.key_times).astype(int)
        precision = np.zeros((len(keys), 6, 6))
        precision[:, TURN, TURN] = np.eye(3) / TURN_SIGMA**2
        precision[:, SHIFT, SHIFT] = np.linalg.inv(covariance[frames])
        pull = (precision @ keys[:, :6, None])[..., 0]
        equations.add_keys(pull, precision, slice(0, 6))
        return 0.5 * float((pull * keys[:, :6]).sum())
