"""Normal equations of least squares: independent blocks, a chain of blocks, blocks that share unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from array_api_compat import array_namespace

Array = Any
"""A NumPy array or a torch tensor."""


class NormalEquations(Protocol):
    """``(H + damping diag(H)) step = -g`` for one or several independent problems."""

    def solve(self, damping: Array) -> Array:
        """Return the damped step; ``damping`` holds one value a problem."""
        ...

    def merged(self, mask: Array, newer: Any) -> NormalEquations:
        """Return the equations with the masked problems taken from ``newer``."""
        ...


@dataclass(frozen=True)
class DenseBlocks:
    """B independent small problems."""

    H: Array
    """(B, n, n) symmetric positive semi-definite."""
    g: Array
    """(B, n) gradient."""

    def solve(self, damping: Array) -> Array:
        """Return the (B, n) steps of the damped systems; ``damping`` is (B,)."""
        xp = array_namespace(self.H)
        diagonal = xp.linalg.diagonal(self.H)
        eye = xp.eye(self.H.shape[-1], dtype=self.H.dtype, device=getattr(self.H, "device", None))
        damped = self.H + (damping[:, None] * diagonal + 1e-9)[:, :, None] * eye
        return -xp.linalg.solve(damped, self.g[:, :, None])[..., 0]

    def merged(self, mask: Array, newer: DenseBlocks) -> DenseBlocks:
        """Return the equations with the masked problems taken from ``newer``."""
        xp = array_namespace(self.H)
        H = xp.where(mask[:, None, None], newer.H, self.H)
        return DenseBlocks(H, xp.where(mask[:, None], newer.g, self.g))


@dataclass(frozen=True)
class BlockTridiagonal:
    """A chain of N blocks of size n in which only neighbours meet: one solve costs O(N n³).

    ``H = [[D_0, U_0], [U_0ᵀ, D_1, U_1], ...]``; solved by block Cholesky, forwards then backwards
    (Golub and Van Loan 2013, section 4.5).
    """

    diagonal: Array
    """(N, n, n)."""
    upper: Array
    """(N - 1, n, n)."""
    g: Array
    """(N, n) gradient."""

    def solve(self, damping: Array) -> Array:
        """Return the (1, N·n) step of the damped system; ``damping`` is (1,)."""
        xp = array_namespace(self.g)
        inverses, coupled = self.factorise(float(damping[0]))
        halves: list[Array] = []
        for i in range(self.g.shape[0]):
            right = -self.g[i] - (xp.matmul(coupled[i - 1].T, halves[-1]) if i else 0.0)
            halves.append(xp.matmul(inverses[i], right))
        step: list[Array] = [None] * self.g.shape[0]
        for i in range(self.g.shape[0] - 1, -1, -1):
            right = halves[i] - (xp.matmul(coupled[i], step[i + 1]) if i + 1 < len(step) else 0.0)
            step[i] = xp.matmul(inverses[i].T, right)
        return xp.concat(step)[None]

    def merged(self, mask: Array, newer: BlockTridiagonal) -> BlockTridiagonal:
        """Return ``newer`` where the one problem is masked."""
        return newer if bool(mask[0]) else self

    def factorise(self, damping: float = 0.0) -> tuple[list[Array], list[Array]]:
        """Return the block Cholesky factor: inverses of its lower triangles L_i, and couplings ``L_i⁻¹ U_i``."""
        xp = array_namespace(self.g)
        eye = xp.eye(self.g.shape[1], dtype=self.g.dtype, device=getattr(self.g, "device", None))
        inverses: list[Array] = []
        coupled: list[Array] = []
        for i in range(self.g.shape[0]):
            block = self.diagonal[i]
            block = block + (damping * xp.linalg.diagonal(block) + 1e-9)[:, None] * eye
            if i:
                block = block - xp.matmul(coupled[-1].T, coupled[-1])
            # The array standard has no triangular solve; every later product uses the inverse.
            inverses.append(xp.linalg.inv(xp.linalg.cholesky(block)))
            if i + 1 < self.g.shape[0]:
                coupled.append(xp.matmul(inverses[-1], self.upper[i]))
        return inverses, coupled

    def marginals(self) -> tuple[Array, Array]:
        """Return the blocks of ``H⁻¹`` on and above the diagonal, (N, n, n) and (N - 1, n, n), and form no others.

        Backwards from the last block: ``S_{i,i+1} = -L_iᵀ⁻¹ C_i S_{i+1,i+1}`` and
        ``S_ii = L_iᵀ⁻¹ (I + C_i S_{i+1,i+1} C_iᵀ) L_i⁻¹`` with ``C_i = L_i⁻¹ U_i`` (Takahashi, Fagan and Chin 1973).
        """
        xp = array_namespace(self.g)
        eye = xp.eye(self.g.shape[1], dtype=self.g.dtype, device=getattr(self.g, "device", None))
        inverse, coupled = self.factorise()
        diagonal = [xp.matmul(inverse[-1].T, inverse[-1])]
        upper: list[Array] = []
        for i in range(len(inverse) - 2, -1, -1):
            forward = xp.matmul(coupled[i], diagonal[-1])
            upper.append(-xp.matmul(inverse[i].T, forward))
            middle = eye + xp.matmul(forward, coupled[i].T)
            diagonal.append(xp.matmul(inverse[i].T, xp.matmul(middle, inverse[i])))
        off = xp.stack(upper[::-1]) if upper else self.upper
        return xp.stack(diagonal[::-1]), off


@dataclass(frozen=True)
class Arrowhead:
    """B blocks that meet only through m shared unknowns, which are found first (Schur complement)."""

    blocks: Array
    """(B, n, n)."""
    coupling: Array
    """(B, n, m)."""
    shared: Array
    """(m, m)."""
    g_blocks: Array
    """(B, n)."""
    g_shared: Array
    """(m,)."""

    def solve(self, damping: Array) -> Array:
        """Return the (1, m + B·n) step, shared unknowns first; ``damping`` is (1,)."""
        xp = array_namespace(self.shared)
        like = {"dtype": self.shared.dtype, "device": getattr(self.shared, "device", None)}
        n, m = self.coupling.shape[1:]
        relative = damping[0]
        blocks = self.blocks + (relative * xp.linalg.diagonal(self.blocks) + 1e-9)[:, :, None] * xp.eye(n, **like)
        shared = self.shared + (relative * xp.linalg.diagonal(self.shared) + 1e-9)[:, None] * xp.eye(m, **like)
        right = xp.concat([self.coupling, self.g_blocks[:, :, None]], axis=-1)
        eliminated = xp.linalg.solve(blocks, right)
        reduced = xp.sum(xp.matmul(xp.permute_dims(self.coupling, (0, 2, 1)), eliminated), axis=0)
        step_shared = -xp.linalg.solve(shared - reduced[:, :m], (self.g_shared - reduced[:, m])[:, None])[:, 0]
        step_blocks = -eliminated[..., m] - xp.matmul(eliminated[..., :m], step_shared[:, None])[..., 0]
        return xp.concat([step_shared, xp.reshape(step_blocks, (-1,))])[None]

    def merged(self, mask: Array, newer: Arrowhead) -> Arrowhead:
        """Return ``newer`` where the one problem is masked."""
        return newer if bool(mask[0]) else self
