"""The one loop of all recipes over keyframes: what is learned before a pass, and the pass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.bundle_objective import OFF_MANIFOLD
from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.recipes.bundle import Bundle

Step = Callable[[Bundle], Bundle]
"""Learns something again from the poses that there are; ``steps`` has them."""


@dataclass(frozen=True)
class Pass:
    """One minimisation over the keys."""

    schedule: Schedule
    """Robust scales and iterations."""
    free: tuple[str, ...]
    """Blocks of the state that are unknowns."""
    before: tuple[Step, ...] = ()
    """What is learned again before it, in this order."""
    looseness: float = OFF_MANIFOLD
    """How far joints may leave the manifold, in the prior's own deviations."""

    def run(self, bundle: Bundle, alive: Callable[[], None]) -> Bundle:
        """Return the bundle with the keys that this pass finds; ``alive`` is called before each linearisation."""
        for step in self.before:
            bundle = step(bundle)
        bundle = bundle.with_objective(self.free, self.looseness)
        found = bundle.solve(bundle.model, bundle.posed.layout, bundle.posed.keys, self.schedule, alive=alive)
        return replace(bundle.move(found.keys), schedule=self.schedule, solution=found)


def run_passes(
    bundle: Bundle, passes: Sequence[Pass], progress: Progress, stage: str, after: Sequence[Step] = ()
) -> Bundle:
    """Return the bundle after all passes, and the steps that follow the last.

    Args:
        bundle: where to start.
        passes: one after the other.
        progress: called with the number of the pass before each linearisation.
        stage: its name.
        after: what is done with the keys of the last pass.
    """
    for number, one in enumerate(passes):
        bundle = one.run(bundle, partial(progress, stage, number, len(passes)))
    for step in after:
        bundle = step(bundle)
    progress(stage, len(passes), len(passes))
    return bundle
