"""Solve keyframes window by window (thesis 6.3.2) or all together, and compute covariances."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.biomechanics.segments import has_segments, turn_covariance
from solver_backend.body.keypoints import joint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.keyframes.normal_equations import (
    BLOCK_FRAMES,
    HESSIAN_FRAMES,
    BundleModel,
)
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows, lagrange
from solver_backend.fitters.model.subject import (
    BLOCK_POSES,
    Keyframes,
    PosedFrames,
    d_pose_d_key,
    hemisphere_aligned,
)
from solver_backend.fitters.problem import Convergence
from solver_backend.geometry.arrays import Array, array_namespace, constant, identity, index
from solver_backend.geometry.parallel import block_size, map_blocks
from solver_backend.geometry.small_matrices import packed
from solver_backend.residuals.terms import DataTerm
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.solver.levenberg_marquardt import LazyNormalEquations, LMSettings, minimise


@dataclass(frozen=True)
class Schedule:
    """Robust scales of a solve from wide to narrow, and settings for each scale."""

    scales: tuple[float, ...]  # Geman-McClure scales, in standard deviations.
    iterations: int  # Largest number of linearisations per scale.
    stride: int = 1  # Use every n-th frame of the data.
    tolerance: float = 1e-4  # A scale is finished when the relative change of the cost is smaller.
    hessian_frames: int = HESSIAN_FRAMES  # Frames per window whose Hessians are formed.
    promise: float = 0.0  # A step is tried if its predicted decrease exceeds this share of the tolerance. 0 tries all.


@dataclass(frozen=True)
class KeySolution:
    """Keyframes at a minimum of the objective."""

    keys: Keyframes
    cost: float  # Cost of data and priors at the last robust scale.
    convergence: Convergence  # Convergence at the last robust scale.


def _joined_solution(keys: Keyframes, parts: list[KeySolution]) -> KeySolution:
    """Join the solutions of several window ranges. The cost of a window in two ranges counts twice."""
    return KeySolution(keys, sum(part.cost for part in parts), Convergence.joined(part.convergence for part in parts))


def solve_sliding(
    model: BundleModel, layout: KeyframeLayout, start: Keyframes, schedule: Schedule, progress: Progress = silent
) -> KeySolution:
    """Solve one window after another with its first keyframe fixed (thesis 6.3.2, eqs. 6.6-6.8).

    The first of the n N + 1 initial keyframes does not change. The other initial keyframes may be rough guesses.
    """
    keys, found = start, []
    fixed = np.arange(layout.free + 1) == 0
    for w in range(layout.num_windows):
        window = slice(layout.free * w, layout.free * (w + 1) + 1)
        solved = solve_keys(model, layout.part(slice(w, w + 1)), keys.select(window), schedule, fixed)
        keys = keys.replaced(window, solved.keys)
        found.append(solved)
        progress("Sliding bundle", w + 1, layout.num_windows)
    return _joined_solution(hemisphere_aligned(keys), found)


def solve_keys(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    fixed: np.ndarray | None = None,
    alive: Callable[[], None] = lambda: None,
) -> KeySolution:
    """Solve all free keyframes together. The computing time is linear in the take's length.

    Args:
        fixed: (n N + 1,) bool, keyframes that do not move. None if all move.
        alive: called before each linearisation. It may raise an error to stop the solve.
    """
    rows = layout.rows(schedule.stride)
    fixed = np.zeros(layout.num_keys, dtype=bool) if fixed is None else fixed
    problem = _KeyProblem(model, layout, rows, schedule.hessian_frames, model.decode_fixed(start, rows), fixed)
    settings = LMSettings(schedule.iterations, schedule.tolerance, schedule.promise)
    stages = [(scale, settings) for scale in schedule.scales]
    found = minimise(problem, hemisphere_aligned(start), stages, alive)
    return KeySolution(found.state, float(array_namespace(start.z).sum(found.cost)), Convergence.of(found))


@dataclass(frozen=True)
class _KeyProblem:
    model: BundleModel
    layout: KeyframeLayout
    rows: WindowRows
    hessian_frames: int
    decoded: list[Array] | None
    fixed: np.ndarray

    def linearise(self, state: Keyframes, scale: float) -> tuple[Array, LazyNormalEquations]:
        cost, form = self.model.equations(self.rows, state, scale, self.hessian_frames, self.decoded)
        return cost[None], LazyNormalEquations(lambda: form().with_fixed(self.fixed).block_tridiagonal())

    def retract(self, state: Keyframes, step: Array) -> Keyframes:
        by_key = array_namespace(step).reshape(step, (-1, self.model.free.dof))[: self.layout.num_keys]
        return state.retract(by_key, self.model.free)


CHUNK_WINDOWS = 100  # Windows per chunk. Chunks limit memory use. Chosen by hand.
OVERLAP_WINDOWS = 8
"""Number of windows that are also solved on both sides of a chunk (``tests/fitters/keyframes/test_chunked.py``)."""
SINGLE_TO_M = 100.0  # Within this distance of the origin, single precision resolves 8 µm (2⁻²⁴ · 128 m).


@dataclass(frozen=True)
class Chunk:
    """Range of windows to solve, and the part of this range whose solution is kept."""

    kept: slice
    solved: slice

    @property
    def keys(self) -> slice:
        """Keyframes of the solved windows."""
        return slice(2 * self.solved.start, 2 * self.solved.stop + 1)

    @property
    def beyond(self) -> tuple[bool, bool]:
        """Whether windows before the kept windows are also solved, and whether windows after them are."""
        return self.solved.start < self.kept.start, self.solved.stop > self.kept.stop


def chunks_of(num_windows: int, before: int, windows: int, overlap: int) -> list[Chunk]:
    """Divide N windows into chunks of about ``windows`` windows.

    Each chunk is solved together with ``before`` windows before it and ``overlap`` windows after it.
    """
    count = max(1, round(num_windows / windows))
    bounds = np.round(np.linspace(0, num_windows, count + 1)).astype(int).tolist()
    return [
        Chunk(slice(a, b), slice(max(0, a - before), min(num_windows, b + overlap)))
        for a, b in itertools.pairwise(bounds)
    ]


@dataclass(frozen=True)
class Stretch:
    """Range of windows as an independent problem, which another process can solve."""

    model: BundleModel  # Contains the measurements of its frames, or of all frames.
    layout: KeyframeLayout  # Its windows, by the model's frame numbers.
    keys: Keyframes  # Initial keys.
    schedule: Schedule
    fixed: np.ndarray  # (2N + 1,) bool, keys that do not move.

    @classmethod
    def cut(
        cls,
        model: BundleModel,
        layout: KeyframeLayout,
        keys: Keyframes,
        schedule: Schedule,
        windows: slice,
        fixed_ends: tuple[bool, bool],
    ) -> Stretch:
        """Cut a range of windows out of a take. At each fixed end, three keyframes are fixed."""
        part, some = layout.part(windows), slice(2 * windows.start, 2 * windows.stop + 1)
        number = np.arange(part.num_keys)
        fixed = (number < 3) & fixed_ends[0] | (number >= part.num_keys - 3) & fixed_ends[1]
        return cls(model.part(some), part, keys.select(some), schedule, fixed)

    def solve(self, alive: Callable[[], None] = lambda: None) -> KeySolution:
        """Solve the keyframes of the range. ``alive`` is called before each linearisation."""
        return solve_keys(self.model, self.layout, self.keys, self.schedule, self.fixed, alive)

    def alone(self) -> Stretch:
        """Remove measurements outside the range's frames from the problem, so that another process can solve it."""
        frames = self.layout.frames
        objective = replace(self.model.objective, frames=self.model.objective.frames.select(index(frames, self.keys.z)))
        bounds = self.layout.bounds - self.layout.bounds[0]
        return replace(self, model=replace(self.model, objective=objective), layout=KeyframeLayout(bounds))


Stretches = Callable[[Sequence[Stretch], Callable[[], None]], list[KeySolution]]  # Solves independent frame ranges.


def in_turn(stretches: Sequence[Stretch], alive: Callable[[], None]) -> list[KeySolution]:
    """Solve window ranges in this process, one after another."""
    return [stretch.solve(alive) for stretch in stretches]


def solve_long(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    alive: Callable[[], None] = lambda: None,
    windows: int = CHUNK_WINDOWS,
    overlap: int = OVERLAP_WINDOWS,
    each: Stretches = in_turn,
) -> KeySolution:
    """Solve a long take in chunks of ``windows`` windows, in two rounds.

    The first round solves every second chunk, with ``overlap`` additional windows on both sides. The second round
    solves the other chunks. Their ends are fixed at the keyframes of the neighbouring chunks, so that curves and second
    differences match exactly. Chunks of the same round are independent. The result does not depend on the number of
    processes or their order (red-black Gauss-Seidel, Young 1971).
    """
    keys, found = hemisphere_aligned(start), []
    for first, beyond in ((0, overlap), (1, 1)):
        chunks = chunks_of(layout.num_windows, beyond, windows, beyond)[first::2]
        stretches = [
            Stretch.cut(model, layout, keys, schedule, chunk.solved, chunk.beyond if first else (False, False))
            for chunk in chunks
        ]
        for chunk, solved in zip(chunks, each(stretches, alive), strict=True):
            lead = 2 * (chunk.kept.start - chunk.solved.start)
            kept = slice(2 * chunk.kept.start, 2 * chunk.kept.stop + 1)
            keys = keys.replaced(kept, solved.keys.select(slice(lead, lead + kept.stop - kept.start)))
            found.append(solved)
        keys = hemisphere_aligned(keys)
    return _joined_solution(keys, found)


def solve_in_single(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    alive: Callable[[], None],
    each: Stretches,
) -> KeySolution:
    """Solve all keyframes like ``solve_long``, in single precision if the take is close to the origin."""
    xp = array_namespace(start.transl)
    if float(xp.max(abs(start.transl))) >= SINGLE_TO_M:
        return solve_long(model, layout, start, schedule, alive, each=each)
    single = model.astype(xp.float32), layout, start.astype(xp.float32)
    found = solve_long(*single, schedule, alive, each=each)
    return replace(found, keys=found.keys.astype(start.z.dtype))


CALIBRATION = 0.5  # Factor applied to the inflated variance, calibrated with the ellipsoids in six benchmark takes.


def joint_covariance(
    model: BundleModel,
    layout: KeyframeLayout,
    keys: Keyframes,
    frames: PosedFrames,
    system: BlockTridiagonal,
    inflation: float,
    constant_m: np.ndarray,
    stride: int = 1,
) -> Array:
    """Return posterior covariances (F, J + S, 3, 3) of joints (m²) and segments (rad²).

    The covariance of joints is ``k f J B S Bᵀ Jᵀ + c² I``. Segment rotations are computed from ``k f B S Bᵀ`` (see
    ``turn_covariance``). S is the posterior covariance of the three keyframes in a frame's window. B is the pose's
    derivative w.r.t. these keyframes (pose tangents with Lagrange weights). J is the derivative of the joints w.r.t.
    the pose. k is ``CALIBRATION``, f is ``inflation``, and c is ``constant_m``.

    Args:
        system: normal equations at the solution.
        inflation: variance factor due to the noise's correlation in time.
        constant_m: (J,) standard deviation per axis of errors that do not average out, in metres.
        stride: compute the covariance in every n-th frame, and interpolate linearly.
    """
    xp = array_namespace(keys.z)
    diagonal, upper = system.marginals()
    residual = keys.residual if model.free.turned else None
    d_pose_d_keys = xp.astype(d_pose_d_key(model.free, model.prior, keys.z, residual), diagonal.dtype)
    landmarks = joint_landmarks(model.subject.body, model.subject.body.layout.recorded)
    constant_m2 = constant(constant_m**2, keys.z)[:, None, None] * identity(3, keys.z)
    rows = layout.rows(stride)

    def block(windows: slice) -> Array:
        part = rows.select(windows)
        poses = frames.select(part.frames[part.weight > 0] - layout.bounds[0])
        body, betas = model.subject.body, model.subject.betas
        posed = pose_landmarks(
            body, landmarks, betas, poses.root, poses.local, poses.transl, jacobian=True, by_shape=False
        )
        of_keys = _pose_covariance(diagonal, upper, d_pose_d_keys, windows)
        shares = lagrange(constant(part.time, d_pose_d_keys))
        mixes = xp.reshape(shares[..., :, None] * shares[..., None, :], (*part.time.shape, 9))
        mixed = xp.matmul(mixes, xp.reshape(of_keys, (of_keys.shape[0], 9, -1)))
        used = index(np.flatnonzero(part.weight > 0), keys.z)
        mixed = xp.reshape(mixed, (-1, poses.layout.dof, poses.layout.dof))[used]
        eye = identity(3, d_pose_d_keys)
        by_rotations = xp.astype(posed.by_rotations, d_pose_d_keys.dtype)
        J = xp.concat([by_rotations, xp.broadcast_to(eye, (*posed.points.shape[:2], 3, 3))], axis=-1)
        carried = xp.reshape(xp.matmul(xp.reshape(J, (J.shape[0], -1, poses.layout.dof)), mixed), J.shape)
        spread = xp.astype(xp.matmul(carried, xp.matrix_transpose(J)), keys.z.dtype)
        places = CALIBRATION * inflation * spread + constant_m2
        if not has_segments(body):
            return places
        turns = turn_covariance(body, poses.local, CALIBRATION * inflation * mixed, constant_m)
        return xp.concat([places, xp.astype(turns, places.dtype)], axis=1)

    found = xp.concat(map_blocks(block, rows.blocks(block_size(BLOCK_FRAMES, keys.z)), keys.z))
    return found if stride == 1 else _between(found, rows.frames[rows.weight > 0], layout.frames)


def covariance_of_joints(
    model: BundleModel,
    layout: KeyframeLayout,
    keys: Keyframes,
    frames: PosedFrames,
    scale: float,
    inflation: float,
    constant_m: np.ndarray,
    chunk_windows: int = CHUNK_WINDOWS,
    overlap: int = OVERLAP_WINDOWS,
    stride: int = 1,
    done: Callable[[int, int], None] = lambda number, total: None,
) -> Array:
    """Return packed covariances (F, J + S, 6), computed chunk by chunk (see ``joint_covariance``).

    ``done`` is called with the number of finished chunks and the total number of chunks.
    """
    first, found = layout.bounds[0], []
    chunks = chunks_of(layout.num_windows, overlap, chunk_windows, overlap)
    for chunk in chunks:
        windows, some = layout.part(chunk.solved), keys.select(chunk.keys)
        part = model.part(chunk.keys)
        system = part.information(windows, some, scale).block_tridiagonal()
        poses = frames.select(index(windows.frames - first, keys.z))
        spread = packed(joint_covariance(model, windows, some, poses, system, inflation, constant_m, stride))
        low, high = layout.bounds[chunk.kept.start] + (chunk.kept.start > 0), layout.bounds[chunk.kept.stop]
        found.append(spread[low - windows.bounds[0] : high + 1 - windows.bounds[0]])
        done(len(found), len(chunks))
    return array_namespace(keys.z).concat(found)


def _between(found: Array, frames: np.ndarray, wanted: np.ndarray) -> Array:
    """Interpolate values (F, ...) linearly at the wanted frames. Beyond the ends, repeat the first or last value."""
    after = np.clip(np.searchsorted(frames, wanted), 1, max(1, len(frames) - 1))
    before, after = after - 1, np.minimum(after, len(frames) - 1)
    share = np.clip((wanted - frames[before]) / np.maximum(frames[after] - frames[before], 1), 0.0, 1.0)
    t = constant(share, found)[:, None, None, None]
    return (1 - t) * found[index(before, found)] + t * found[index(after, found)]


def _pose_covariance(diagonal: Array, upper: Array, d_pose_d_keys: Array, windows: slice) -> Array:
    """Return the covariances (N, 3, 3, p, p) ``P_a S_ab P_bᵀ`` between the pose tangents at each window's keyframes."""
    xp = array_namespace(d_pose_d_keys)
    dof = d_pose_d_keys.shape[-1]
    start, after = slice(windows.start, windows.stop), slice(windows.start + 1, windows.stop + 1)
    across = upper[start][:, :, :dof]
    top = xp.concat([diagonal[start], across], axis=2)
    bottom = xp.concat([xp.matrix_transpose(across), diagonal[after][:, :dof, :dof]], axis=2)
    S = xp.concat([top, bottom], axis=1)
    P = [d_pose_d_keys[2 * windows.start + k : 2 * windows.stop + k : 2] for k in range(3)]
    halves = [xp.matmul(P[k], S[:, k * dof : (k + 1) * dof]) for k in range(3)]
    P_T = [xp.matrix_transpose(part) for part in P]
    parts = [xp.matmul(half[:, :, k * dof : (k + 1) * dof], P_T[k]) for half in halves for k in range(3)]
    return xp.reshape(xp.stack(parts, axis=1), (-1, 3, 3, *d_pose_d_keys.shape[1:2] * 2))


def noise_inflation(points: Array, term: DataTerm, scale: float, num_frames: int) -> float:
    """Return the variance factor due to noise that is correlated over n frames: ``1 + 2 sum_k (1 - k/n) r^k``.

    r is the lag-one correlation of first-order autoregressive noise, measured on the residuals of inliers. ``points``
    are the (F, L, 3) landmarks of a solution. Reference: Bayley and Hammersley 1946, "The effective number of
    independent observations in an autocorrelated series".
    """
    xp, count = array_namespace(points), points.shape[0]
    product = power = 0.0
    for start in range(0, count, BLOCK_POSES):
        part = np.arange(start, min(start + BLOCK_POSES + 1, count))
        found = term.select(part).residuals(points[start : start + len(part)])
        error, inlier = found.error, found.inliers(scale)
        pair = xp.astype(inlier[:, 1:] & inlier[:, :-1], error.dtype)
        product += float(xp.sum(xp.sum(error[:, 1:] * error[:, :-1], axis=-1) * pair))
        power += float(xp.sum(0.5 * xp.sum(error[:, 1:] ** 2 + error[:, :-1] ** 2, axis=-1) * pair))
    r = float(np.clip(product / max(power, 1e-12), 0.0, 0.95))
    lag = np.arange(1, num_frames)
    return float(1 + 2 * ((1 - lag / num_frames) * r**lag).sum())
