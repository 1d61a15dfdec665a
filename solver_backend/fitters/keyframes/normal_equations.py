"""Normal equations of a chain of keyframes: what the frames of every window say of its three keys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.model.keyframe_curve import (
    KEY_DOF,
    RESIDUAL_DOF,
    Keyframes,
    WindowRows,
    bundle_frames,
    lagrange,
)
from solver_backend.fitters.model.keyframe_gradient import frames_between, key_tangents
from solver_backend.fitters.model.subject import FRAME_DOF, Subject, frame_equations
from solver_backend.fitters.objective import FrameObjective
from solver_backend.geometry.arrays import Array, constant, empty, identity, zeros
from solver_backend.geometry.parallel import block_size, map_blocks
from solver_backend.priors.base import PosePrior
from solver_backend.solver.block_tridiagonal import BlockTridiagonal

BLOCK_FRAMES = 256
"""Frames worked on at a time: their matrices stay in the cache, and blocks run side by side."""
MATRICES = 4
"""Frames of a window whose matrices are formed: they change slowly, and the keys' weights on them are quartics."""
FLOOR = 1e-2
"""Precision that everything has."""
HELD = 1e12
"""Precision of what is held."""
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass
class Chain:
    """Block-tridiagonal equations under construction; block w holds the keys 2w and 2w + 1 (the last one a dummy)."""

    diagonal: Array
    """(N + 1, 2 D, 2 D), single precision: it only steers the steps."""
    upper: Array
    """(N, 2 D, D + 36), single precision: residual rotations of a middle key meet those of its own window alone."""
    g: Array
    """(N + 1, 2 D)."""
    dof: int
    """D, the tangent of one key."""

    @classmethod
    def empty(cls, num_windows: int, dof: int, like: Array) -> Chain:
        """Return the chain of N windows without any data; a floor keeps unseen parts still."""
        single = array_namespace(like).float32
        floor = FLOOR * identity(2 * dof, like, single)
        diagonal = zeros((num_windows + 1, 2 * dof, 2 * dof), like, single) + floor
        diagonal[-1, dof:, dof:] += identity(dof, like, single)
        upper = zeros((num_windows, 2 * dof, dof + KEY_DOF), like, single)
        return cls(diagonal, upper, zeros((num_windows + 1, 2 * dof), like), dof)

    def add_windows(self, windows: slice, hessian: Array) -> None:
        """Add the (n, 3 D, 3 D) matrices of a range of windows, but for what they say of their last keys alone."""
        inner = 2 * self.dof
        self.diagonal[windows] += hessian[:, :inner, :inner]
        self.upper[windows, :, : self.dof] += hessian[:, :inner, inner:]

    def add_ends(self, hessian: Array, gradient: Array) -> None:
        """Add what N windows say of their last keys alone (N, D, D), and the (2 N + 1, D) derivative by the keys."""
        self.diagonal[1:, : self.dof, : self.dof] += hessian
        flat = array_namespace(gradient).reshape(self.g, (-1, self.dof))
        flat[: gradient.shape[0]] += gradient

    def held(self, free: np.ndarray) -> Chain:
        """Take the keys that are not ``free``, (2 N + 1,) bool, out of the equations: no step, no uncertainty."""
        if free.all():
            return self
        xp = array_namespace(self.g)
        mask = constant(np.repeat(np.append(free, True), self.dof).reshape(self.g.shape), self.diagonal)
        self.diagonal *= mask[:, :, None] * mask[:, None, :]
        self.diagonal += HELD * (1.0 - mask)[:, :, None] * xp.eye(mask.shape[1], dtype=mask.dtype)
        self.upper *= mask[:-1, :, None] * mask[1:, None, : self.upper.shape[-1]]
        self.g *= constant(mask, self.g)
        return self

    def equations(self) -> BlockTridiagonal:
        """Return the finished equations."""
        return BlockTridiagonal(self.diagonal, self.upper, self.g)


@dataclass(frozen=True)
class DataEquations:
    """What the frames of N windows say of their keys; matrices are formed when asked for."""

    cost: Array
    """()."""
    gradient: Array
    """(2 N + 1, D) by the keys."""
    _windows: list[slice]
    _matrices: list[Callable[[], Array]]
    """(n, 3 D, 3 D) of each range of windows."""

    def chain(self) -> Chain:
        """Return the equations as a chain, on all cores."""
        xp, like = array_namespace(self.gradient), self.gradient
        count, dof = (like.shape[0] - 1) // 2, like.shape[1]
        chain, ends = Chain.empty(count, dof, like), empty((count, dof, dof), like, xp.float32)

        def fill(block: int) -> None:
            windows, hessian = self._windows[block], self._matrices[block]()
            chain.add_windows(windows, hessian)
            ends[windows] = hessian[:, 2 * dof :, 2 * dof :]

        map_blocks(fill, range(len(self._windows)), like)
        chain.add_ends(ends, self.gradient)
        return chain


def data_equations(
    subject: Subject, prior: PosePrior, objective: FrameObjective, keys: Keyframes, rows: WindowRows, scale: float,
    matrices: int = MATRICES, *, residuals: bool,
) -> DataEquations:  # fmt: skip
    """Return the cost of the frames and its Gauss-Newton equations by the keys, on all cores.

    The gradient is exact. So is the Gauss-Newton matrix where keys stay on the manifold; with residual rotations, when
    keys are close and nearly solved, the pose tangents of a frame are taken as those of its keys mixed by Lagrange's
    weights w: ``H_ab = P_aᵀ (Σ_f w_a w_b H_f) P_b``, and the network's derivative is needed at the keys alone.

    Args:
        subject: the person.
        prior: decoder of the codes.
        objective: of all frames.
        keys: 2 N + 1 keys.
        rows: the frames of N windows.
        scale: of Geman-McClure's penalty.
        matrices: frames of a window whose matrices are formed.
        residuals: the residual rotations act and are unknowns.
    """
    dof = KEY_DOF + (RESIDUAL_DOF if residuals else 0)
    columns = rows.columns(matrices)

    def block(windows: slice) -> tuple[Array, Array, Callable[[], Array]]:
        part = keys.select(slice(2 * windows.start, 2 * windows.stop + 1))
        return _block(subject, prior, objective, part, rows.select(windows), columns, scale, residuals=residuals)

    blocks = rows.blocks(block_size(BLOCK_FRAMES, keys.z))
    parts = map_blocks(block, blocks, keys.z)
    gradient = zeros((keys.z.shape[0], dof), keys.z)
    for windows, (_, by_keys, _) in zip(blocks, parts, strict=True):
        gradient[2 * windows.start : 2 * windows.stop + 1] += by_keys
    return DataEquations(sum(part[0] for part in parts), gradient, blocks, [part[2] for part in parts])


def _block(
    subject: Subject, prior: PosePrior, objective: FrameObjective, keys: Keyframes, rows: WindowRows,
    columns: np.ndarray, scale: float, *, residuals: bool,
) -> tuple[Array, Array, Callable[[], Array]]:  # fmt: skip
    """Return the cost of some windows, its (2 N + 1, D) derivative by their keys, and what forms their matrices."""
    xp = array_namespace(keys.z)
    between = frames_between(prior, keys, rows, residuals=residuals)
    count, width = rows.frames.shape
    steering = (np.arange(count)[:, None] * width + columns).reshape(-1)
    equations = frame_equations(subject, between.poses, objective.select(rows.frames.reshape(-1)), scale, steering)
    weight = constant(rows.weight.reshape(-1), keys.z)
    gradient = between.pull_back(equations.gradient * weight[:, None])
    form = _mixed if residuals else _exact
    return (
        xp.sum(equations.cost * weight),
        gradient,
        lambda: form(prior, keys, rows.sampled(columns), equations.hessian),
    )


def _exact(prior: PosePrior, keys: Keyframes, rows: WindowRows, hessian: Array) -> Array:
    """Return (N, 108, 108): ``Σ_f B_fᵀ H_f B_f`` with the derivative B_f of every frame by its three keys."""
    xp = array_namespace(hessian)
    count, width = rows.frames.shape
    window = np.repeat(np.arange(count), width)
    between = bundle_frames(prior, keys, window, rows.time.reshape(-1), residuals=False)
    by_keys = xp.astype(between.by_keys, hessian.dtype)
    weighted = xp.matmul(hessian * xp.reshape(constant(rows.weight, hessian), (-1, 1, 1)), by_keys)
    tall = (count, width * FRAME_DOF, by_keys.shape[-1])
    return xp.matmul(xp.matrix_transpose(xp.reshape(by_keys, tall)), xp.reshape(weighted, tall))


def _mixed(prior: PosePrior, keys: Keyframes, rows: WindowRows, hessian: Array) -> Array:
    """Return (N, 297, 297): ``P_aᵀ (Σ_f w_a w_b H_f) P_b`` with the tangents P of each window's keys."""
    xp = array_namespace(hessian)
    count, width = rows.frames.shape
    weight, shares = constant(rows.weight, hessian), lagrange(constant(rows.time, hessian))
    mixes = xp.stack([weight * shares[a] * shares[b] for a, b in _PAIRS], axis=1)
    mixed = xp.matmul(mixes, xp.reshape(hessian, (count, width, FRAME_DOF * FRAME_DOF)))
    mixed = xp.reshape(mixed, (count, len(_PAIRS), FRAME_DOF, FRAME_DOF))
    return _by_keys(xp, mixed, xp.astype(key_tangents(prior, keys, residuals=True), hessian.dtype))


def _by_keys(xp: Any, mixed: Array, tangents: Array) -> Array:
    """Return (N, 3 D, 3 D): ``P_aᵀ M_ab P_b`` for the three keys a, b of each window."""
    count, dof = mixed.shape[0], tangents.shape[-1]
    hessian = empty((count, 3 * dof, 3 * dof), mixed)
    keys = [tangents[:-2:2], tangents[1:-1:2], tangents[2::2]]
    turned = [xp.matrix_transpose(P) for P in keys]
    for number, (a, b) in enumerate(_PAIRS):
        product = xp.matmul(turned[a], xp.matmul(mixed[:, number], keys[b]))
        rows, columns = slice(a * dof, (a + 1) * dof), slice(b * dof, (b + 1) * dof)
        hessian[:, rows, columns] = product
        if a != b:
            hessian[:, columns, rows] = xp.matrix_transpose(product)
    return hessian
