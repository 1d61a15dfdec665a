"""Normal equations of keys, empty and as one matrix."""

from __future__ import annotations

import numpy as np

from solver_backend.body.state_layout import StateLayout
from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations


def no_equations(layout: StateLayout, keys: int) -> KeyframeNormalEquations:
    """Return the equations of so many keys of which nothing is told."""
    blocks = (keys + 1) // 2
    dof, size = layout.dof, 2 * layout.dof
    upper = np.zeros((blocks - 1, size, dof + layout.turns.start))
    return KeyframeNormalEquations(np.zeros((blocks, size, size)), upper, np.zeros((blocks, size)), layout)


def dense(equations: KeyframeNormalEquations) -> np.ndarray:
    """Return the block-tridiagonal matrix as a whole."""
    blocks, size = equations.g.shape
    full = np.zeros((blocks, size, blocks, size))
    for i in range(blocks):
        full[i, :, i] = equations.diagonal[i]
        if i + 1 < blocks:
            met = equations.upper.shape[-1]
            full[i, :, i + 1, :met] = equations.upper[i]
            full[i + 1, :met, i] = equations.upper[i].T
    return full.reshape(blocks * size, blocks * size)
