"""Form the normal equations of keyframes from the frames in each window (thesis eq. 6.6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from solver_backend.body.state_layout import CODE, ROOT, TRANSL, StateLayout
from solver_backend.fitters.model.keyframe_curve import KeyframeCurve, key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows, lagrange, rows_of
from solver_backend.fitters.model.subject import (
    CODES,
    FrameObjective,
    Keyframes,
    PosedFrames,
    Subject,
    d_pose_d_key,
    frame_equations,
)
from solver_backend.geometry.arrays import Array, array_namespace, constant, empty, identity, zeros
from solver_backend.geometry.interpolation import sider_weights
from solver_backend.geometry.parallel import block_size, map_blocks
from solver_backend.geometry.rotations import quat_left_tangent
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.terms import geman_mcclure
from solver_backend.solver.block_tridiagonal import BlockTridiagonal

BLOCK_FRAMES = 256  # Frames per block. Their matrices fit in the cache, and blocks run in parallel. Affects only time.
HESSIAN_FRAMES = 4  # Frames per window whose Hessians are computed. These change slowly. Chosen by hand.
FLOOR = 1e-2  # Precision added to every unknown to make matrices regular. Chosen by hand.
FIXED = 1e12  # Precision of fixed keys, far above any measurement. Chosen by hand.
Stencil = Sequence[Array | float]  # Coefficients of neighbouring keys.


@dataclass(frozen=True)
class KeyframeNormalEquations:
    """Block-tridiagonal normal equations for the n N + 1 keyframes of N windows.

    Block w contains the n keyframes starting at n w. The last block is padded with dummy keyframes. Priors that couple
    neighbouring keyframes are only possible for n = 2. The ``add`` methods modify the arrays in place, because the
    arrays are large.
    """

    diagonal: Array  # (N + 1, n D, n D), single precision, because it only affects the steps.
    upper: Array
    """(N, n D, D + m), single precision. Residual rotations of a middle keyframe are coupled only within their window.
    The m unknowns before them are also coupled with the next keyframe."""
    g: Array  # (N + 1, n D).
    layout: StateLayout  # Layout of the tangent of one key, D numbers.

    @property
    def dof(self) -> int:
        """Number D of unknowns of one keyframe."""
        return self.layout.dof

    @property
    def free(self) -> int:
        """Number n of keyframes per block."""
        return self.g.shape[1] // self.dof

    @classmethod
    def empty(
        cls,
        num_windows: int,
        layout: StateLayout,
        like: Array,
        free: int = 2,
        *,
        floor: float = FLOOR,
        precision: Any = None,
    ) -> KeyframeNormalEquations:
        """Create the equations of N windows without any data, in single precision by default."""
        single, dof = array_namespace(like).float32 if precision is None else precision, layout.dof
        still = floor * identity(free * dof, like, single)
        diagonal = zeros((num_windows + 1, free * dof, free * dof), like, single) + still
        diagonal[-1, dof:, dof:] += identity((free - 1) * dof, like, single)
        met = dof + min(layout.turns.start, (free - 1) * dof)
        upper = zeros((num_windows, free * dof, met), like, single)
        return cls(diagonal, upper, zeros((num_windows + 1, free * dof), like), layout)

    def add_windows(self, windows: slice, hessian: Array) -> None:
        """Add the windows' matrices over n + 1 keyframes, without the diagonal block of the last keyframe."""
        inner = self.free * self.dof
        self.diagonal[windows] += hessian[:, :inner, :inner]
        self.upper[windows, :, : self.dof] += hessian[:, :inner, inner:]

    def add_ends(self, hessian: Array, gradient: Array) -> None:
        """Add the diagonal blocks (N, D, D) of the windows' last keyframes, and the gradient of all keyframes."""
        self.diagonal[1:, : self.dof, : self.dof] += hessian
        flat = array_namespace(gradient).reshape(self.g, (-1, self.dof))
        flat[: gradient.shape[0]] += gradient

    def add_own(self, columns: np.ndarray, precision: Array, gradient: Array) -> None:
        """Add diagonal precisions (K, n) for n unknowns of each keyframe, and the gradient."""
        for parity in (0, 1):
            at, own = columns + parity * self.dof, precision[parity::2]
            self.diagonal[: own.shape[0], at, at] += own
            self.g[: own.shape[0], at] += gradient[parity::2]

    def add_each(self, part: slice, hessian: Array, gradient: Array) -> None:
        """Add matrices (K, n, n) for n neighbouring unknowns of each keyframe, and the gradient."""
        for parity in (0, 1):
            at = slice(part.start + parity * self.dof, part.stop + parity * self.dof)
            own = hessian[parity::2]
            self.diagonal[: own.shape[0], at, at] += own
            self.g[: own.shape[0], at] += gradient[parity::2]

    def add_differences(
        self, value: Array, tangents: Array, stencil: Stencil, weight: Array | float, first: int = 0
    ) -> None:
        """Add the penalty ``1/2 sum_k w_k |sum_i c_i x_{k+i}|²`` on differences between keyframes.

        Args:
            value: (K, v) value x at each keyframe.
            tangents: (K, v, d) derivative of x w.r.t. the keyframe's unknowns, starting at ``first``.
            stencil: coefficients c, numbers or (n,) arrays.
            weight: weight w, a number or an (n,) array.
        """
        xp, single = array_namespace(value), self.diagonal.dtype
        rest, weights = differences(value, stencil, weight)
        count, rounded = rest.shape[0], xp.astype(tangents, single)  # matrices only affect the steps
        parts = [(i, _along(c, 3) * rounded[i : count + i]) for i, c in enumerate(stencil)]
        for i, left in parts:
            left_T = xp.permute_dims(left, (0, 2, 1)) * xp.astype(weights, single)[:, None, None]
            gradient = _times(tangents[i : count + i], (stencil[i] * weights)[:, None] * rest)
            for j, right in parts:
                if j >= i:
                    self._scatter(i, j, xp.matmul(left_T, right), first)
            for parity in range(min(2, count)):
                keys = np.arange(i, i + count)[parity::2]
                blocks, column = keys // 2, int(keys[0] % 2) * self.dof + first
                self.g[blocks, column : column + gradient.shape[1]] += gradient[parity::2]

    def _scatter(self, i: int, j: int, blocks: Array, first: int) -> None:
        """Add blocks that couple the keyframes k + i and k + j for all k."""
        xp = array_namespace(blocks)
        size = blocks.shape[-1]
        for parity in (0, 1):
            chosen = blocks[parity::2]
            if chosen.shape[0] == 0:
                continue
            rows = np.arange(len(chosen)) * 2 + parity + i
            columns = np.arange(len(chosen)) * 2 + parity + j
            row, column = int(rows[0] % 2) * self.dof + first, int(columns[0] % 2) * self.dof + first
            if rows[0] // 2 == columns[0] // 2:
                block = rows // 2
                self.diagonal[block, row : row + size, column : column + size] += chosen
                if i != j:
                    chosen_T = xp.permute_dims(chosen, (0, 2, 1))
                    self.diagonal[block, column : column + size, row : row + size] += chosen_T
            else:
                self.upper[rows // 2, row : row + size, column : column + size] += chosen

    def with_fixed(self, fixed: np.ndarray) -> KeyframeNormalEquations:
        """Fix the masked keyframes, so that they have no step and no uncertainty."""
        if not fixed.any():
            return self
        fixed = np.append(fixed, np.zeros(self.free - 1, dtype=bool))  # the dummies
        free = constant(np.repeat(~fixed, self.dof).reshape(self.g.shape), self.diagonal)
        blocks = np.flatnonzero(fixed.reshape(-1, self.free).any(axis=1))
        diagonal, upper = self.diagonal + 0.0, self.upper + 0.0
        for b in blocks.tolist():  # few: the ends of a chunk
            diagonal[b] = diagonal[b] * (free[b, :, None] * free[b, None, :])
            diagonal[b] += FIXED * (1.0 - free[b])[:, None] * identity(free.shape[1], free)
            beside = slice(max(b - 1, 0), b + 1)
            met = free[1:][beside][:, None, : upper.shape[-1]]
            upper[beside] = upper[beside] * (free[:-1][beside][:, :, None] * met)
        return KeyframeNormalEquations(diagonal, upper, self.g * constant(free, self.g), self.layout)

    def block_tridiagonal(self) -> BlockTridiagonal:
        """Return the equations as a system for the block-tridiagonal solver."""
        return BlockTridiagonal(self.diagonal, self.upper, self.g)


@dataclass(frozen=True)
class BundleModel:
    """Objective of a take as a function of its keyframes."""

    subject: Subject
    prior: PosePrior
    objective: BundleObjective
    free: StateLayout  # Unknown blocks of a key. Residual rotations that are not free have no effect.
    screw: bool = False  # Move the root along screws in SE(3) between keys.

    def part(self, keys: slice) -> BundleModel:
        """Return the model for a range of keyframes."""
        return replace(self, objective=self.objective.part(keys))

    def astype(self, precision: Any) -> BundleModel:
        """Convert the model to a floating-point precision. Single precision halves memory traffic."""
        return replace(self, subject=self.subject.astype(precision), objective=self.objective.astype(precision))

    def poses(
        self, keys: Keyframes, layout: KeyframeLayout, frames: np.ndarray | None = None, *, spline: bool = False
    ) -> PosedFrames:
        """Return the poses in the given frames, by default in all frames of the layout.

        If ``spline`` is true, the keyframes are control points of a spline over all windows, as in the result.
        Otherwise, each window has its own curve, as in the solver.
        """
        turned = bool(self.free.turned)
        return key_poses(self.prior, keys, layout, frames, residuals=turned, spline=spline, screw=self.screw)

    def curve(self, keys: Keyframes, rows: WindowRows, *, residuals: bool) -> KeyframeCurve:
        """Return the curves through the keyframes of N windows. They give the pose in each frame."""
        return KeyframeCurve.through(_by_windows(keys, rows), rows.time, residuals=residuals, screw=self.screw)

    def decode_fixed(self, keys: Keyframes, rows: WindowRows) -> list[Array] | None:
        """Decode the poses in all frames of W windows once, if the solve does not change the codes.

        Return the rotations (W·n, J, 3, 3) for n frames per window, in blocks of windows. Return None if the solve
        changes the codes.
        """
        if CODE in self.free:
            return None

        def decode(windows: slice) -> Array:
            some = _by_windows(keys, rows).select(windows)
            codes = sider_weights(some.z[:, None], constant(rows.time[windows], keys.z))
            return self.prior.decode(rows_of(codes.value))

        return map_blocks(decode, _blocks(rows, keys), keys.z)

    def equations(
        self,
        rows: WindowRows,
        keys: Keyframes,
        scale: float,
        hessian_frames: int = HESSIAN_FRAMES,
        decoded: list[Array] | None = None,
    ) -> tuple[Array, Callable[[], KeyframeNormalEquations]]:
        """Return the cost (N,) of each window, and a function that forms the normal equations.

        The costs at a keyframe shared by two windows belong to the later window. See ``data_equations`` for
        ``decoded``.
        """
        data = data_equations(self, keys, rows, scale, hessian_frames, decoded)

        def form() -> KeyframeNormalEquations:
            equations = data.normal_equations()
            for term in self.objective.keys:
                term.add_to(equations, keys)
            return equations

        return self._at_windows(data.cost, keys), form

    def information(self, layout: KeyframeLayout, keys: Keyframes, scale: float) -> KeyframeNormalEquations:
        """Return the normal equations at a solution. The inverse of their matrix is the covariance of the solution."""
        # If codes are fixed, stride the rows before sampling them, so that few frames are posed.
        stride = 1 if CODE in self.free else max(1, int(np.diff(layout.bounds).max()) // HESSIAN_FRAMES)
        rows = layout.rows(stride)
        return self.equations(rows.sampled(rows.columns(HESSIAN_FRAMES)), keys, scale)[1]()

    def _at_windows(self, cost: Array, keys: Keyframes) -> Array:
        for term in self.objective.keys:
            at_keys = term.cost(keys, self.free)
            cost = cost + at_keys[:-1:2] + at_keys[1::2]
            cost[-1] += at_keys[-1]
        return cost


@dataclass(frozen=True)
class DataEquations:
    """Cost and gradient of N windows w.r.t. their keyframes. Matrices are formed on demand."""

    cost: Array  # (N,) cost of each window's frames.
    gradient: Array  # (n N + 1, D) gradient w.r.t. the keys.
    _layout: StateLayout
    _windows: list[slice]
    _matrices: list[Callable[[], Array]]  # For each range of windows: matrices w.r.t. all n + 1 keys of each window.

    def normal_equations(self) -> KeyframeNormalEquations:
        """Form the normal equations of all keyframes on all cores."""
        xp, like = array_namespace(self.gradient), self.gradient
        count, dof = self._windows[-1].stop, like.shape[1]
        free = (like.shape[0] - 1) // count
        equations = KeyframeNormalEquations.empty(count, self._layout, like, free)
        ends = empty((count, dof, dof), like, xp.float32)

        def fill(block: int) -> None:
            windows, hessian = self._windows[block], self._matrices[block]()
            equations.add_windows(windows, hessian)
            ends[windows] = hessian[:, free * dof :, free * dof :]

        map_blocks(fill, range(len(self._windows)), like)
        equations.add_ends(ends, self.gradient)
        return equations


def data_equations(
    data: BundleModel,
    keys: Keyframes,
    rows: WindowRows,
    scale: float,
    hessian_frames: int = HESSIAN_FRAMES,
    decoded: list[Array] | None = None,
) -> DataEquations:
    """Return the cost of all frames and the Gauss-Newton equations of the keyframes.

    ``E = Σ_f E_f(x_f)`` over the frames of all windows (thesis eqs. 6.6, 6.7). ``x_f`` is on the curve through the
    window's keyframes (eqs. 6.9, 6.10), and ``E_f`` is the data term of one frame (eq. 6.8).

    The gradient is exact. If keyframes stay on the prior's manifold, the Gauss-Newton matrix is also exact. With
    residual rotations, it is approximated by ``H_ab = P_aᵀ (Σ_f w_a w_b H_f) P_b``. P_a is the derivative of the pose
    at keyframe a, and w_a is the Lagrange weight of this keyframe in frame f. The error is small, because neighbouring
    keyframes are close to each other and to the solution. The approximation needs the derivative of the pose decoder
    only at the keyframes.

    Args:
        rows: the frames of N windows.
        hessian_frames: number of frames per window whose Hessians are computed.
        decoded: the result of ``BundleModel.decode_fixed`` for these keyframes. If None, the poses are decoded here.
    """
    columns, blocks, free = rows.columns(hessian_frames), _blocks(rows, keys), _free_keys(keys, rows)
    local = data.decode_fixed(keys, rows) if decoded is None else decoded

    def block(number: int) -> tuple[Array, Array, Callable[[], Array]]:
        windows = blocks[number]
        part = keys.select(slice(free * windows.start, free * windows.stop + 1))
        return _block(data, part, rows.select(windows), columns, scale, None if local is None else local[number])

    parts = map_blocks(block, range(len(blocks)), keys.z)
    gradient = zeros((keys.z.shape[0], data.free.dof), keys.z)
    for windows, (_, by_keys, _) in zip(blocks, parts, strict=True):
        gradient[free * windows.start : free * windows.stop + 1] += by_keys
    cost = array_namespace(gradient).concat([part[0] for part in parts])
    return DataEquations(cost, gradient, data.free, blocks, [part[2] for part in parts])


def _blocks(rows: WindowRows, keys: Keyframes) -> list[slice]:
    return rows.blocks(block_size(BLOCK_FRAMES, keys.z))


def _free_keys(keys: Keyframes, rows: WindowRows) -> int:
    return (keys.z.shape[0] - 1) // rows.frames.shape[0]


def _by_windows(keys: Keyframes, rows: WindowRows) -> Keyframes:
    return keys.of_windows(np.arange(rows.frames.shape[0]), _free_keys(keys, rows))


def _block(
    data: BundleModel, keys: Keyframes, rows: WindowRows, columns: np.ndarray, scale: float, decoded: Array | None
) -> tuple[Array, Array, Callable[[], Array]]:
    """Return costs (N,), the gradient (n N + 1, D), and a function that forms the matrices of a window range."""
    xp = array_namespace(keys.z)
    count, width = rows.frames.shape
    turned = bool(data.free.turned)
    poses, vjp = data.curve(keys, rows, residuals=turned).poses_with_vjp(data.prior, decoded)
    chosen = (np.arange(count)[:, None] * width + columns).reshape(-1)
    objective = data.objective.frames.select(rows.frames.reshape(-1))
    equations = frame_equations(data.subject, poses, objective, scale, chosen)
    weight = constant(rows.weight.reshape(-1), keys.z)
    gradient = vjp(equations.gradient * weight[:, None]).by_tangents(keys, data.free)
    cost = xp.sum(xp.reshape(equations.cost * weight, (count, width)), axis=1)

    def form() -> Array:
        some, hessian = rows.sampled(columns), equations.hessian
        if not turned:
            return _exact(data, keys, some, hessian)
        return matrices_by_keys(some, hessian, d_pose_d_key(data.free, data.prior, keys.z, keys.residual))

    return cost, gradient, form


def _exact(data: BundleModel, keys: Keyframes, rows: WindowRows, hessian: Array) -> Array:
    """Return the exact matrices ``Σ_f B_fᵀ H_f B_f`` of N windows, where B_f are derivatives w.r.t. the keyframes."""
    xp = array_namespace(hessian)
    count, width = rows.frames.shape
    curve = data.curve(keys, rows, residuals=False)
    B = xp.astype(curve.jacobian(data.prior, data.free), hessian.dtype)
    weighted = xp.matmul(hessian * xp.reshape(constant(rows.weight, hessian), (-1, 1, 1)), B)
    tall = (count, width * B.shape[1], B.shape[-1])
    return xp.matmul(xp.matrix_transpose(xp.reshape(B, tall)), xp.reshape(weighted, tall))


def matrices_by_keys(rows: WindowRows, hessian: Array, d_pose_d_keys: Array) -> Array:
    """Return the interpolated matrices ``P_aᵀ (Σ_f w_a w_b H_f) P_b`` (N, (n + 1) D, (n + 1) D) of N windows.

    Args:
        rows: the frames of N windows that ``hessian`` covers.
        hessian: (N·m, p, p) Hessians of these frames, m per window.
        d_pose_d_keys: (n N + 1, p, D) derivatives P of the pose tangents w.r.t. the keyframes' tangents.
    """
    xp, size, dof = array_namespace(hessian), hessian.shape[-1], d_pose_d_keys.shape[-1]
    count, width = rows.frames.shape
    free = (d_pose_d_keys.shape[0] - 1) // count
    pairs = list(combinations_with_replacement(range(free + 1), 2))
    weight, shares = constant(rows.weight, hessian), lagrange(constant(rows.time, hessian), free + 1)
    mixes = xp.stack([weight * shares[..., a] * shares[..., b] for a, b in pairs], axis=1)
    mixed = xp.matmul(mixes, xp.reshape(hessian, (count, width, size * size)))
    mixed = xp.reshape(mixed, (count, len(pairs), size, size))
    tangents, found = xp.astype(d_pose_d_keys, hessian.dtype), empty((count, *[(free + 1) * dof] * 2), mixed)
    P = [tangents[key : key + free * (count - 1) + 1 : free] for key in range(free + 1)]
    P_T = [xp.matrix_transpose(part) for part in P]
    for number, (a, b) in enumerate(pairs):
        product = xp.matmul(P_T[a], xp.matmul(mixed[:, number], P[b]))
        above, across = slice(a * dof, (a + 1) * dof), slice(b * dof, (b + 1) * dof)
        found[:, above, across] = product
        if a != b:
            found[:, across, above] = xp.matrix_transpose(product)
    return found


def differences(value: Array, stencil: Stencil, weight: Array | float) -> tuple[Array, Array]:
    """Return differences (n, d) ``sum_i c_i x_{k+i}`` of values (K, d) at keyframes, and their weights (n,)."""
    xp = array_namespace(value)
    count = max(0, value.shape[0] - len(stencil) + 1)
    rest = xp.sum(xp.stack([_along(c, 2) * value[i : count + i] for i, c in enumerate(stencil)]), axis=0)
    weights = constant(weight, value) * xp.ones_like(value[:count, 0])
    return rest, weights


def _along(coefficient: Array | float, ndim: int) -> Array | float:
    return coefficient if isinstance(coefficient, int | float) else coefficient[(slice(None), *[None] * (ndim - 1))]


def _times(tangents: Array, by_value: Array) -> Array:
    xp = array_namespace(tangents)
    return xp.matmul(xp.permute_dims(tangents, (0, 2, 1)), by_value[..., None])[..., 0]


FADING_S = 0.15  # Time constant in seconds with which speeds decay in frames without observations. Chosen by hand.


@dataclass(frozen=True)
class MotionPrior:
    """Gaussian prior on the acceleration of keyframes: ``E = 1/2 sum_k |x_{k-1} - 2 x_k + x_{k+1}|² / s²``.

    s is the standard deviation of acceleration times the squared time between keyframes. A prior on acceleration alone
    preserves speed through a gap, so that people drift. Between unobserved keyframes with spacing h,
    ``1/2 sum_k |x_{k+1} - x_k|² h² / (s tau)²`` penalises speed, which decays as ``exp(-t / tau)``. tau is
    ``FADING_S``.
    """

    spacing_s: float  # Time between keys.
    accel_sigma: float = 6.0  # m/s², for the root's translation.
    angular_sigma: float = 32.0  # rad/s², for the root's rotation.
    latent_sigma: float = 8.0  # 1/s², for each coordinate of the code. Recorded motion shows 8 over 0.08 s.
    unseen: np.ndarray | None = None  # (K - 1,) bool, true between two unobserved keys, or None if there are none.

    @classmethod
    def bounded(cls, spacing_s: float, smoothing: float, unseen: np.ndarray | None) -> MotionPrior:
        """Create the prior for keyframes ``spacing_s`` apart, with standard deviations divided by ``smoothing``."""
        sigmas = (sigma / smoothing for sigma in (cls.accel_sigma, cls.angular_sigma, cls.latent_sigma))
        return cls(spacing_s, *sigmas, unseen=unseen)

    def part(self, keys: slice) -> MotionPrior:
        """Return the prior for a range of keyframes."""
        return self if self.unseen is None else replace(self, unseen=self.unseen[keys.start : keys.stop - 1])

    def cost(self, keys: Keyframes, free: StateLayout) -> Array:
        """Return the cost (K,) of the differences at each keyframe."""
        xp = array_namespace(keys.z)
        cost = zeros((keys.z.shape[0],), keys.z)
        for _, value, _, sigma in self._smooth_parts(keys, free):
            for stencil, weight in self._stencils(sigma):
                rest, weights = differences(value, stencil, weight)
                first = (len(stencil) - 1) // 2
                cost[first : first + rest.shape[0]] += 0.5 * weights * xp.sum(rest * rest, axis=1)
        return cost

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        """Add the prior's normal equations at these keyframes to ``equations`` in place."""
        for name, value, tangents, sigma in self._smooth_parts(keys, equations.layout):
            for stencil, weight in self._stencils(sigma):
                equations.add_differences(value, tangents, stencil, weight, equations.layout[name].start)

    def _stencils(self, sigma: float) -> list[tuple[tuple[int, ...], Array | float]]:
        weight = 1.0 / (sigma * self.spacing_s**2) ** 2
        if self.unseen is None or not self.unseen.any():
            return [((1, -2, 1), weight)]
        return [((1, -2, 1), weight), ((-1, 1), self.unseen * weight * (self.spacing_s / FADING_S) ** 2)]

    def _smooth_parts(self, keys: Keyframes, free: StateLayout) -> list[tuple[str, Array, Array, float]]:
        """Return name, value (K, n), tangents (K, n, d) and deviation of each state block that has a motion prior."""
        xp = array_namespace(keys.z)
        placed = [
            (ROOT, keys.quat, quat_left_tangent(keys.quat), 0.5 * self.angular_sigma),
            (TRANSL, keys.transl, xp.broadcast_to(identity(3, keys.z), (len(keys.z), 3, 3)), self.accel_sigma),
        ]
        return [(CODE, keys.z, CODES.tangent_basis(keys.z), self.latent_sigma), *placed] if CODE in free else placed


REACH = 3.0
"""Standard deviations of a joint's angle beyond which the prior's force barely grows. On nine takes of unusual bodies,
3 reduces point errors by 1.5 %. A toe bent by 70 degrees reaches 44 instead of 25. 2.5 adds jitter."""
STEADINESS = 0.15
"""Precision of the second difference of residual rotations over three keyframes, relative to a frame's precision. 0.15
reduces acceleration errors by 3 % and point errors by 0.7 % compared with a Gaussian. 0.3 removes the jitter, but also
the improvement."""


@dataclass(frozen=True)
class ResidualRotationTerm:
    """Prior for residual rotations, which rotate joints away from the decoded pose.

    rho_ki is residual angle i at keyframe k, and ``r_ki = rho_ki / sigma_i``. The cost is
    ``E = n/2 sum_ki c² s / (s + c²) + m/2 sum_ki b²``. The penalty on ``s = r_ki²`` has heavy tails, because toes move
    rarely but far (Geman and McClure 1987). The second difference ``b = r_{k-1,i} - 2 r_ki + r_{k+1,i}`` is the motion
    prior for rotations that codes cannot express. The fields define n, c and m.
    """

    sigma: np.ndarray  # (J, 3) radians: error of the prior's reconstructions.
    frames_per_key: float = 1.0  # n, the number of frames that a key represents, because these priors are per frame.
    reach: float = REACH  # c.
    steadiness: float = STEADINESS  # m.
    uncovered: tuple[int, ...] = ()  # Pose columns that the prior does not model, which other terms constrain.

    def part(self, keys: slice) -> ResidualRotationTerm:
        """Return this term unchanged, because it is the same for all keyframes."""
        return self

    def cost(self, keys: Keyframes, free: StateLayout) -> Array:
        """Return the cost (K,) at each keyframe, including the second difference centred on it."""
        xp, n = array_namespace(keys.z), self.frames_per_key
        scaled = self._scaled(keys)
        penalty, _ = geman_mcclure(scaled * scaled, self.reach)
        cost, bend = 0.5 * n * xp.sum(penalty, axis=1), _bend(scaled)
        cost[1:-1] += 0.5 * self.steadiness * xp.sum(bend * bend, axis=1)
        return cost

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        """Add the term's normal equations at these keyframes to ``equations`` in place.

        The second difference at a window boundary couples keyframes of two windows, which the matrix cannot contain. It
        is replaced by an upper bound that contains only squares.
        """
        scaled, m = self._scaled(keys), self.steadiness
        _, weight = geman_mcclure(scaled * scaled, self.reach)
        precision, bend = self.frames_per_key * weight, m * _bend(scaled)
        gradient = precision * scaled
        for shift, factor in enumerate((1.0, -2.0, 1.0)):
            gradient[shift : len(bend) + shift] += factor * bend
        precision[:-2:2] += m  # at a window's middle key
        precision[1:-1:2] += 4.0 * m
        precision[2::2] += m
        precision[1:-3:2] += 2.0 * m  # at a joint between windows
        precision[2:-2:2] += 4.0 * m
        precision[3::2] += 2.0 * m
        by_angle = 1.0 / constant(self._covered(self.sigma[None])[0], scaled)
        precision, gradient = precision * by_angle**2, gradient * by_angle
        count, size = precision.shape
        even = np.arange(equations.dof - size, equations.dof)
        odd = even + equations.dof
        equations.add_own(even, precision, gradient)
        unit, windows = m * by_angle**2, (count - 1) // 2
        equations.upper[:windows, even, even] += unit
        for inner in (slice(0, windows), slice(1, windows)):  # at middle keys, then at joints
            equations.diagonal[inner, even, odd] -= 2.0 * unit
            equations.diagonal[inner, odd, even] -= 2.0 * unit
        equations.upper[:windows, odd, even] -= 2.0 * unit
        equations.upper[: windows - 1, odd, even] -= 2.0 * unit

    def _scaled(self, keys: Keyframes) -> Array:
        flat = self._covered(keys.residual)
        return flat / constant(self._covered(self.sigma[None])[0], flat)

    def _covered(self, by_joint: Array) -> Array:
        if self.uncovered:
            kept = [joint for joint in range(by_joint.shape[1]) if joint not in self.uncovered]
            by_joint = by_joint[:, kept]
        return array_namespace(by_joint).reshape(by_joint, (by_joint.shape[0], -1))


def _bend(values: Array) -> Array:
    return values[:-2] - 2.0 * values[1:-1] + values[2:]


OFF_MANIFOLD = 1.25
"""Factor applied to the reconstruction error on held-out subjects, to tolerate poses off the prior's manifold. Chosen
on unusual bodies. 1.5 doubles the improvement on dance but loses 1 % on exercises."""
KeyTerm = MotionPrior | ResidualRotationTerm  # A term on keyframes.


@dataclass(frozen=True)
class BundleObjective:
    """Objective of a take: terms on the poses in F frames, and terms on the keyframes."""

    frames: FrameObjective
    keys: tuple[KeyTerm, ...] = ()

    def part(self, keys: slice) -> BundleObjective:
        """Return the objective for a range of keyframes. The frames of this range are selected later, by number."""
        return replace(self, keys=tuple(term.part(keys) for term in self.keys))

    def astype(self, precision: Any) -> BundleObjective:
        """Convert the objective's measurements to a floating-point precision."""
        return replace(self, frames=self.frames.astype(precision))
