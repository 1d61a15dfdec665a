"""Block-tridiagonal normal equations of a chain of keyframes, under construction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solver_backend.fitters.keyframes import KeyframeLayout
from solver_backend.geometry.arrays import Array


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


def assemble(xp: Any, layout: KeyframeLayout, hessian: Array, gradient: Array, by_keys: Array, dof: int) -> Chain:
    """Sum the frames' equations into the chain: window w meets block w and the first key of block w + 1."""
    like = {"dtype": gradient.dtype, "device": getattr(gradient, "device", None)}
    count = layout.num_windows + 1
    chain = Chain(
        xp.zeros((count, 2 * dof, 2 * dof), **like), xp.zeros((count - 1, 2 * dof, 2 * dof), **like),
        xp.zeros((count, 2 * dof), **like), dof,
    )  # fmt: skip
    for w in range(layout.num_windows):
        frames = layout.slice_of(w)
        H, g = window_equations(xp, hessian[frames], gradient[frames], by_keys[frames])
        chain.diagonal[w] += H[: 2 * dof, : 2 * dof]
        chain.upper[w, :, :dof] += H[: 2 * dof, 2 * dof :]
        chain.diagonal[w + 1, :dof, :dof] += H[2 * dof :, 2 * dof :]
        chain.g[w] += g[: 2 * dof]
        chain.g[w + 1, :dof] += g[2 * dof :]
    eye = xp.eye(2 * dof, **like)
    chain.diagonal += 1e-2 * eye
    chain.diagonal[-1, dof:, dof:] += eye[dof:, dof:]
    return chain


def window_equations(xp: Any, hessian: Array, gradient: Array, by_keys: Array) -> tuple[Array, Array]:
    """Return ``sum_f B_fᵀ H_f B_f`` and ``sum_f B_fᵀ g_f`` as one matrix product over all frames of the window."""
    width = by_keys.shape[-1]
    flat = xp.reshape(by_keys, (-1, width))
    weighted = xp.reshape(xp.matmul(hessian, by_keys), (-1, width))
    return xp.matmul(flat.T, weighted), xp.matmul(flat.T, xp.reshape(gradient, (-1,)))
