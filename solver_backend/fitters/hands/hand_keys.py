"""Keys of a hand over a take, and the block-tridiagonal equations of what is known of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.hand_angles import NUM_ANGLES
from solver_backend.fitters.model.interpolant import lagrange
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows
from solver_backend.solver.block_tridiagonal import BlockTridiagonal
from solver_backend.types.shapes import Bool, Float

TURN, SHIFT, FINGERS = slice(0, 3), slice(3, 6), slice(6, 6 + NUM_ANGLES)
"""Of a key: rotation vector by which the wrist leaves where the body has it (world), metres by which it leaves its
place, and the angles of the fingers."""
DOF = FINGERS.stop
"""Numbers of a key."""
FLOOR = 1e-3
"""Precision that everything has."""
HELD = 1e12
"""Precision of what stays: its deviation of 1e-6 rad or m is none."""
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Pairs of the three keyframes that a frame depends on."""


@dataclass(frozen=True)
class KeyEquations:
    """``½ Σ xᵀ H x + gᵀ x`` of K keys, in which a key meets the two after it."""

    band: Float[np.ndarray, "keys 3 d d"]
    """(K, 3, D, D) of each key with itself and the next two."""
    g: Float[np.ndarray, "keys d"]
    """(K, D) gradient."""

    @classmethod
    def empty(cls, num_keys: int) -> KeyEquations:
        """Return equations without data; a floor keeps unseen parts still."""
        band = np.zeros((num_keys, 3, DOF, DOF))
        band[:, 0] = FLOOR * np.eye(DOF)
        return cls(band, np.zeros((num_keys, DOF)))

    def add_frames(self, rows: WindowRows, gradient: np.ndarray, hessian: np.ndarray) -> None:
        """Add what the frames of N windows contribute to their keys, in place.

        Args:
            rows: N rows of n frames.
            gradient: (N n, D) by the states of the frames.
            hessian: (N n, D, D).
        """
        count, width = rows.frames.shape
        shares, weight = lagrange(rows.time), rows.weight
        by_keys = np.swapaxes(shares * weight[..., None], 1, 2) @ gradient.reshape(count, width, DOF)
        mixes = np.stack([weight * shares[..., a] * shares[..., b] for a, b in _PAIRS], axis=1)
        mixed = (mixes @ hessian.reshape(count, width, -1)).reshape(count, len(_PAIRS), DOF, DOF)
        for a in range(3):
            self.g[a : a + 2 * count - 1 : 2] += by_keys[:, a]
        for pair, (a, b) in enumerate(_PAIRS):
            self.band[a : a + 2 * count - 1 : 2, b - a] += mixed[:, pair]

    def add_keys(self, gradient: np.ndarray, hessian: np.ndarray, part: slice) -> None:
        """Add what is known of a part of each key alone: (K, d) gradients and (K, d, d) matrices, in place."""
        self.g[:, part] += gradient
        self.band[:, 0, part, part] += hessian

    def add_acceleration(self, keys: np.ndarray, seconds: np.ndarray, precision: np.ndarray) -> float:
        """Add ``½ Σ_k |a_k|²`` with precisions (D,) of the accelerations a_k, in place; return the cost.

        ``a_k = 2 (x_{k-1} / (h (h + h')) - x_k / (h h') + x_{k+1} / (h' (h + h')))`` of keys that are h and h' apart.

        Args:
            keys: (K, D).
            seconds: (K,) when they are.
            precision: (D,).
        """
        before, after = np.diff(seconds)[:-1, None], np.diff(seconds)[1:, None]
        both = before + after
        stencil = 2.0 / (before * both), -2.0 / (before * after), 2.0 / (after * both)
        count = len(keys) - 2
        bent = sum(share * keys[i : i + count] for i, share in enumerate(stencil))
        pulled = precision * bent
        diagonal = np.diag(precision)
        for i, a in enumerate(stencil):
            self.g[i : i + count] += a * pulled
            for j in range(i, 3):
                self.band[i : i + count, j - i] += (a * stencil[j])[..., None] * diagonal
        return 0.5 * float((pulled * bent).sum())

    def hold(self, still: Bool[np.ndarray, " keys"]) -> None:
        """Keep some keys where they are, in place: they meet no other and do not move."""
        self.g[still] = 0.0
        for apart in (1, 2):
            self.band[np.flatnonzero(still[:-apart] | still[apart:]), apart] = 0.0
        self.band[still, 0] = HELD * np.eye(DOF)

    def block_tridiagonal(self) -> BlockTridiagonal:
        """Return the equations in blocks of two keys, the last with a dummy."""
        count = (len(self.g) + 1) // 2
        diagonal = np.zeros((count, 2, DOF, 2, DOF))
        upper = np.zeros((count - 1, 2, DOF, 2, DOF))
        even, odd = self.band[::2], self.band[1::2]
        diagonal[:, 0, :, 0] = even[:, 0]
        diagonal[:-1, 1, :, 1] = odd[:, 0]
        diagonal[-1, 1, :, 1] = np.eye(DOF)
        diagonal[:-1, 0, :, 1] = even[:-1, 1]
        diagonal[:-1, 1, :, 0] = np.swapaxes(even[:-1, 1], 1, 2)
        upper[:, 0, :, 0] = even[:-1, 2]
        upper[:, 1, :, 0] = odd[:, 1]
        upper[:-1, 1, :, 1] = odd[:-1, 2]
        g = np.concatenate([self.g, np.zeros((1, DOF))]).reshape(count, -1)
        size = 2 * DOF
        return BlockTridiagonal(diagonal.reshape(count, size, size), upper.reshape(count - 1, size, size), g)


def states_at(keys: Float[np.ndarray, "keys d"], rows: WindowRows) -> Float[np.ndarray, "n d"]:
    """Return (N n, D) states of the frames of N windows, on the parabolas through their three keys."""
    triples = np.stack([keys[i : len(keys) - 2 + i : 2] for i in range(3)], axis=1)
    return (lagrange(rows.time) @ triples).reshape(-1, keys.shape[1])


def covariance_at(system: BlockTridiagonal, layout: KeyframeLayout) -> tuple[np.ndarray, WindowRows]:
    """Return (N n, D, D) covariances of the frames of N windows, and these frames.

    ``Σ_ab w_a w_b S_ab`` over the three keys of each window, from the inverse's blocks (see ``marginals``).
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
