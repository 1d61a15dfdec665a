"""Run Levenberg-Marquardt on manifolds, for one problem or for many independent problems together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from solver_backend.geometry.arrays import Array, array_namespace, identity, solved


class NormalEquations(Protocol):
    """Normal equations ``(H + damping diag(H)) step = -g`` for one or more independent problems."""

    def solve(self, damping: Array) -> Array:
        """Return the damped step. ``damping`` has one value per problem."""
        ...

    def promised(self, step: Array) -> Array:
        """Return the predicted decrease (B,) of the costs, ``-½ gᵀ step``, for small damping."""
        ...

    def merged(self, mask: Array, newer: Any) -> NormalEquations:
        """Replace the equations of the masked problems with the ones in ``newer``."""
        ...


class LazyNormalEquations:
    """Normal equations that are computed on first use, as rejected states do not need them."""

    def __init__(self, form: Callable[[], NormalEquations]) -> None:
        self._form: Callable[[], NormalEquations] | None = form
        self._equations: NormalEquations | None = None

    @property
    def formed(self) -> NormalEquations:
        """The equations, computed on first use. The inputs are then released from memory."""
        if self._equations is None:
            assert self._form is not None
            self._equations, self._form = self._form(), None
        return self._equations

    def solve(self, damping: Array) -> Array:
        """Return the damped steps (see ``NormalEquations``)."""
        return self.formed.solve(damping)

    def promised(self, step: Array) -> Array:
        """Return the predicted decrease (B,) of the costs."""
        return self.formed.promised(step)

    def merged(self, mask: Array, newer: LazyNormalEquations) -> LazyNormalEquations:
        """Replace the equations of the masked problems with the ones in ``newer``."""
        return LazyNormalEquations(lambda: self.formed.merged(mask, newer.formed))


@dataclass(frozen=True)
class DenseBlocks:
    """Normal equations of B small independent problems with n unknowns each."""

    H: Array  # (B, n, n) symmetric positive semi-definite.
    g: Array  # (B, n) gradient.

    def solve(self, damping: Array) -> Array:
        """Return the (B, n) steps of the damped systems. ``damping`` is (B,)."""
        xp = array_namespace(self.H)
        diagonal = xp.linalg.diagonal(self.H)
        eye = identity(self.H.shape[-1], self.H)
        damped = self.H + (damping[:, None] * diagonal + 1e-9)[:, :, None] * eye
        return -solved(damped, self.g[:, :, None])[..., 0]

    def promised(self, step: Array) -> Array:
        """Return the predicted decrease (B,) of the costs."""
        return -0.5 * array_namespace(step).sum(self.g * step, axis=1)

    def merged(self, mask: Array, newer: DenseBlocks) -> DenseBlocks:
        """Replace the equations of the masked problems with the ones in ``newer``."""
        xp = array_namespace(self.H)
        H = xp.where(mask[:, None, None], newer.H, self.H)
        return DenseBlocks(H, xp.where(mask[:, None], newer.g, self.g))


@dataclass(frozen=True)
class Arrowhead:
    """Normal equations of B blocks with m shared unknowns. The step of the shared unknowns is computed first."""

    blocks: Array  # (B, n, n).
    coupling: Array  # (B, n, m).
    shared: Array  # (m, m).
    g_blocks: Array  # (B, n).
    g_shared: Array  # (m,).

    def solve(self, damping: Array) -> Array:
        """Return the (1, m + B·n) step, with the shared unknowns first. ``damping`` is (1,)."""
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
        """Return the predicted decrease (1,) of the cost."""
        xp = array_namespace(step)
        gradient = xp.concat([self.g_shared, xp.reshape(self.g_blocks, (-1,))])
        return -0.5 * xp.sum(gradient * step, axis=1)

    def merged(self, mask: Array, newer: Arrowhead) -> Arrowhead:
        """Return ``newer`` if the mask (1,) is true, otherwise these equations."""
        return newer if bool(mask[0]) else self


State = TypeVar("State")

LESS, MORE, MORE_OF_PART = 0.3, 6.0, 1e3
"""Damping factors: after an accepted step, after a rejected one, and for parts that the rejected one worsened."""
LEAST_DAMPING = 1e-7  # Smallest damping, which gives a Gauss-Newton step. Chosen by hand.
HELD_BACK = 1.0  # From this damping on, a part is held back, and a small decrease may not be the end. Chosen by hand.
MOST_DAMPING = 1e4  # Largest damping. If a step with it increases the cost, no step reduces it. Chosen by hand.


@dataclass(frozen=True)
class LMSettings:
    """Stopping rule and damping constants of ``levenberg_marquardt``."""

    max_iterations: int = 20
    tolerance: float = 1e-4  # A problem is solved when an accepted step reduces its cost by less than this fraction.
    promise: float = 0.0  # Fraction of the tolerance that a step must promise to be tried. 0 tries every step.
    damping: float = 1e-3  # Initial damping, relative to the diagonal of H (Marquardt 1963).


@dataclass(frozen=True)
class LMResult(Generic[State]):
    """Result of a minimisation."""

    state: State
    cost: Array  # (B,) cost of each problem, or (B, P) of its parts.
    system: NormalEquations  # Normal equations at the state, which contain the information of the data.
    iterations: int
    converged: bool  # Whether no step changes the cost any more.

    @property
    def status(self) -> str:
        """Sentence that says how the minimisation ended."""
        return "The cost no longer changes." if self.converged else "Stopped at max_iterations. More may help."


def levenberg_marquardt(
    state: State,
    linearise: Callable[[State], tuple[Array, NormalEquations]],
    retract: Callable[[State, Array], State],
    settings: LMSettings = LMSettings(),
    select: Callable[[Array, State, State], State] = lambda _, new, old: new,
) -> LMResult[State]:
    """Minimise ``sum_b f_b``, with separate unknowns for each problem b.

    Each step δ solves ``(H + λ diag H) δ = -g``. If the cost decreases, x becomes ``retract(x, δ)`` and λ shrinks.
    Otherwise, λ grows (Levenberg 1944, Marquardt 1963). A problem may return the costs of its P consecutive parts, each
    with its own λ. A step is still accepted or rejected as a whole. A part is harmed if it or the previous part becomes
    worse, because they share unknowns. λ does not shrink for harmed parts after an accepted step, and grows only for
    harmed parts after a rejected one. The minimisation ends when the predicted decrease is too small (Moré 1978).

    Args:
        linearise: maps a state to the (B,) costs of problems, or (B, P) of their parts, and to the normal equations.
        retract: maps (state, (B, n) tangent steps) to a state on the manifold.
        select: maps ((B,) mask, new, old) to a state with the masked problems from new. Not needed for one problem.
    """
    cost, system = linearise(state)
    xp = array_namespace(cost)
    damping, total = xp.full_like(cost, settings.damping), _total(cost)
    converged = xp.zeros_like(total, dtype=xp.bool)
    better = ~converged
    for iteration in range(1, settings.max_iterations + 1):
        step = system.solve(damping)
        # After a rejection, a damped step promises little because it is short.
        if settings.promise and bool(
            xp.all(converged | better & _promises_little(system, step, cost, damping, settings))
        ):
            return LMResult(state, cost, system, iteration - 1, True)
        candidate = retract(state, step)
        new_cost, new_system = linearise(candidate)
        new_total = _total(new_cost)
        better = new_total < total
        change = xp.abs(new_total - total) / (total + 1e-12)
        damping = _adapted(damping, better, new_cost > cost)
        if bool(xp.all(better)):
            state, cost, system = candidate, new_cost, new_system
        elif bool(xp.any(better)):
            state, system = select(better, candidate, state), system.merged(better, new_system)
            cost = xp.where(_of_parts(better, cost), new_cost, cost)
        total = _total(cost)
        # A rejected step does not show how close the minimum is, unless even the shortest step is rejected.
        most = _most(damping)
        enough = settings.tolerance * _share_awaited(most, damping)
        converged = converged | (better & (change < enough)) | (~better & (most > MOST_DAMPING))
        if bool(xp.all(converged)):
            return LMResult(state, cost, system, iteration, True)
    return LMResult(state, cost, system, settings.max_iterations, False)


def _adapted(damping: Array, better: Array, worse_part: Array) -> Array:
    """Return the damping for the next step: smaller after an accepted step, larger after a rejected one.

    In a problem of several parts, a rejected step increases the damping only for each part that became worse and for
    the part after it. An accepted step does not decrease the damping of these parts.
    """
    xp = array_namespace(damping)
    if damping.ndim == 1 or damping.shape[1] == 1:
        better = _of_parts(better, damping)
        return xp.where(better, xp.clip(damping * LESS, LEAST_DAMPING, None), damping * MORE)
    beside = xp.concat([xp.zeros_like(worse_part[:, :1]), worse_part[:, :-1]], axis=1)
    harmed = worse_part | beside  # a window's last key belongs to the next window
    accepted = xp.where(harmed, damping, xp.clip(damping * LESS, LEAST_DAMPING, None))
    refused = xp.where(harmed, damping * MORE_OF_PART, damping)
    return xp.where(better[:, None], accepted, refused)


def _promises_little(system: NormalEquations, step: Array, cost: Array, damping: Array, settings: LMSettings) -> Array:
    """Return a (B,) mask of problems where the predicted decrease is too small to try the step."""
    share = settings.promise * settings.tolerance * _share_awaited(_most(damping), damping)
    return system.promised(step) < share * _total(cost)


def _most(damping: Array) -> Array:
    return damping if damping.ndim == 1 else array_namespace(damping).max(damping, axis=1)


def _share_awaited(most: Array, damping: Array) -> Array | float:
    """Return the (B,) factors by which the tolerance is scaled: 1, or 0.1 for problems with strongly damped parts."""
    return 1.0 if damping.ndim == 1 else 1.0 - 0.9 * array_namespace(most).astype(most >= HELD_BACK, most.dtype)


def _total(cost: Array) -> Array:
    return cost if cost.ndim == 1 else array_namespace(cost).sum(cost, axis=1)


def _of_parts(mask: Array, cost: Array) -> Array:
    return mask if cost.ndim == 1 else mask[:, None]


class RobustProblem(Protocol[State]):
    """Least-squares problem with outliers. A threshold, in robust standard deviations, separates them from inliers."""

    def linearise(self, state: State, scale: float) -> tuple[Array, NormalEquations]:
        """Return the costs and the normal equations at a state (see ``levenberg_marquardt``)."""
        ...

    def retract(self, state: State, step: Array) -> State:
        """Return the state after (B, n) tangent steps."""
        ...


def minimise(
    problem: RobustProblem[State],
    state: State,
    stages: Sequence[tuple[float, LMSettings]],
    alive: Callable[[], None] = lambda: None,
    select: Callable[[Array, State, State], State] = lambda _, new, old: new,
    done: Callable[[int, int], None] = lambda number, total: None,
) -> LMResult[State]:
    """Minimise a problem in stages with robust scales, and return the last stage's result.

    This is graduated non-convexity (Blake and Zisserman 1987, "Visual Reconstruction").

    Args:
        stages: robust scale and stopping rule of each stage. There is at least one.
        alive: called before each linearisation. It may raise an error to stop the minimisation.
        select: see ``levenberg_marquardt``.
        done: called with the number of finished stages and the total number of stages.
    """
    result = None
    for number, (scale, settings) in enumerate(stages, 1):

        def linearise(at: State, scale: float = scale) -> tuple[Array, NormalEquations]:
            alive()
            return problem.linearise(at, scale)

        result = levenberg_marquardt(state, linearise, problem.retract, settings, select)
        state = result.state
        done(number, len(stages))
    assert result is not None
    return result
