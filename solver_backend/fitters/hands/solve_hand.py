"""One hand from the body's wrist to its fingers in every frame: start, passes, and covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.hand_angles import FINGER_OF, JOINT_OF, KIND_OF, KNUCKLES, SPREAD, measure_angles
from solver_backend.body.hand_skeleton import HandSkeleton, finger_overlap
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.hand_problem import (
    DOF,
    FINGERS,
    SHIFT,
    TURN,
    HandProblem,
    KeyModel,
    WristPath,
    covariance_at,
)
from solver_backend.fitters.keyframes.posterior import noise_inflation
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, spline_states
from solver_backend.fitters.problem import REFERENCE_FPS, SAMPLE_FRAMES, Convergence
from solver_backend.fitters.subject_calibration.variances import reweighted_by_points
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.hand_prior import HandPrior
from solver_backend.solver.levenberg_marquardt import LMSettings, minimise
from solver_backend.types.shapes import Bool, Float

NEAR, DONE = 1e-2, 1e-3  # Relative decreases of the cost at which a solve ends, at wide scales and at the last.


@dataclass(frozen=True)
class HandKeys:
    """Solved keys of a hand, with the cost at the last robust scale."""

    keys: Float[np.ndarray, "keys d"]
    cost: float
    convergence: Convergence


def solve_keys(
    model: KeyModel, keys: np.ndarray, scales: Sequence[float], iterations: int, alive: Callable[[], None]
) -> HandKeys:
    """Return the keys that minimise the model, from (K, D) keys, at each robust scale in turn."""
    stages = [(scale, LMSettings(iterations, NEAR if scale > scales[-1] else DONE, promise=1.0)) for scale in scales]
    found = minimise(model, keys, stages, alive)
    return HandKeys(found.state, float(found.cost[0]), Convergence.of(found))


def frame_states(model: KeyModel, keys: np.ndarray) -> Float[np.ndarray, "frames d"]:
    """Return (F, D) states of all frames, on the spline whose velocities and accelerations are continuous."""
    return spline_states(keys, model.layout)


def frame_covariances(model: KeyModel, keys: np.ndarray, scale: float) -> Float[np.ndarray, "frames d d"]:
    """Return (F, D, D) covariances of the states of all frames."""
    system = model.linearise(keys, scale)[1]
    found, rows = covariance_at(system, model.layout)
    covariance = np.zeros((model.problem.num_frames, *found.shape[1:]))
    covariance[rows.frames.reshape(-1)] = found
    return covariance


PALM, LEAST_PALM = (0, 1, *KNUCKLES[1:]), 4
"""Points of the palm (wrist, root of the thumb and knuckles), and the least that place it."""
FARTHEST_M = 0.08  # Largest distance from the body's wrist at which a wrist starts.


def initial_keys(
    skeleton: HandSkeleton, wrist: WristPath, points: np.ndarray, layout: KeyframeLayout, prior: HandPrior
) -> Float[np.ndarray, "keys d"]:
    """Return (K, D) keys: means in time of the turns and angles that located points show, else the relaxed hand."""
    frames = np.arange(len(points))
    spacing = max(1.0, float(np.diff(layout.key_times).mean()))
    near = np.exp(-0.5 * ((layout.key_times[:, None] - frames) / (0.5 * spacing)) ** 2)
    turns, located = palm_turns(skeleton, points)
    relative = np.where(located[:, None, None], turns @ np.swapaxes(wrist.rotations, 1, 2), 0.0)
    # Where no frame near by shows the turn, farther ones count by their distance.
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
    """Return (F, 3, 3) rotations from rest to the world that fit the palm (Kabsch 1976), and (F,) where located."""
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
    """Return (K, d) means over time of (F, d) values that may be NaN, drawn to ``otherwise``."""
    known = np.isfinite(values)
    weight, least = near @ known, 0.1
    return (near @ np.where(known, values, 0.0) + least * otherwise) / (weight + least)


WINDOW = 12  # Frames at 60 per second of a window with three keys: fingers open and close in a fifth of a second.
INFORMED = 0.7  # Largest deviation of the knuckle's bend of a seen finger, as a share of the prior's.
CALIBRATION = 0.5
"""Calibration of the inflated posterior's variance; see ``keyframes/posterior``. The least with which 95 % ellipsoids
hold 90 % of drawn finger joints at twice the studio's noise (docs/research-log/hands.md)."""
CONSTANT_M = 0.004
"""Standard deviation per axis of errors that do not average out: others' bones, calibration, a detector's bias."""
THROUGH_M = 0.006  # Overlap of two fingers that no skin gives way to: a third of a finger's breadth.


@dataclass(frozen=True)
class SolvedHand:
    """One hand over F frames."""

    problem: HandProblem
    turn: Float[np.ndarray, "frames 3"]  # Rotation vectors of the wrist against the body's, world.
    shift: Float[np.ndarray, "frames 3"]  # Metres of the wrist against the body's.
    angles: Float[np.ndarray, "frames a"]
    points: Float[np.ndarray, "frames 21 3"]  # ``HAND_POINTS`` in metres, with their covariance.
    covariance: Float[np.ndarray, "frames 21 3 3"]
    informed: Bool[np.ndarray, "frames 5"]  # Fingers that are seen, in the order of ``FINGERS``. Others rest.
    convergence: Convergence

    @property
    def states(self) -> Float[np.ndarray, "frames d"]:
        """(F, D) turns, shifts and angles."""
        return np.concatenate([self.turn, self.shift, self.angles], axis=1)


def solve_hand(
    problem: HandProblem, located: np.ndarray, settings: SolveSettings, alive: Callable[[], None] = lambda: None
) -> SolvedHand:
    """Return a hand solved over a take: all keys at once, with the noise of each view learned between two passes.

    ``located`` are (F, 21, 3) metres to start from, NaN where a point is not located.
    """
    layout = KeyframeLayout.even(problem.num_frames, hand_window(problem.fps))
    keys = initial_keys(problem.skeleton, problem.wrist, located, layout, problem.prior)
    return solve_from(KeyModel(problem, layout), (keys,), settings, alive)


def hand_window(fps: float) -> int:
    """Return the number of frames from one window of a hand to the next at this rate."""
    return max(2, round(WINDOW * fps / REFERENCE_FPS))


def solve_from(
    model: KeyModel, starts: Sequence[np.ndarray], settings: SolveSettings, alive: Callable[[], None]
) -> SolvedHand:
    """Return a hand solved from the (K, D) keys that end with the lowest cost."""
    problem, scale = model.problem, settings.robust_scale
    # Fingers may pass through one another on their way, but not end so.
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
    """Return keys with less overlapping fingers, where any overlap: solved from relaxed fingers there.

    Fingers that have passed through one another are kept on the wrong sides by what keeps them apart.
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
    """Return the hand with the noise of each point by the residuals of (F, D) states."""
    sample = np.unique(np.linspace(0, len(states) - 1, min(len(states), SAMPLE_FRAMES)).astype(int))
    points = problem.points(states[sample], sample)
    return replace(problem, term=reweighted_by_points(points, problem.term.select(sample), problem.term, scale))


def informed_fingers(problem: HandProblem, spread: np.ndarray) -> Bool[np.ndarray, "frames 5"]:
    """Return (F, 5) fingers with bends that the data determine much better than the prior, by (F, D, D) covariances."""
    variance = np.diagonal(spread[:, FINGERS, FINGERS], axis1=1, axis2=2)
    bends = (KIND_OF != SPREAD) & (JOINT_OF == 1)
    share = np.zeros((len(spread), 5))
    share[:, FINGER_OF[bends]] = np.sqrt(variance[:, bends] / np.diag(problem.prior.covariance)[bends])
    return share < INFORMED
