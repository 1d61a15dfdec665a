"""Solve by BundleMoCap++ as published, one window after another (thesis 6.2.5 and 6.3.2).

Each window follows SIDER-2 through three keyframes. Its first keyframe is the previous window's last one and is fixed.
The other two move by projected gradient descent. There is no prior term, because codes never leave SPoser's sphere. The
regressor gives the shape in the first frame. No pass learns shape, bias or noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.optimise import Stretches
from solver_backend.fitters.model.keyframe_curve import KeyframeCurve, by_turns
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Keyframes, PosedFrames, Subject, hemisphere_aligned, pose
from solver_backend.fitters.problem import Convergence, MethodResult, Problem, SolvedFrames
from solver_backend.fitters.single_frame import fit_to_points, lifted_betas
from solver_backend.geometry.arrays import Array, array_namespace, zeros
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.terms import PointTerm
from solver_backend.solver.descent import MinimiseResult, MinimiseSettings, gradient_descent
from solver_backend.solver.manifolds import SO3, CodeSphere, Euclidean, Product

KEYS = Product((CodeSphere(), SO3(), Euclidean()))  # Manifold of a key: code, root rotation and translation.
WIDER = 3.0  # Factor applied to the outlier scale: 12 deviations, chosen by tests/benchmarks/tune_baselines.py.
KeyState = tuple[Array, Array, Array]  # Codes (n, d), root rotations (n, 3, 3), translations (n, 3).


@dataclass(frozen=True)
class Window:
    """Frames of one window, with all quantities that are fixed during its solve."""

    subject: Subject
    prior: PosePrior
    term: PointTerm  # Data in the window's frames.
    scale: float  # Geman-McClure scale, in the term's standard deviations.
    time: np.ndarray  # (F,) positions in the window, 0..1.
    first: KeyState  # The key from which the window starts, n = 1.

    def frames(self, state: KeyState) -> PosedFrames:
        """Return the poses between the keyframes (thesis eqs. 6.9, 6.10)."""
        return self.curve(state).poses(self.prior)

    def objective(self, state: KeyState) -> tuple[float, KeyState]:
        """Return the window's cost and its gradient w.r.t. the free keyframes.

        The cost is the data term over the frames (thesis eqs. 6.7, 6.8). The gradient is computed in reverse mode.
        """
        curve = self.curve(state)
        frames, vjp = curve.poses_with_vjp(self.prior)
        posed, xp = pose(self.subject, frames, jacobian=True), array_namespace(frames.transl)
        evidence = self.term(posed.points, self.scale)
        assert posed.by_rotations is not None
        by_rotations = xp.sum(posed.by_rotations * evidence.gradient[..., None], axis=(1, 2))
        by_poses = xp.concat([by_rotations, xp.sum(evidence.gradient, axis=1)], axis=1)
        own, by_codes = self.codes_cost(curve.codes.value[0])
        by_keys = vjp(by_poses, by_codes)
        assert by_keys.z is not None
        cost = float(xp.sum(evidence.cost)) + own
        return cost, (by_keys.z[0, 1:], by_turns(curve.keys.quat, by_keys.quat)[0, 1:], by_keys.transl[0, 1:])

    def codes_cost(self, z: Array) -> tuple[float, Array | None]:
        """Return an additional cost of codes (F, d), and its gradient. The published method has no additional cost."""
        return 0.0, None

    def keys(self, state: KeyState) -> Keyframes:
        """Return the window's keyframes (1, n + 1), with the fixed one first."""
        xp = array_namespace(*state)
        z, R, transl = (xp.concat([a, b]) for a, b in zip(self.first, state, strict=True))
        residual = xp.reshape(zeros((len(z), NUM_BODY_JOINTS * 3), z), (-1, NUM_BODY_JOINTS, 3))
        return hemisphere_aligned(Keyframes(z, quat_from_matrix(R), transl, residual)).select(np.arange(len(z))[None])

    def curve(self, state: KeyState) -> KeyframeCurve:
        """Return the curve through the keyframes: SIDER-n, with a polynomial for the translations."""
        return KeyframeCurve.through(self.keys(state), self.time[None], residuals=False)


@dataclass(frozen=True)
class Slid:
    """Poses of a take after all windows are solved."""

    frames: PosedFrames
    found: tuple[MinimiseResult, ...]  # One result per window.


def slide(
    layout: KeyframeLayout,
    first: KeyState,
    window: Callable[[np.ndarray, np.ndarray, KeyState], Window],
    start: Callable[[int, KeyState], KeyState],
    minimise: Callable[[Window, KeyState], MinimiseResult],
    progress: Progress,
) -> Slid:
    """Solve one window after another (thesis 6.3.2).

    Args:
        first: first keyframe of the take.
        window: creates a window from frame numbers, their positions in the window, and the fixed keyframe.
        start: returns initial free keyframes, given a window's number and its fixed keyframe.
        minimise: solves a window from initial keyframes.
    """
    number, time = layout.positions(layout.frames)
    key, parts, found = first, [], []
    for w in range(layout.num_windows):
        index = np.flatnonzero(number == w)
        own = window(index, time[index], key)
        found.append(minimise(own, start(w, key)))
        parts.append(own.frames(found[-1].state))
        key = select_keys(found[-1].state, slice(-1, None))
        progress("Sliding bundle", w + 1, layout.num_windows)
    return Slid(PosedFrames.concatenate(parts), tuple(found))


def solve_bundlemocap(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Solve a take with the published BundleMoCap method, starting from keyframes fitted to points."""
    problem, measured = replace(problem, pose_terms=()), problem.measurements
    seen = np.flatnonzero(measured.seen)
    if settings.betas is None and not measured.knows_person:
        subject = replace(subject, betas=lifted_betas(subject, measured, seen[:1]))
    layout = KeyframeLayout.even(problem.num_frames, settings.window)
    guesses = keys_near(problem, subject, layout.key_times, seen)
    limits = MinimiseSettings(max_iterations=settings.iterations)
    slid = slide(
        layout,
        select_keys(guesses, slice(0, 1)),
        lambda index, time, key: Window(
            subject, problem.prior, measured.term.select(index), WIDER * settings.robust_scale, time, key
        ),
        lambda w, key: select_keys(guesses, slice(2 * w + 1, 2 * w + 3)),
        lambda window, state: gradient_descent(KEYS, window.objective, state, limits),
        progress,
    )
    parts = [Convergence(1, int(found.converged), found.iterations) for found in slid.found]
    return SolvedFrames(subject, slid.frames, layout.key_times), Convergence.joined(parts)


def keys_near(problem: Problem, subject: Subject, times: np.ndarray, seen: np.ndarray) -> KeyState:
    """Return keyframes at the given times, fitted to the nearest observed frames (S,)."""
    nearest = seen[np.abs(np.asarray(times)[:, None] - seen).argmin(axis=1)]
    unique, inverse = np.unique(nearest, return_inverse=True)
    fitted = fit_to_points(problem, subject, unique)
    return select_keys((fitted.z, fitted.root, fitted.transl), np.asarray(inverse).reshape(-1))


def select_keys(keys: KeyState, index: slice | np.ndarray) -> KeyState:
    """Select keyframes by index or slice."""
    z, R, t = (part[index] for part in keys)
    return z, R, t
