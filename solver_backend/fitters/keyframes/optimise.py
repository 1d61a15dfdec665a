"""Latent keyframe bundle solving: the sliding window of the thesis (6.3.2) and all keyframes of a take at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.state_layout import CODE, StateLayout
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.keyframes.bundle_objective import BundleObjective
from solver_backend.fitters.keyframes.normal_equations import (
    HESSIAN_FRAMES,
    FrameData,
    KeyframeNormalEquations,
    data_equations,
)
from solver_backend.fitters.model.keyframe_curve import key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout, WindowRows
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.solution import Convergence
from solver_backend.geometry.arrays import Array
from solver_backend.priors.base import PosePrior
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import LazyNormalEquations


@dataclass(frozen=True)
class Schedule:
    """Robust scales from wide to narrow and the linearisations spent on each."""

    scales: tuple[float, ...]
    """Geman-McClure scales in standard deviations."""
    iterations: int
    """Linearisations at most, per scale."""
    stride: int = 1
    """Every how many frames the data are looked at."""
    tolerance: float = 1e-4
    """A scale is done when the cost changes by less than this share."""
    hessian_frames: int = HESSIAN_FRAMES
    """Frames of a window whose Hessians are formed."""
    promise: float = 0.0
    """Share of the tolerance that a step must promise to be tried; 0 tries every step."""


@dataclass(frozen=True)
class KeySolution:
    """Keys that no step makes better."""

    keys: Keyframes
    """2N + 1 keys."""
    cost: float
    """Of data and priors at the last robust scale."""
    convergence: Convergence
    """How the last robust scale ended."""


@dataclass(frozen=True)
class BundleModel:
    """What evaluates the keys."""

    subject: Subject
    """The person."""
    prior: PosePrior
    """Decoder of the codes."""
    objective: BundleObjective
    """What is minimised."""
    free: StateLayout
    """The blocks of a key that are unknowns; residual rotations that are none do not act."""
    screw: bool = False
    """The root moves on screws of SE(3) between keys."""

    def part(self, keys: slice) -> BundleModel:
        """Return what evaluates some of the keys."""
        return replace(self, objective=self.objective.part(keys))

    def astype(self, precision: Any) -> BundleModel:
        """Return the model in a precision; single halves the memory's traffic where more digits add nothing."""
        return replace(self, subject=self.subject.astype(precision), objective=self.objective.astype(precision))

    def poses(
        self, keys: Keyframes, layout: KeyframeLayout, frames: np.ndarray | None = None, *, spline: bool = False
    ) -> PosedFrames:
        """Return the poses that the keys make of these frame numbers, or of all frames of the layout.

        They lie on the windows' own curves, which is what is solved; or, as a take is handed over, on the spline of
        control points.
        """
        turned = bool(self.free.turned)
        return key_poses(self.prior, keys, layout, frames, residuals=turned, spline=spline, screw=self.screw)

    def equations(
        self, rows: WindowRows, keys: Keyframes, scale: float, hessian_frames: int = HESSIAN_FRAMES,
        decoded: list[Array] | None = None,
    ) -> tuple[Array, Callable[[], KeyframeNormalEquations]]:  # fmt: skip
        """Return the objective (N,) of each window at these keys, and what forms their equations.

        What lies at a key that two windows share counts for the later one. See ``data_equations`` for ``decoded``.
        """
        data = data_equations(self.frames, keys, rows, scale, hessian_frames, decoded)

        def form() -> KeyframeNormalEquations:
            equations = data.normal_equations()
            for term in self.objective.keys:
                term.add_to(equations, keys)
            return equations

        return self._at_windows(data.cost, keys), form

    def information(self, layout: KeyframeLayout, keys: Keyframes, scale: float) -> KeyframeNormalEquations:
        """Return the equations at a solution, for its covariance, from the frames that form Hessians alone."""
        # Fixed codes: rows are strided before those that form Hessians are chosen among them, so that few are posed.
        stride = 1 if CODE in self.free else max(1, int(np.diff(layout.bounds).max()) // HESSIAN_FRAMES)
        rows = layout.rows(stride)
        return self.equations(rows.sampled(rows.columns(HESSIAN_FRAMES)), keys, scale)[1]()

    @property
    def frames(self) -> FrameData:
        """What evaluates the frames."""
        return FrameData(self.subject, self.prior, self.objective.frames, self.free, self.screw)

    def _at_windows(self, cost: Array, keys: Keyframes) -> Array:
        """Return the costs (N,) of windows with those of the terms on their keys added."""
        for term in self.objective.keys:
            at_keys = term.cost(keys, self.free)
            cost = cost + at_keys[:-1:2] + at_keys[1::2]
            cost[-1] += at_keys[-1]
        return cost


def joined_solution(keys: Keyframes, parts: list[KeySolution]) -> KeySolution:
    """Return the keys of all parts, solved one after the other; costs of what parts share count twice."""
    convergence = Convergence.joined(part.convergence for part in parts)
    return KeySolution(keys, sum(part.cost for part in parts), convergence)


def solve_sliding(
    model: BundleModel, layout: KeyframeLayout, start: Keyframes, schedule: Schedule, progress: Progress = silent
) -> KeySolution:
    """Solve window after window: the first key fixed, the n others free (thesis 6.3.2, eqs. 6.6-6.8).

    Args:
        model: what evaluates the keys.
        layout: windows of the take.
        start: n N + 1 keys; of each window only the first key of the take is trusted, the others are guesses.
        schedule: robust scales and iterations.
        progress: called after each window.
    """
    keys, found = start, []
    fixed = np.arange(layout.free + 1) == 0
    for w in range(layout.num_windows):
        window = slice(layout.free * w, layout.free * (w + 1) + 1)
        solved = solve_keys(model, layout.part(slice(w, w + 1)), keys.select(window), schedule, fixed)
        keys = keys.replaced(window, solved.keys)
        found.append(solved)
        progress("Sliding bundle", w + 1, layout.num_windows)
    return joined_solution(hemisphere_aligned(keys), found)


def solve_keys(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    fixed: np.ndarray | None = None,
    alive: Callable[[], None] = lambda: None,
) -> KeySolution:
    """Solve the free keyframes at once: normal equations are block-tridiagonal, a step is linear in the take's length.

    Args:
        model: what evaluates the keys.
        layout: windows of the frames.
        start: n N + 1 keys.
        schedule: robust scales and iterations.
        fixed: (n N + 1,) bool, the keys that stay; None for none.
        alive: called before each linearisation; it may raise to end the solve.
    """
    xp = array_namespace(start.z)
    rows, free = layout.rows(schedule.stride), model.free
    decoded = model.frames.decode_fixed(start, rows)
    fixed = np.zeros(layout.num_keys, dtype=bool) if fixed is None else fixed
    keys, solution = hemisphere_aligned(start), None

    def retract(state: Keyframes, step: Array) -> Keyframes:
        return state.retract(xp.reshape(step, (-1, free.dof))[: layout.num_keys], free)

    for scale in schedule.scales:

        def linearise(state: Keyframes, scale: float = scale) -> tuple[Array, LazyNormalEquations]:
            alive()
            cost, form = model.equations(rows, state, scale, schedule.hessian_frames, decoded)
            return cost[None], LazyNormalEquations(lambda: form().with_fixed(fixed).block_tridiagonal())

        settings = LMSettings(schedule.iterations, schedule.tolerance, schedule.promise)
        result = levenberg_marquardt(keys, linearise, retract, settings)
        keys = result.state
        solution = KeySolution(keys, float(xp.sum(result.cost)), Convergence.of(result))
    assert solution is not None
    return solution
