"""Normal equations of a chain of keyframes: what the frames of every window say of its three keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.between import frames_between, key_tangents
from solver_backend.fitters.keyframes import Keyframes, WindowRows, bundle_frames, lagrange
from solver_backend.fitters.subject import FRAME_DOF, Subject, frame_equations
from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.parallel import map_blocks
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.evidence import PointTerm
from solver_backend.solver.normal_equations import BlockTridiagonal

BLOCK_FRAMES = 160
"""Frames worked on at a time: their matrices stay in the cache, and blocks run side by side."""
HELD = 1e12
"""Precision of what is held."""
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass
class Chain:
    """Block-tridiagonal equations under construction; block w holds the keys 2w and 2w + 1 (the last one a dummy)."""

    diagonal: Array
    """(N + 1, 2 D, 2 D)."""
    upper: Array
    """(N, 2 D, 2 D)."""
    g: Array
    """(N + 1, 2 D)."""
    dof: int
    """D, the tangent of one key."""

    @classmethod
    def of(cls, hessian: Array, gradient: Array) -> Chain:
        """Lay out the (N, 3 D, 3 D) matrices of N windows and the (2 N + 1, D) derivative by the keys."""
        xp = array_namespace(hessian)
        like = {"dtype": hessian.dtype, "device": getattr(hessian, "device", None)}
        count, dof = hessian.shape[0], gradient.shape[1]
        diagonal = xp.zeros((count + 1, 2 * dof, 2 * dof), **like)
        upper = xp.zeros((count, 2 * dof, 2 * dof), **like)
        diagonal[:-1] += hessian[:, : 2 * dof, : 2 * dof]
        diagonal[1:, :dof, :dof] += hessian[:, 2 * dof :, 2 * dof :]
        upper[:, :, :dof] += hessian[:, : 2 * dof, 2 * dof :]
        g = xp.concat([gradient, xp.zeros_like(gradient[:1])])
        chain = cls(diagonal, upper, xp.reshape(g, (count + 1, 2 * dof)), dof)
        chain.diagonal += 1e-2 * xp.eye(2 * dof, **like)
        chain.diagonal[-1, dof:, dof:] += xp.eye(dof, **like)
        return chain

    def hold(self, free: np.ndarray) -> None:
        """Take the keys that are not ``free``, (2 N + 1,) bool, out of the equations: no step, no uncertainty."""
        if free.all():
            return
        xp = array_namespace(self.g)
        mask = constant(np.repeat(np.append(free, True), self.dof).reshape(self.g.shape), self.g)
        self.diagonal *= mask[:, :, None] * mask[:, None, :]
        self.diagonal += HELD * (1.0 - mask)[:, :, None] * xp.eye(mask.shape[1], dtype=mask.dtype)
        self.upper *= mask[:-1, :, None] * mask[1:, None, :]
        self.g *= mask

    def equations(self) -> BlockTridiagonal:
        """Return the finished equations."""
        return BlockTridiagonal(self.diagonal, self.upper, self.g)


def data_equations(
    subject: Subject, prior: PosePrior, term: PointTerm, keys: Keyframes, rows: WindowRows, scale: float,
    *, residuals: bool,
) -> tuple[Array, Chain]:  # fmt: skip
    """Return the cost of the frames and its Gauss-Newton equations by the keys, on all cores.

    The gradient is exact. So is the Gauss-Newton matrix where keys stay on the manifold; with residual rotations, when
    keys are close and nearly solved, the pose tangents of a frame are taken as those of its keys mixed by Lagrange's
    weights w: ``H_ab = P_aᵀ (Σ_f w_a w_b H_f) P_b``, and the network's derivative is needed at the keys alone.

    Args:
        subject: the person.
        prior: decoder of the codes.
        term: data of all frames.
        keys: 2 N + 1 keys.
        rows: the frames of N windows.
        scale: of Geman-McClure's penalty.
        residuals: the residual rotations act and are unknowns.
    """
    xp = array_namespace(keys.z)

    def block(windows: slice) -> tuple[Array, Array, Array]:
        part = keys.select(slice(2 * windows.start, 2 * windows.stop + 1))
        return _block(subject, prior, term, part, rows.select(windows), scale, residuals=residuals)

    blocks = rows.blocks(BLOCK_FRAMES)
    parts = map_blocks(block, blocks, keys.z)
    like = {"dtype": keys.z.dtype, "device": getattr(keys.z, "device", None)}
    gradient = xp.zeros((keys.z.shape[0], parts[0][2].shape[1]), **like)
    for windows, (_, _, by_keys) in zip(blocks, parts, strict=True):
        gradient[2 * windows.start : 2 * windows.stop + 1] += by_keys
    cost = sum(part[0] for part in parts)
    return cost, Chain.of(xp.concat([part[1] for part in parts]), gradient)


def _block(
    subject: Subject, prior: PosePrior, term: PointTerm, keys: Keyframes, rows: WindowRows, scale: float,
    *, residuals: bool,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the cost of some windows, their (N, 3 D, 3 D) matrices and the (2 N + 1, D) derivative by their keys."""
    xp = array_namespace(keys.z)
    between = frames_between(prior, keys, rows, residuals=residuals)
    frames = rows.frames.reshape(-1)
    equations = frame_equations(subject, between.poses, term.select(frames), scale)
    weight = constant(rows.weight, keys.z)
    flat = xp.reshape(weight, (-1,))
    gradient = between.pull_back(equations.gradient * flat[:, None])
    matrix = _mixed if residuals else _exact
    return xp.sum(equations.cost * flat), matrix(prior, keys, rows, equations.hessian), gradient


def _exact(prior: PosePrior, keys: Keyframes, rows: WindowRows, hessian: Array) -> Array:
    """Return (N, 108, 108): ``Σ_f B_fᵀ H_f B_f`` with the derivative B_f of every frame by its three keys."""
    xp = array_namespace(hessian)
    count, width = rows.frames.shape
    window = np.repeat(np.arange(count), width)
    by_keys = bundle_frames(prior, keys, window, rows.time.reshape(-1), residuals=False).by_keys
    assert by_keys is not None
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
    return _by_keys(xp, mixed, key_tangents(prior, keys, residuals=True))


def _by_keys(xp: Any, mixed: Array, tangents: Array) -> Array:
    """Return (N, 3 D, 3 D): ``P_aᵀ M_ab P_b`` for the three keys a, b of each window."""
    count, dof = mixed.shape[0], tangents.shape[-1]
    hessian = xp.empty((count, 3 * dof, 3 * dof), dtype=mixed.dtype, device=getattr(mixed, "device", None))
    keys = [tangents[:-2:2], tangents[1:-1:2], tangents[2::2]]
    turned = [xp.matrix_transpose(P) for P in keys]
    for number, (a, b) in enumerate(_PAIRS):
        product = xp.matmul(turned[a], xp.matmul(mixed[:, number], keys[b]))
        rows, columns = slice(a * dof, (a + 1) * dof), slice(b * dof, (b + 1) * dof)
        hessian[:, rows, columns] = product
        if a != b:
            hessian[:, columns, rows] = xp.matrix_transpose(product)
    return hessian
