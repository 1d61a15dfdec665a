"""Normal equations of least squares: independent blocks, and blocks that share unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from solver_backend.geometry.arrays import Array, array_namespace, identity, solved


class NormalEquations(Protocol):
    """``(H + damping diag(H)) step = -g`` for one or several independent problems."""

    def solve(self, damping: Array) -> Array:
        """Return the damped step; ``damping`` holds one value a problem."""
        ...

    def promised(self, step: Array) -> Array:
        """Return by how much (B,) steps lower the costs, ``-½ gᵀ step``, where damping is small."""
        ...

    def merged(self, mask: Array, newer: Any) -> NormalEquations:
        """Return the equations with the masked problems taken from ``newer``."""
        ...


class LazyNormalEquations:
    """Equations that are formed when a step is asked for: a state that is left again, and the last one, need none."""

    def __init__(self, form: Callable[[], NormalEquations]) -> None:
        self._form: Callable[[], NormalEquations] | None = form
        self._equations: NormalEquations | None = None

    @property
    def formed(self) -> NormalEquations:
        """The equations; what they are formed from is let go of."""
        if self._equations is None:
            assert self._form is not None
            self._equations, self._form = self._form(), None
        return self._equations

    def solve(self, damping: Array) -> Array:
        """Return the damped steps."""
        return self.formed.solve(damping)

    def promised(self, step: Array) -> Array:
        """Return by how much steps lower the costs."""
        return self.formed.promised(step)

    def merged(self, mask: Array, newer: LazyNormalEquations) -> LazyNormalEquations:
        """Return the equations with the masked problems taken from ``newer``."""
        return LazyNormalEquations(lambda: self.formed.merged(mask, newer.formed))


@dataclass(frozen=True)
class DenseBlocks:
    """B independent small problems."""

    H: Array  # (B, n, n) symmetric positive semi-definite.
    g: Array  # (B, n) gradient.

    def solve(self, damping: Array) -> Array:
        """Return the (B, n) steps of the damped systems; ``damping`` is (B,)."""
        xp = array_namespace(self.H)
        diagonal = xp.linalg.diagonal(self.H)
        eye = identity(self.H.shape[-1], self.H)
        damped = self.H + (damping[:, None] * diagonal + 1e-9)[:, :, None] * eye
        return -solved(damped, self.g[:, :, None])[..., 0]

    def promised(self, step: Array) -> Array:
        """Return by how much (B,) the steps lower the costs."""
        return -0.5 * array_namespace(step).sum(self.g * step, axis=1)

    def merged(self, mask: Array, newer: DenseBlocks) -> DenseBlocks:
        """Return the equations with the masked problems taken from ``newer``."""
        xp = array_namespace(self.H)
        H = xp.where(mask[:, None, None], newer.H, self.H)
        return DenseBlocks(H, xp.where(mask[:, None], newer.g, self.g))


@dataclass(frozen=True)
class Arrowhead:
    """B blocks that meet only through m shared unknowns, which are found first (Schur complement)."""

    blocks: Array  # (B, n, n).
    coupling: Array  # (B, n, m).
    shared: Array  # (m, m).
    g_blocks: Array  # (B, n).
    g_shared: Array  # (m,).

    def solve(self, damping: Array) -> Array:
        """Return the (1, m + B·n) step, shared unknowns first; ``damping`` is (1,)."""
        xp = array_namespace(self.shared)
        n, m = self.coupling.shape[1:]
        relative = damping[0]
        blocks = self.blocks + (relative * xp.linalg.diagonal(self.blocks) + 1e-9)[:, :, None] * identity(
            n, self.shared
        )
        shared = self.shared + (relative * xp.linalg.diagonal(self.shared) + 1e-9)[:, None] * identity(m, self.shared)
        right = xp.concat([self.coupling, self.g_blocks[:, :, None]], axis=-1)
        eliminated = solved(blocks, right)
        reduced = xp.sum(xp.matmul(xp.permute_dims(self.coupling, (0, 2, 1)), eliminated), axis=0)
        step_shared = -solved(shared - reduced[:, :m], (self.g_shared - reduced[:, m])[:, None])[:, 0]
        step_blocks = -eliminated[..., m] - xp.matmul(eliminated[..., :m], step_shared[:, None])[..., 0]
        return xp.concat([step_shared, xp.reshape(step_blocks, (-1,))])[None]

    def promised(self, step: Array) -> Array:
        """Return by how much (1,) the step lowers the cost."""
        xp = array_namespace(step)
        gradient = xp.concat([self.g_shared, xp.reshape(self.g_blocks, (-1,))])
        return -0.5 * xp.sum(gradient * step, axis=1)

    def merged(self, mask: Array, newer: Arrowhead) -> Arrowhead:
        """Return ``newer`` where the one problem is masked."""
        return newer if bool(mask[0]) else self
