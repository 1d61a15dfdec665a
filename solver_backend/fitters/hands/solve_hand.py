"""Solve one hand over a take: objective, normal equations, keyframes and covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.hand_skeleton import (
    BONES,
    FINGER_OF,
    JOINT_OF,
    KIND_OF,
    KNUCKLES,
    NUM_ANGLES,
    PAIRS,
    SPREAD,
    HandSites,
    HandSkeleton,
    finger_gaps,
    finger_overlap,
    measure_angles,
)
from solver_backend.body.state_layout import Block, StateLayout
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations, differences, matrices_by_keys
from solver_backend.fitters.keyframes.optimise import noise_inflation
from solver_backend.fitters.model.keyframe_curve import summed_by_keys
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows, lagrange, spline_states
from solver_backend.fitters.person_shape import reweighted_by_points
from solver_backend.fitters.problem import REFERENCE_FPS, SAMPLE_FRAMES, Convergence
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.rotations import exp_so3, left_jacobian_so3, log_so3, skew
from solver_backend.priors.hand_prior import HandPrior
from solver_backend.residuals.terms import DataTerm
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.solver.levenberg_marquardt import LMSettings, minimise
from solver_backend.types.shapes import Bool, Float

TURN, SHIFT, FINGERS = slice(0, 3), slice(3, 6), slice(6, 6 + NUM_ANGLES)
"""Entries of a keyframe: world rotation vector from the body's wrist, shift in metres, finger angles in radians."""
DOF = FINGERS.stop  # Degrees of freedom of a key.
KEY = StateLayout((Block("turn", 3), Block("shift", 3), Block("fingers", NUM_ANGLES)))  # Layout of a key.
FLOOR = 1e-3  # Smallest precision of every unknown.


def states_at(keys: Float[np.ndarray, "keys d"], rows: WindowRows) -> Float[np.ndarray, "n d"]:
    """Interpolate the states to all frames of N windows, with the parabola through each window's three keyframes."""
    triples = np.stack([keys[i : len(keys) - 2 + i : 2] for i in range(3)], axis=1)
    return (lagrange(rows.time) @ triples).reshape(-1, keys.shape[1])


def covariance_at(system: BlockTridiagonal, layout: KeyframeLayout) -> tuple[np.ndarray, WindowRows]:
    """Return the covariances of the hand's state in all frames of N windows, and the frame numbers.

    The covariances are (N m, D, D) for m frames per window. Each is ``Σ_ab w_a w_b S_ab``, where a and b run over the
    three keyframes of its window. S_ab are blocks of the inverse matrix (see ``marginals``), and w are the weights of
    the parabola.
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
"""Overlap of two fingers in metres that soft skin allows, and standard deviation of any further overlap: half the
spread of finger widths among people."""


def contact_equations(
    points: Float[np.ndarray, "n 21 3"], jacobian: Float[np.ndarray, "n 21 3 d"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Penalise intersecting fingers by ``½ Σ max(depth - δ, 0)² / σ²``.

    Return costs (n,), gradients and Gauss-Newton matrices. The depth is the overlap of two finger bones in metres. δ is
    ``GIVES_WAY_M``, and σ is ``SIGMA_M``. The derivatives treat the nearest points of two bones as fixed on the bones,
    because sliding changes their distance only to second order. ``points`` (n, 21, 3) are ``HAND_POINTS`` in metres,
    and ``jacobian`` (n, 21, 3, D) their derivative w.r.t. the state.
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


SIZES = (0.75, 1.35)  # Limits of a hand's size relative to the body's shape: seven deviations. Others are errors.
TURN_SIGMA = float(np.deg2rad(35.0))  # Deviation of the wrist's rotation from the body's, whose twist is uncertain.
ACCELERATION = {"turn": 120.0, "shift": 12.0, "fingers": 30.0}
"""Standard deviations of accelerations over 0.1 s, rad/s² and m/s². Fingers: 5 rad/s² RMS (Ganguly et al. 2021)."""


@dataclass(frozen=True)
class WristPath:
    """Wrist poses of a solved body in F frames. A hand solve starts from them."""

    rotations: Float[np.ndarray, "frames 3 3"]  # (F, 3, 3) from the hand's axes at rest to the world.
    places: Float[np.ndarray, "frames 3"]  # (F, 3) metres.
    covariance: Float[np.ndarray, "frames 3 3"] | None = None
    """(F, 3, 3) covariance of the position in m². None if the path is only an initial guess and constrains nothing."""


@dataclass(frozen=True)
class HandProblem:
    """Measurements, skeleton and priors for solving one hand over F frames."""

    skeleton: HandSkeleton
    sites: HandSites  # The L measured points.
    wrist: WristPath  # Origin of the hand's rotations and shifts.
    term: DataTerm  # Data term of the L points.
    prior: HandPrior
    fps: float
    keeps_apart: bool = False  # The points are ``HAND_POINTS``, and an energy keeps the fingers from intersecting.

    @property
    def num_frames(self) -> int:
        """Number of frames in the take."""
        return len(self.wrist.places)

    def select(self, frames: np.ndarray) -> HandProblem:
        """Return the problem restricted to frames that are selected by indices."""
        wrist = self.wrist
        covariance = None if wrist.covariance is None else wrist.covariance[frames]
        path = WristPath(wrist.rotations[frames], wrist.places[frames], covariance)
        return replace(self, wrist=path, term=self.term.select(frames))

    def points(self, states: np.ndarray, frames: np.ndarray | None = None) -> Float[np.ndarray, "frames sites 3"]:
        """Return the world positions (n, L, 3) of the measured points for states (n, D) in n frames."""
        frames = np.arange(self.num_frames) if frames is None else frames
        own = self.skeleton.sites(self.skeleton.pose(states[:, FINGERS]), self.sites)
        arms = own @ np.swapaxes(self._turns(states, frames), 1, 2)
        return (self.wrist.places[frames] + states[:, SHIFT])[:, None] + arms

    def evaluate(
        self, states: np.ndarray, frames: np.ndarray, scale: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return costs (n,), gradients and Gauss-Newton matrices of data, joint limits and contacts in n frames."""
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
        # In every frame, not only at the keys: between keys, a spline overshoots where no view shows the fingers.
        held, pull, stiffness = self.prior.limits(states[:, FINGERS])
        gradient[:, FINGERS] += pull
        hessian[:, FINGERS, FINGERS] += np.eye(NUM_ANGLES) * stiffness[:, None]
        cost = found.cost + held
        if self.keeps_apart:
            contact = contact_equations(points, jacobian)
            return cost + contact[0], gradient + contact[1], hessian + contact[2]
        return cost, gradient, hessian

    def jacobian(self, states: np.ndarray) -> Float[np.ndarray, "frames sites 3 d"]:
        """Return the derivatives (F, L, 3, D) of the points w.r.t. the states in all frames."""
        return self._placed(states, np.arange(self.num_frames))[1]

    def at(self, sites: HandSites) -> HandProblem:
        """Return the problem for other points on the hand. Its data term still refers to the previous points."""
        return replace(self, sites=sites)

    def _placed(self, states: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points (n, L, 3) ``y = t + δ + exp(ω) R q``, and derivatives (n, L, 3, D) w.r.t. the states.

        t and R are the wrist's pose, δ and ω the state's shift and rotation, and q is the point on the posed hand.
        """
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
    """Objective of a hand as a function of its keyframes."""

    problem: HandProblem
    layout: KeyframeLayout
    moving: Bool[np.ndarray, " keys"] | None = None  # (K,) keys that move. None means all.

    def linearise(self, state: np.ndarray, scale: float) -> tuple[np.ndarray, BlockTridiagonal]:
        """Return the (1,) cost and the normal equations at (K, D) keyframes."""
        cost, equations = self.equations(state, scale)
        return np.array([cost]), equations.block_tridiagonal()

    def retract(self, state: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Add a step to the keyframes."""
        return state + step.reshape(-1, DOF)[: len(state)]

    def equations(self, keys: np.ndarray, scale: float) -> tuple[float, KeyframeNormalEquations]:
        """Return the cost and normal equations of a hand's keyframes.

        The cost includes the measurements, the wrist, the hand prior and the acceleration ``a_k`` at each keyframe:
        ``a_k = 2 (x_{k-1} / (h (h + h')) - x_k / (h h') + x_{k+1} / (h' (h + h')))``. h and h' are the times from
        keyframe k to the previous and to the next keyframe.
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


NEAR, DONE = 1e-2, 1e-3  # Relative cost decreases at which a solve ends: at wide scales, and at the last.


@dataclass(frozen=True)
class HandKeys:
    """Solved keyframes of a hand, with the cost at the last robust scale."""

    keys: Float[np.ndarray, "keys d"]
    cost: float
    convergence: Convergence


def solve_keys(
    model: KeyModel, keys: np.ndarray, scales: Sequence[float], iterations: int, alive: Callable[[], None]
) -> HandKeys:
    """Minimise the objective at one robust scale after another, starting from (K, D) keyframes."""
    stages = [(scale, LMSettings(iterations, NEAR if scale > scales[-1] else DONE, promise=1.0)) for scale in scales]
    found = minimise(model, keys, stages, alive)
    return HandKeys(found.state, float(found.cost[0]), Convergence.of(found))


def frame_states(model: KeyModel, keys: np.ndarray) -> Float[np.ndarray, "frames d"]:
    """Return the states (F, D) in all frames, interpolated by a spline with continuous acceleration."""
    return spline_states(keys, model.layout)


def frame_covariances(model: KeyModel, keys: np.ndarray, scale: float) -> Float[np.ndarray, "frames d d"]:
    """Return the covariances (F, D, D) of the states in all frames."""
    system = model.linearise(keys, scale)[1]
    found, rows = covariance_at(system, model.layout)
    covariance = np.zeros((model.problem.num_frames, *found.shape[1:]))
    covariance[rows.frames.reshape(-1)] = found
    return covariance


PALM, LEAST_PALM = (0, 1, *KNUCKLES[1:]), 4  # Palm points (wrist, thumb root, knuckles), and smallest number of them.
FARTHEST_M = 0.08  # Largest distance in metres between the initial wrist and the body's wrist.


def initial_keys(
    skeleton: HandSkeleton, wrist: WristPath, points: np.ndarray, layout: KeyframeLayout, prior: HandPrior
) -> Float[np.ndarray, "keys d"]:
    """Estimate initial keyframes (K, D) from triangulated points, or from the relaxed hand where points are missing."""
    frames = np.arange(len(points))
    spacing = max(1.0, float(np.diff(layout.key_times).mean()))
    near = np.exp(-0.5 * ((layout.key_times[:, None] - frames) / (0.5 * spacing)) ** 2)
    turns, located = palm_turns(skeleton, points)
    relative = np.where(located[:, None, None], turns @ np.swapaxes(wrist.rotations, 1, 2), 0.0)
    # If no nearby frame shows the rotation, distant frames count, weighted by their distance.
    far = near + 1e-3 / (1.0 + np.abs(layout.key_times[:, None] - frames) / spacing) ** 2
    mean = (far @ relative.reshape(len(points), 9)).reshape(-1, 3, 3) + 1e-6 * np.eye(3)
    keys = np.zeros((layout.num_keys, DOF))
    keys[:, TURN] = log_so3(nearest_rotation(mean))
    angles = np.clip(measure_angles(points, skeleton.side), prior.low, prior.high)
    keys[:, FINGERS] = _means(near, angles, prior.mean)
    shift = points[:, 0] - wrist.places
    close = np.linalg.norm(shift, axis=1) < FARTHEST_M
    keys[:, SHIFT] = _means(near, np.where(close[:, None], shift, np.nan), np.zeros(3))
    return keys


def palm_turns(skeleton: HandSkeleton, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit palm rotations (F, 3, 3) from rest to world (Kabsch 1976). Also return an (F,) mask of usable frames."""
    palm, rest = points[:, PALM], skeleton.points_at_rest[list(PALM)]
    seen = np.isfinite(palm).all(-1)
    located = (seen.sum(1) >= LEAST_PALM) & seen[:, 0]
    weight = (seen & located[:, None])[..., None]
    count = np.maximum(weight.sum(1, keepdims=True), 1)
    here = np.where(weight, palm, 0.0)
    there = np.where(weight, rest, 0.0)
    here = np.where(weight, here - here.sum(1, keepdims=True) / count, 0.0)
    there = np.where(weight, there - there.sum(1, keepdims=True) / count, 0.0)
    return nearest_rotation(np.swapaxes(here, 1, 2) @ there + 1e-12 * np.eye(3)), located


def _means(near: np.ndarray, values: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Average (F, d) values over time with the weights ``near`` (K, F), regularised towards ``otherwise``."""
    known = np.isfinite(values)
    weight, least = near @ known, 0.1
    return (near @ np.where(known, values, 0.0) + least * otherwise) / (weight + least)


WINDOW = 12  # Frames at 60 Hz in a window with three keys. Fingers open and close in a fifth of a second.
INFORMED = 0.7  # Largest deviation of the knuckle bend of an observed finger, relative to the prior's.
CALIBRATION = 0.5
"""Factor on the posterior variance, so that 95 % ellipsoids contain 90 % of simulated joints (see hands.md)."""
CONSTANT_M = 0.004  # Deviation per axis of errors that do not average out: bone lengths, calibration, detector bias.
THROUGH_M = 0.006  # Overlap of two fingers that soft skin cannot explain: a third of a finger's width.


@dataclass(frozen=True)
class SolvedHand:
    """Solution of one hand over F frames."""

    problem: HandProblem
    turn: Float[np.ndarray, "frames 3"]  # Wrist rotation vectors relative to the body's wrist, in world axes.
    shift: Float[np.ndarray, "frames 3"]  # Wrist shift relative to the body's wrist, metres.
    angles: Float[np.ndarray, "frames a"]
    points: Float[np.ndarray, "frames 21 3"]  # ``HAND_POINTS`` in metres, with their covariance.
    covariance: Float[np.ndarray, "frames 21 3 3"]
    informed: Bool[np.ndarray, "frames 5"]  # Fingers that are observed, in the order of ``FINGERS``. Others rest.
    convergence: Convergence

    @property
    def states(self) -> Float[np.ndarray, "frames d"]:
        """(F, D) rotation vectors, shifts and finger angles in one array."""
        return np.concatenate([self.turn, self.shift, self.angles], axis=1)


def solve_hand(
    problem: HandProblem, located: np.ndarray, settings: SolveSettings, alive: Callable[[], None] = lambda: None
) -> SolvedHand:
    """Solve a hand over a take. If ``settings.learn_noise``, learn the noise before the last pass.

    ``located`` are (F, 21, 3) initial positions in metres, NaN for unknown points.
    """
    layout = KeyframeLayout.even(problem.num_frames, hand_window(problem.fps))
    keys = initial_keys(problem.skeleton, problem.wrist, located, layout, problem.prior)
    return solve_from(KeyModel(problem, layout), (keys,), settings, alive)


def hand_window(fps: float) -> int:
    """Return the number of frames in a window with three keyframes, at this frame rate."""
    return max(2, round(WINDOW * fps / REFERENCE_FPS))


def solve_from(
    model: KeyModel, starts: Sequence[np.ndarray], settings: SolveSettings, alive: Callable[[], None]
) -> SolvedHand:
    """Solve a hand from several sets of initial keyframes, and return the best solution."""
    problem, scale = model.problem, settings.robust_scale
    # Fingers may pass through each other during the solve, but must not intersect in the result.
    through = replace(model, problem=replace(problem, keeps_apart=False))
    ends = [solve_keys(through, keys, (4 * scale, 2 * scale), settings.iterations, alive) for keys in starts]
    found = min(ends, key=lambda keys: keys.cost)
    if settings.learn_noise:
        problem = with_learned_noise(problem, frame_states(model, found.keys), scale)
    model = replace(model, problem=problem)
    found = solve_keys(model, found.keys, (scale,), settings.iterations, alive)
    if problem.keeps_apart:
        found = untangled(model, found, scale, settings.iterations, alive)
    states, spread = frame_states(model, found.keys), frame_covariances(model, found.keys, scale)
    measured = problem.points(states)
    inflation = CALIBRATION * noise_inflation(measured, problem.term, scale, max(1, hand_window(problem.fps) // 2))
    shown = problem.at(problem.skeleton.keypoints())
    points, J = shown.points(states), shown.jacobian(states)
    covariance = inflation * (J @ spread[:, None] @ np.swapaxes(J, -1, -2)) + CONSTANT_M**2 * np.eye(3)
    turn, shift, angles = states[:, TURN], states[:, SHIFT], states[:, FINGERS]
    return SolvedHand(
        problem, turn, shift, angles, points, covariance, informed_fingers(problem, spread), found.convergence
    )


def untangled(model: KeyModel, found: HandKeys, scale: float, iterations: int, alive: Callable[[], None]) -> HandKeys:
    """Solve intersecting fingers again, and keep the result if they intersect less.

    Fingers that have passed through each other stay on the wrong side, because the objective keeps them apart.
    """
    depth = finger_overlap(model.problem.points(frame_states(model, found.keys)))
    deep = np.flatnonzero(depth > THROUGH_M)
    if not len(deep):
        return found
    keys, window = found.keys.copy(), hand_window(model.problem.fps)
    near = np.abs(model.layout.key_times[:, None] - deep).min(axis=1) <= window
    keys[near if model.moving is None else near & model.moving, FINGERS] = model.problem.prior.mean
    again = solve_keys(model, keys, (scale,), iterations, alive)
    less = finger_overlap(model.problem.points(frame_states(model, again.keys))).max() < depth.max()
    return again if less else found


def with_learned_noise(problem: HandProblem, states: Float[np.ndarray, "frames d"], scale: float) -> HandProblem:
    """Return the problem with point noise that is learned from the residuals of solved states."""
    sample = np.unique(np.linspace(0, len(states) - 1, min(len(states), SAMPLE_FRAMES)).astype(int))
    points = problem.points(states[sample], sample)
    return replace(problem, term=reweighted_by_points(points, problem.term.select(sample), problem.term, scale))


def informed_fingers(problem: HandProblem, spread: np.ndarray) -> Bool[np.ndarray, "frames 5"]:
    """Return an (F, 5) mask of fingers that the data determine better than the prior alone."""
    variance = np.diagonal(spread[:, FINGERS, FINGERS], axis1=1, axis2=2)
    bends = (KIND_OF != SPREAD) & (JOINT_OF == 1)
    share = np.zeros((len(spread), 5))
    share[:, FINGER_OF[bends]] = np.sqrt(variance[:, bends] / np.diag(problem.prior.covariance)[bends])
    return share < INFORMED
