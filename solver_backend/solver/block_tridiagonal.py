"""Solve block-tridiagonal systems by eliminating blocks from both ends at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.geometry.arrays import Array, array_namespace, empty, identity, index, solved
from solver_backend.geometry.parallel import map_blocks

BATCH = 16  # Number of blocks whose inner unknowns are eliminated together. Affects only time and memory.


@dataclass(frozen=True)
class BlockTridiagonal:
    """Normal equations of N blocks of size n, ``H = [[D_0, U_0], [U_0ᵀ, D_1, U_1], ...]``, solved in O(N n³).

    Only the first m unknowns of a block, the outer ones, are coupled with the previous block. The inner unknowns are
    coupled with their own and the next block. They are eliminated first, in parallel. The outer ones are then
    eliminated from both ends towards the middle (Golub and Van Loan 2013, section 4.5. From both ends: Babuška 1972,
    "Numerical stability in problems of linear algebra"). Steps have the precision of the blocks.
    """

    diagonal: Array  # (N, n, n).
    upper: Array  # (N - 1, n, m).
    g: Array  # (N, n) gradient.

    def solve(self, damping: Array) -> Array:
        """Return the (1, N·n) step that solves ``(H + damping diag(H)) step = -g``.

        ``damping`` is (1,) for all blocks, or has one value per block: (1, N), or (1, N - 1) if the last two blocks
        have the same value.
        """
        xp = array_namespace(self.g)
        damping = _by_block(damping if damping.ndim == 1 else damping[0], self.g)
        outer, inner = self._without_inner(damping, self.diagonal.dtype)
        met = outer.diagonal.shape[1]
        g = self.g[:, :met] if inner is None else inner.carried(self.g[:, :met], self.g[:, met:])
        right = xp.astype(-g, self.diagonal.dtype)[..., None]
        sweeps = outer.swept([right[i] for i in range(g.shape[0])])
        step: list[Array] = list(sweeps.solved)
        for i, j in sweeps.outwards[0] + sweeps.outwards[1]:
            step[i] = step[i] - xp.matmul(sweeps.coupled[i], step[j])
        steps = xp.astype(xp.stack(step)[..., 0], g.dtype)
        if inner is not None:
            steps = xp.concat([steps, inner.steps(steps, self.g[:, met:])], axis=1)
        return xp.reshape(steps, (1, -1))

    def promised(self, step: Array) -> Array:
        """Return the predicted decrease (1,) of the cost, ``-½ gᵀ step``."""
        xp = array_namespace(self.g)
        return -0.5 * xp.sum(xp.reshape(self.g, (1, -1)) * step, axis=1)

    def merged(self, mask: Array, newer: BlockTridiagonal) -> BlockTridiagonal:
        """Return ``newer`` if the mask (1,) is true, otherwise these equations."""
        return newer if bool(mask[0]) else self

    def marginals(self) -> tuple[Array, Array]:
        """Return the blocks of the covariance ``H⁻¹`` on and above the diagonal, (N, n, n) and (N - 1, n, m).

        The recursion runs from the middle outwards: ``H⁻¹_ij = -X_i H⁻¹_jj`` and ``H⁻¹_ii = S_i⁻¹ - H⁻¹_ij X_iᵀ``.
        Neighbour j is eliminated after block i, S_i is the Schur complement, and ``X_i = S_i⁻¹ H_ij`` (Takahashi, Fagan
        and Chin 1973). A diagonal load of ``n ε diag(H)`` keeps the rounded matrix positive definite (Higham 2002,
        theorem 10.7), so no variance is negative.
        """
        xp = array_namespace(self.g)
        rounding = self.g.shape[1] * float(xp.finfo(self.diagonal.dtype).eps)
        outer, inner = self._without_inner(xp.ones_like(self.g[:, 0]) * rounding, self.g.dtype)
        count, met = outer.diagonal.shape[:2]
        eye = identity(met, self.g)
        sweeps = outer.swept([eye] * count, carry=False)
        diagonal: list[Array] = list(sweeps.solved)
        upper: list[Array] = [eye] * (count - 1)

        def fill(pairs: list[tuple[int, int]]) -> None:
            for i, j in pairs:
                across = -xp.matmul(sweeps.coupled[i], diagonal[j])
                diagonal[i] = diagonal[i] - xp.matmul(across, sweeps.coupled[i].T)
                upper[min(i, j)] = across if i < j else across.T

        map_blocks(fill, sweeps.outwards, self.g)
        blocks = _stacked(diagonal, self.diagonal)
        off = _stacked(upper, self.diagonal) if upper else xp.astype(outer.upper, self.diagonal.dtype)
        if inner is None:
            return blocks, off
        parts = map_blocks(lambda some: inner.marginals(blocks, off, some), _batches(count), blocks)
        full, beyond = (xp.concat([part[i] for part in parts]) for i in range(2))
        return full, xp.concat([off, beyond], axis=1)

    def _without_inner(self, damping: Array, precision: Any) -> tuple[_Outer, _Inner | None]:
        """Eliminate the inner unknowns. Return the Schur complement of the outer unknowns, ``D - Bᵀ A⁻¹ B``."""
        xp = array_namespace(self.g)
        count, size = self.g.shape
        met = self.upper.shape[-1] if count > 1 else size
        D = _damped(xp.astype(self.diagonal[:, :met, :met], precision), damping)
        outer = _Outer(D, xp.astype(self.upper[:, :met], precision))
        if met == size:
            return outer, None
        A, B, C = self.diagonal[:, met:, met:], self.diagonal[:, met:, :met], self.upper[:, met:]

        def eliminate(some: slice) -> tuple[Array, ...]:
            inverse = xp.linalg.inv(_damped(A[some], damping[some]))
            own, further = xp.matmul(inverse, B[some]), xp.matmul(inverse[: C[some].shape[0]], C[some])
            B_T = xp.matrix_transpose(B[some])
            outer.diagonal[some] -= xp.matmul(B_T, own)
            outer.upper[some] -= xp.matmul(B_T[: C[some].shape[0]], further)
            return inverse, own, further, xp.matmul(xp.matrix_transpose(C[some]), further)

        parts = map_blocks(eliminate, _batches(count), self.g)
        inverse, own, further, beyond = (xp.concat([part[i] for part in parts]) for i in range(4))
        outer.diagonal[1:] -= beyond
        return outer, _Inner(inverse, own, further)


@dataclass(frozen=True)
class _Inner:
    """The k inner unknowns of each block as linear functions of the outer unknowns of this and the next block."""

    inverse: Array  # (N, k, k) ``A⁻¹``.
    own: Array  # (N, k, m) ``A⁻¹ B``.
    further: Array  # (N - 1, k, m) ``A⁻¹ C``.

    def carried(self, g: Array, g_inner: Array) -> Array:
        """Return the (N, m) gradient of the outer unknowns after the inner unknowns are eliminated."""
        xp = array_namespace(g)
        g = g - _times(xp.matrix_transpose(self.own), g_inner)
        g[1:] -= _times(xp.matrix_transpose(self.further), g_inner[:-1])
        return g

    def steps(self, outer: Array, g_inner: Array) -> Array:
        """Return the (N, k) steps of the inner unknowns, given the (N, m) steps of the outer unknowns."""
        steps = -_times(self.inverse, g_inner) - _times(self.own, outer)
        steps[:-1] -= _times(self.further, outer[1:])
        return steps

    def marginals(self, diagonal: Array, upper: Array, some: slice) -> tuple[Array, Array]:
        """Return the covariances of the blocks ``some``, and their inner unknowns' covariances with the next block.

        The second result refers to the outer unknowns of the next block. ``diagonal`` are the covariances of each
        block's outer unknowns, and ``upper`` are their covariances with the outer unknowns of the next block.
        """
        xp = array_namespace(diagonal)
        X, Y, across = self.own[some], self.further[some], upper[some]
        count = Y.shape[0]
        own, after = diagonal[some], diagonal[some.start + 1 : some.start + 1 + count]
        mixed = -xp.matmul(X, own)
        mixed[:count] -= xp.matmul(Y, xp.matrix_transpose(across))
        beyond = -xp.matmul(X[:count], across) - xp.matmul(Y, after)
        inner = self.inverse[some] - xp.matmul(mixed, xp.matrix_transpose(X))
        inner[:count] -= xp.matmul(beyond, xp.matrix_transpose(Y))
        left = xp.concat([own, mixed], axis=1)
        return xp.concat([left, xp.concat([xp.matrix_transpose(mixed), inner], axis=1)], axis=2), beyond


def _batches(count: int) -> list[slice]:
    return [slice(i, min(i + BATCH, count)) for i in range(0, count, BATCH)]


def _times(matrices: Array, vectors: Array) -> Array:
    """Return the (N, a) products of (N, a, b) matrices and (N, b) vectors, in the vectors' precision."""
    xp = array_namespace(vectors)
    return xp.matmul(xp.astype(matrices, vectors.dtype), vectors[..., None])[..., 0]


@dataclass(frozen=True)
class _Outer:
    """Block-tridiagonal system of outer unknowns, whose neighbours are fully coupled."""

    diagonal: Array  # (N, m, m).
    upper: Array  # (N - 1, m, m).

    def swept(self, right: Sequence[Array], *, carry: bool = True) -> _Sweeps:
        """Eliminate the blocks from both ends. With ``carry``, also transform the right-hand sides."""
        xp = array_namespace(self.diagonal)
        count, middle = self.diagonal.shape[0], self.diagonal.shape[0] // 2
        orders = range(middle), range(count - 1, middle, -1)
        halves = map_blocks(lambda order: self._eliminated(order, right, carry=carry), orders, self.diagonal)
        coupled: dict[int, Array] = halves[0][0] | halves[1][0]
        found: dict[int, Array] = halves[0][1] | halves[1][1]
        block, r = self.diagonal[middle], right[middle]
        for i in {middle - 1, middle + 1} & set(coupled):
            H_T = self._towards(i, middle).T
            block = block - xp.matmul(H_T, coupled[i])
            r = r - xp.matmul(H_T, found[i]) if carry else r
        found[middle] = solved(block, r)
        outwards = [(i, i + 1) for i in range(middle - 1, -1, -1)], [(i, i - 1) for i in range(middle + 1, count)]
        return _Sweeps(coupled, [found[i] for i in range(count)], outwards)

    def _eliminated(
        self, order: range, right: Sequence[Array], *, carry: bool
    ) -> tuple[dict[int, Array], dict[int, Array]]:
        """Return ``S_i⁻¹ H_ij`` and ``S_i⁻¹ r_i`` per block i, with Schur complement S. j follows i in ``order``."""
        xp = array_namespace(self.diagonal)
        coupled, found = dict[int, Array](), dict[int, Array]()
        met = self.diagonal.shape[1]
        for i in order:
            block, r, before = self.diagonal[i], right[i], i - order.step
            if before in coupled:
                H_T = self._towards(before, i).T
                block = block - xp.matmul(H_T, coupled[before])
                r = r - xp.matmul(H_T, found[before]) if carry else r
            both = solved(block, xp.concat([self._towards(i, i + order.step), r], axis=1))
            coupled[i], found[i] = both[:, :met], both[:, met:]
        return coupled, found

    def _towards(self, i: int, j: int) -> Array:
        return self.upper[i] if i < j else self.upper[j].T


@dataclass(frozen=True)
class _Sweeps:
    """Blocks after elimination from both ends, ready for back substitution."""

    coupled: dict[int, Array]  # ``S_i⁻¹ H_ij`` with the neighbour j that was eliminated later.
    solved: list[Array]  # ``S_i⁻¹ r_i``.
    outwards: tuple[list[tuple[int, int]], list[tuple[int, int]]]
    """Pairs (i, j) in the order of back substitution, from the middle to each end."""


def _by_block(damping: Array, g: Array) -> Array:
    return damping[index(np.minimum(np.arange(g.shape[0]), damping.shape[0] - 1), damping)]


def _stacked(blocks: list[Array], like: Array) -> Array:
    whole = empty((len(blocks), *blocks[0].shape), like)
    for i, block in enumerate(blocks):
        whole[i] = block
    return whole


def _damped(blocks: Array, damping: Array) -> Array:
    """Return (N, n, n) blocks whose diagonals are increased by the (N,) fractions ``damping``."""
    xp = array_namespace(blocks)
    share, along = xp.astype(damping, blocks.dtype)[:, None], np.arange(blocks.shape[-1])
    damped, along = blocks + 0.0, index(along, blocks)
    damped[:, along, along] += share * damped[:, along, along] + 1e-9
    return damped
