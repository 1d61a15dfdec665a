"""Normal equations of keyframes: what the frames of every window contribute to its keys (thesis eq. 6.6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from solver_backend.body.state_layout import CODE, StateLayout
from solver_backend.fitters.model.keyframe_curve import KeyframeCurve
from solver_backend.fitters.model.keyframe_layout import WindowRows, lagrange, rows_of
from solver_backend.fitters.model.subject import FrameObjective, Keyframes, Subject, d_pose_d_key, frame_equations
from solver_backend.geometry.arrays import Array, array_namespace, constant, empty, identity, zeros
from solver_backend.geometry.interpolation import sider_weights
from solver_backend.geometry.parallel import block_size, map_blocks
from solver_backend.priors.base import PosePrior
from solver_backend.solver.block_tridiagonal import BlockTridiagonal

BLOCK_FRAMES = 256  # Frames per block: their matrices stay in the cache, and blocks run in parallel. Affects time only.
HESSIAN_FRAMES = 4
"""Frames of a window whose Hessians are formed: they change slowly, and the keys' weights on them are quartics.
Chosen by hand."""
FLOOR = 1e-2  # Precision added everywhere, so that no matrix is singular; chosen by hand.
FIXED = 1e12  # Precision of fixed keys, far above any measurement; chosen by hand.
Stencil = Sequence[Array | float]  # Coefficients of neighbouring keys.


@dataclass(frozen=True)
class KeyframeNormalEquations:
    """Block-tridiagonal equations of n N + 1 keys; block w holds the n keys from n w on (the last ones are dummies).

    Terms over keys need n = 2. ``add`` methods work in place because the arrays are large.
    """

    diagonal: Array  # (N + 1, n D, n D), single precision: it only steers the steps.
    upper: Array
    """(N, n D, D + m), single precision: residual rotations of a middle key couple with their own window only, the m
    unknowns before them also with the next key."""
    g: Array  # (N + 1, n D).
    layout: StateLayout  # Of the tangent of one key, D numbers.

    @property
    def dof(self) -> int:
        """D, the length of a key's tangent."""
        return self.layout.dof

    @property
    def free(self) -> int:
        """n, the keys of a block."""
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
        """Return the equations of N windows without data, in single precision unless another is given."""
        single, dof = array_namespace(like).float32 if precision is None else precision, layout.dof
        still = floor * identity(free * dof, like, single)
        diagonal = zeros((num_windows + 1, free * dof, free * dof), like, single) + still
        diagonal[-1, dof:, dof:] += identity((free - 1) * dof, like, single)
        met = dof + min(layout.turns.start, (free - 1) * dof)
        upper = zeros((num_windows, free * dof, met), like, single)
        return cls(diagonal, upper, zeros((num_windows + 1, free * dof), like), layout)

    def add_windows(self, windows: slice, hessian: Array) -> None:
        """Add matrices by all n + 1 keys of windows, without the part of the last keys alone."""
        inner = self.free * self.dof
        self.diagonal[windows] += hessian[:, :inner, :inner]
        self.upper[windows, :, : self.dof] += hessian[:, :inner, inner:]

    def add_ends(self, hessian: Array, gradient: Array) -> None:
        """Add the part of N windows' last keys alone (N, D, D), and the (n N + 1, D) derivative by the keys."""
        self.diagonal[1:, : self.dof, : self.dof] += hessian
        flat = array_namespace(gradient).reshape(self.g, (-1, self.dof))
        flat[: gradient.shape[0]] += gradient

    def add_own(self, columns: np.ndarray, precision: Array, gradient: Array) -> None:
        """Add (K, n) precisions of n columns of each key's tangent, and derivatives by them."""
        for parity in (0, 1):
            at, own = columns + parity * self.dof, precision[parity::2]
            self.diagonal[: own.shape[0], at, at] += own
            self.g[: own.shape[0], at] += gradient[parity::2]

    def add_each(self, part: slice, hessian: Array, gradient: Array) -> None:
        """Add (K, n, n) matrices of a range of n columns of each key's tangent, and derivatives by them."""
        for parity in (0, 1):
            at = slice(part.start + parity * self.dof, part.stop + parity * self.dof)
            own = hessian[parity::2]
            self.diagonal[: own.shape[0], at, at] += own
            self.g[: own.shape[0], at] += gradient[parity::2]

    def add_differences(
        self, value: Array, tangents: Array, stencil: Stencil, weight: Array | float, first: int = 0
    ) -> None:
        """Add ``1/2 sum_k w_k |sum_i c_i x_{k+i}|²``.

        Args:
            value: (K, v) x of each key.
            tangents: (K, v, d) x by the columns of a key from ``first`` on.
            stencil: coefficients c, numbers or (n,).
            weight: w, a number or (n,).
        """
        xp, single = array_namespace(value), self.diagonal.dtype
        rest, weights = differences(value, stencil, weight)
        count, rounded = rest.shape[0], xp.astype(tangents, single)  # matrices only steer the steps
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
        """Add blocks that couple the keys k + i and k + j, k = 0, 1, ..."""
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
        """Return the equations with keys of a (n N + 1,) mask held fixed: no step and no uncertainty."""
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
        """Return the equations as a linear solver takes them."""
        return BlockTridiagonal(self.diagonal, self.upper, self.g)


@dataclass(frozen=True)
class FrameData:
    """What evaluates the frames, and how keys become frames."""

    subject: Subject  # The person.
    prior: PosePrior  # Decoder of the codes.
    objective: FrameObjective  # Of all frames.
    free: StateLayout
    """Of the unknowns of a key; rotation vectors that are none do not act, codes that are none are decoded once."""
    screw: bool = False  # The root moves on screws of SE(3).

    def curve(self, keys: Keyframes, rows: WindowRows, *, residuals: bool) -> KeyframeCurve:
        """Return the frames of N windows as functions of their keys."""
        return KeyframeCurve.through(_by_windows(keys, rows), rows.time, residuals=residuals, screw=self.screw)

    def decode_fixed(self, keys: Keyframes, rows: WindowRows) -> list[Array] | None:
        """Return (W·n, J, 3, 3) for each block of the rows: what fixed codes decode to; None where they are free."""
        if CODE in self.free:
            return None

        def decode(windows: slice) -> Array:
            some = _by_windows(keys, rows).select(windows)
            codes = sider_weights(some.z[:, None], constant(rows.time[windows], keys.z))
            return self.prior.decode(rows_of(codes.value))

        return map_blocks(decode, _blocks(rows, keys), keys.z)


@dataclass(frozen=True)
class DataEquations:
    """What the frames of N windows contribute to their keys; matrices are formed when asked for."""

    cost: Array  # (N,) of each window's frames.
    gradient: Array  # (n N + 1, D) by the keys.
    _layout: StateLayout
    _windows: list[slice]
    _matrices: list[Callable[[], Array]]  # By all n + 1 keys of each window, of each range of windows.

    def normal_equations(self) -> KeyframeNormalEquations:
        """Return the normal equations of all keys, formed on all cores."""
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
    data: FrameData,
    keys: Keyframes,
    rows: WindowRows,
    scale: float,
    hessian_frames: int = HESSIAN_FRAMES,
    decoded: list[Array] | None = None,
) -> DataEquations:
    """Return the cost of the frames and its Gauss-Newton equations by the keys, on all cores.

    ``E = Σ_f E_f(x_f)`` over the frames of all windows (thesis eqs. 6.6, 6.7), ``x_f`` on the curve through the
    window's keys (eqs. 6.9, 6.10) and ``E_f`` the data term of one frame (eq. 6.8).

    The gradient is exact. So is the Gauss-Newton matrix where keys stay on the manifold; with residual rotations, when
    keys are close and nearly solved, the pose tangents of a frame are taken as those of its keys mixed by Lagrange's
    weights w: ``H_ab = P_aᵀ (Σ_f w_a w_b H_f) P_b``, and the network's derivative is needed at the keys alone.

    Args:
        data: what evaluates the frames.
        rows: the frames of N windows.
        hessian_frames: frames of a window whose Hessians are formed.
        decoded: see ``FrameData.decode_fixed``; None decodes here.
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
    """Return n of n N + 1 keys."""
    return (keys.z.shape[0] - 1) // rows.frames.shape[0]


def _by_windows(keys: Keyframes, rows: WindowRows) -> Keyframes:
    """Return (N, n + 1) keys."""
    return keys.of_windows(np.arange(rows.frames.shape[0]), _free_keys(keys, rows))


def _block(
    data: FrameData, keys: Keyframes, rows: WindowRows, columns: np.ndarray, scale: float, decoded: Array | None
) -> tuple[Array, Array, Callable[[], Array]]:
    """Return the (N,) costs of windows, their (n N + 1, D) derivative by the keys, and what forms the matrices."""
    xp = array_namespace(keys.z)
    count, width = rows.frames.shape
    turned = bool(data.free.turned)
    poses, vjp = data.curve(keys, rows, residuals=turned).poses_with_vjp(data.prior, decoded)
    chosen = (np.arange(count)[:, None] * width + columns).reshape(-1)
    equations = frame_equations(data.subject, poses, data.objective.select(rows.frames.reshape(-1)), scale, chosen)
    weight = constant(rows.weight.reshape(-1), keys.z)
    gradient = vjp(equations.gradient * weight[:, None]).by_tangents(keys, data.free)
    form = _mixed if turned else _exact
    return (
        xp.sum(xp.reshape(equations.cost * weight, (count, width)), axis=1),
        gradient,
        lambda: form(data, keys, rows.sampled(columns), equations.hessian),
    )


def _exact(data: FrameData, keys: Keyframes, rows: WindowRows, hessian: Array) -> Array:
    """Return (N, ·, ·): ``Σ_f B_fᵀ H_f B_f`` with the derivative B_f of every frame by its window's n + 1 keys."""
    xp = array_namespace(hessian)
    count, width = rows.frames.shape
    curve = data.curve(keys, rows, residuals=False)
    B = xp.astype(curve.jacobian(data.prior, data.free), hessian.dtype)
    weighted = xp.matmul(hessian * xp.reshape(constant(rows.weight, hessian), (-1, 1, 1)), B)
    tall = (count, width * B.shape[1], B.shape[-1])
    return xp.matmul(xp.matrix_transpose(xp.reshape(B, tall)), xp.reshape(weighted, tall))


def _mixed(data: FrameData, keys: Keyframes, rows: WindowRows, hessian: Array) -> Array:
    """Return (N, ·, ·), the pose tangents of frames as those of their keys mixed."""
    by_keys = d_pose_d_key(data.free, data.prior, keys.z, keys.residual)
    return matrices_by_keys(rows, hessian, by_keys)


def matrices_by_keys(rows: WindowRows, hessian: Array, d_pose_d_keys: Array) -> Array:
    """Return (N, (n + 1) D, (n + 1) D): ``P_aᵀ (Σ_f w_a w_b H_f) P_b`` with the tangents P of each window's keys.

    Args:
        rows: the frames of N windows whose Hessians are formed.
        hessian: (N·m, p, p) of these frames, m a window.
        d_pose_d_keys: (n N + 1, p, D) P, the pose tangents by the tangents of the keys.
    """
    xp, dof = array_namespace(hessian), hessian.shape[-1]
    count, width = rows.frames.shape
    num_keys = (d_pose_d_keys.shape[0] - 1) // count + 1
    pairs = list(combinations_with_replacement(range(num_keys), 2))
    weight, shares = constant(rows.weight, hessian), lagrange(constant(rows.time, hessian), num_keys)
    mixes = xp.stack([weight * shares[..., a] * shares[..., b] for a, b in pairs], axis=1)
    mixed = xp.matmul(mixes, xp.reshape(hessian, (count, width, dof * dof)))
    mixed = xp.reshape(mixed, (count, len(pairs), dof, dof))
    return _by_keys(xp, mixed, xp.astype(d_pose_d_keys, hessian.dtype), pairs)


def _by_keys(xp: Any, mixed: Array, d_pose_d_keys: Array, pairs: list[tuple[int, int]]) -> Array:
    """Return (N, (n + 1) D, (n + 1) D): ``P_aᵀ M_ab P_b`` for pairs of keys a, b of each window."""
    count, dof, num_keys = mixed.shape[0], d_pose_d_keys.shape[-1], pairs[-1][0] + 1
    hessian, free = empty((count, num_keys * dof, num_keys * dof), mixed), num_keys - 1
    P = [d_pose_d_keys[key : key + free * (count - 1) + 1 : free] for key in range(num_keys)]
    P_T = [xp.matrix_transpose(part) for part in P]
    for number, (a, b) in enumerate(pairs):
        product = xp.matmul(P_T[a], xp.matmul(mixed[:, number], P[b]))
        rows, columns = slice(a * dof, (a + 1) * dof), slice(b * dof, (b + 1) * dof)
        hessian[:, rows, columns] = product
        if a != b:
            hessian[:, columns, rows] = xp.matrix_transpose(product)
    return hessian


def differences(value: Array, stencil: Stencil, weight: Array | float) -> tuple[Array, Array]:
    """Return ``sum_i c_i x_{k+i}`` (n, d) of (K, d) values with the coefficients c of a stencil, and weights (n,)."""
    xp = array_namespace(value)
    count = max(0, value.shape[0] - len(stencil) + 1)
    rest = xp.sum(xp.stack([_along(c, 2) * value[i : count + i] for i, c in enumerate(stencil)]), axis=0)
    weights = constant(weight, value) * xp.ones_like(value[:count, 0])
    return rest, weights


def _along(coefficient: Array | float, ndim: int) -> Array | float:
    return coefficient if isinstance(coefficient, int | float) else coefficient[(slice(None), *[None] * (ndim - 1))]


def _times(tangents: Array, by_value: Array) -> Array:
    """Return (n, d): derivatives by the tangents (n, v, d) of values from those by the values (n, v)."""
    xp = array_namespace(tangents)
    return xp.matmul(xp.permute_dims(tangents, (0, 2, 1)), by_value[..., None])[..., 0]
