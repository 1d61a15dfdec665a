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

    ``H = [[D_0, U_0], [U_0ᵀ, D_1, U_1], ...]``; solved by block elimination, forwards then backwards, in the gradient's
    precision (Golub and Van Loan 2013, section 4.5).
    """

    diagonal: Array
    """(N, n, n)."""
    upper: Array
    """(N - 1, n, m): only the first m unknowns of a block may meet the block before."""
    g: Array
    """(N, n) gradient."""

    def solve(self, damping: Array) -> Array:
        """Return the (1, N·n) step of the damped system; ``damping`` is (1,)."""
        xp = array_namespace(self.g)
        right = [-self.g[i][:, None] for i in range(self.g.shape[0])]
        coupled, step = self._eliminated(right, float(damping[0]))
        met = self.upper.shape[-1]
        for i in range(len(coupled) - 1, -1, -1):
            step[i] = step[i] - xp.matmul(coupled[i], step[i + 1][:met])
        return xp.concat(step)[:, 0][None]

    def merged(self, mask: Array, newer: BlockTridiagonal) -> BlockTridiagonal:
        """Return ``newer`` where the one problem is masked."""
        return newer if bool(mask[0]) else self

    def _eliminated(
        self, right: list[Array], damping: float, *, together: bool = True
    ) -> tuple[list[Array], list[Array]]:
        """Return ``S_i⁻¹ U_i`` and ``S_i⁻¹ r_i`` with the Schur complements ``S_i = D_i - U_{i-1}ᵀ S_{i-1}⁻¹ U_{i-1}``.

        Args:
            right: N right-hand sides (n, k).
            damping: share of the diagonal that is added to it.
            together: carry the right-hand sides from block to block.
        """
        xp = array_namespace(self.g)
        eye = xp.eye(self.g.shape[1], dtype=self.g.dtype, device=getattr(self.g, "device", None))
        met = self.upper.shape[-1]
        coupled: list[Array] = []
        solved: list[Array] = []
        for i in range(self.g.shape[0]):
            block, r = xp.astype(self.diagonal[i], self.g.dtype), right[i]
            block = block + (damping * xp.linalg.diagonal(block) + 1e-9)[:, None] * eye
            if i:
                turned = xp.astype(self.upper[i - 1], self.g.dtype).T
                block[:met, :met] -= xp.matmul(turned, coupled[-1])
                if together:
                    r = xp.concat([r[:met] - xp.matmul(turned, solved[-1]), r[met:]])
            if i + 1 < self.g.shape[0]:
                both = xp.linalg.solve(block, xp.concat([xp.astype(self.upper[i], self.g.dtype), r], axis=1))
                coupled.append(both[:, :met])
                solved.append(both[:, met:])
            else:
                solved.append(xp.linalg.solve(block, r))
        return coupled, solved

    def marginals(self) -> tuple[Array, Array]:
        """Return the blocks of ``H⁻¹`` on and above the diagonal, (N, n, n) and (N - 1, n, n), and form no others.

        Backwards from the last block: ``H⁻¹_{i,i+1} = -X_i H⁻¹_{i+1,i+1}`` and
        ``H⁻¹_ii = S_i⁻¹ - H⁻¹_{i,i+1} X_iᵀ`` with ``X_i = S_i⁻¹ U_i`` (Takahashi, Fagan and Chin 1973).
        """
        xp = array_namespace(self.g)
        count, size = self.g.shape
        eye = xp.eye(size, dtype=self.g.dtype, device=getattr(self.g, "device", None))
        coupled, inverse = self._eliminated([eye] * count, 0.0, together=False)
        met = self.upper.shape[-1]
        diagonal = [inverse[-1]]
        upper: list[Array] = []
        for i in range(count - 2, -1, -1):
            upper.append(-xp.matmul(coupled[i], diagonal[-1][:met]))
            diagonal.append(inverse[i] - xp.matmul(upper[-1][:, :met], coupled[i].T))
        off = xp.stack(upper[::-1]) if upper else xp.zeros_like(self.diagonal[:0])
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
