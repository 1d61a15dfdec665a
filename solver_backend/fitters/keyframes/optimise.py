"""Latent keyframe bundle solving: the sliding window of the thesis (6.3.2) and all keyframes of a take at once."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

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
from solver_backend.fitters.model.states import Keyframes, PosedFrames, hemisphere_aligned
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Convergence
from solver_backend.geometry.arrays import Array, array_namespace, index
from solver_backend.priors.base import PosePrior
from solver_backend.solver.levenberg_marquardt import LMSettings, minimise
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
        self,
        rows: WindowRows,
        keys: Keyframes,
        scale: float,
        hessian_frames: int = HESSIAN_FRAMES,
        decoded: list[Array] | None = None,
    ) -> tuple[Array, Callable[[], KeyframeNormalEquations]]:
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
        start: n N + 1 keys; of each window only the first key of the take is trusted, the others are guesses.
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
        fixed: (n N + 1,) bool, the keys that stay; None for none.
        alive: called before each linearisation; it may raise to end the solve.
    """
    rows = layout.rows(schedule.stride)
    fixed = np.zeros(layout.num_keys, dtype=bool) if fixed is None else fixed
    problem = _KeyProblem(model, layout, rows, schedule.hessian_frames, model.frames.decode_fixed(start, rows), fixed)
    settings = LMSettings(schedule.iterations, schedule.tolerance, schedule.promise)
    stages = [(scale, settings) for scale in schedule.scales]
    found = minimise(problem, hemisphere_aligned(start), stages, alive)
    return KeySolution(found.state, float(array_namespace(start.z).sum(found.cost)), Convergence.of(found))


@dataclass(frozen=True)
class _KeyProblem:
    """The keys of a model as a problem of least squares."""

    model: BundleModel
    layout: KeyframeLayout
    rows: WindowRows
    hessian_frames: int
    decoded: list[Array] | None
    fixed: np.ndarray

    def linearise(self, state: Keyframes, scale: float) -> tuple[Array, LazyNormalEquations]:
        """Return the costs of the windows and their equations, which are formed when a step is asked for."""
        cost, form = self.model.equations(self.rows, state, scale, self.hessian_frames, self.decoded)
        return cost[None], LazyNormalEquations(lambda: form().with_fixed(self.fixed).block_tridiagonal())

    def retract(self, state: Keyframes, step: Array) -> Keyframes:
        """Return the keys moved by a step."""
        free = self.model.free
        by_key = array_namespace(step).reshape(step, (-1, free.dof))[: self.layout.num_keys]
        return state.retract(by_key, free)


CHUNK_WINDOWS = 100
"""Windows solved at a time: what bounds memory, chosen by hand."""
OVERLAP_WINDOWS = 8
"""Windows on both sides of a chunk that are solved along with it: what lies beyond does not affect what is kept
(``tests/fitters/keyframes/test_chunked.py``)."""
SINGLE_TO_M = 100.0
"""Nearer to the origin than this single precision resolves places to 8 µm (2⁻²⁴ · 128 m)."""


@dataclass(frozen=True)
class Chunk:
    """Some windows of a take."""

    kept: slice
    """Windows whose solution is kept."""
    solved: slice
    """Windows that are looked at for it."""

    @property
    def keys(self) -> slice:
        """The keys of the windows that are looked at."""
        return slice(2 * self.solved.start, 2 * self.solved.stop + 1)


def chunks_of(num_windows: int, before: int, windows: int, overlap: int) -> list[Chunk]:
    """Cut N windows into chunks of about ``windows``, each looked at with some windows before and after it."""
    count = max(1, round(num_windows / windows))
    bounds = np.round(np.linspace(0, num_windows, count + 1)).astype(int).tolist()
    return [
        Chunk(slice(a, b), slice(max(0, a - before), min(num_windows, b + overlap)))
        for a, b in itertools.pairwise(bounds)
    ]


@dataclass(frozen=True)
class Stretch:
    """A chunk as a problem of its own: all that is needed to solve it, wherever that is."""

    model: BundleModel
    """Of its frames and keys alone, or of all frames."""
    layout: KeyframeLayout
    """Its windows, by the model's frame numbers."""
    keys: Keyframes
    """Start."""
    schedule: Schedule
    """Robust scales and iterations."""
    fixed: np.ndarray
    """(2N + 1,) bool, the keys that stay."""

    def solve(self, alive: Callable[[], None] = lambda: None) -> KeySolution:
        """Return the solution; ``alive`` is called before each linearisation."""
        return solve_keys(self.model, self.layout, self.keys, self.schedule, self.fixed, alive)

    def alone(self) -> Stretch:
        """Return the same stretch with the measurements of its own frames alone, to be sent away."""
        frames = self.layout.frames
        objective = replace(self.model.objective, frames=self.model.objective.frames.select(index(frames, self.keys.z)))
        bounds = self.layout.bounds - self.layout.bounds[0]
        return replace(self, model=replace(self.model, objective=objective), layout=KeyframeLayout(bounds))


class Stretches(Protocol):
    """Solves stretches that do not depend on each other."""

    def __call__(self, stretches: Sequence[Stretch], alive: Callable[[], None]) -> list[KeySolution]:
        """Return the solution of each; ``alive`` may raise to end the work."""
        ...


def in_turn(stretches: Sequence[Stretch], alive: Callable[[], None]) -> list[KeySolution]:
    """Solve stretches here, one after the other."""
    return [stretch.solve(alive) for stretch in stretches]


def solve_long(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    alive: Callable[[], None] = lambda: None,
    windows: int = CHUNK_WINDOWS,
    overlap: int = OVERLAP_WINDOWS,
    each: Stretches = in_turn,
) -> KeySolution:
    """Solve all keys, chunk by chunk: every other one with windows beyond it, then those between, whose ends are fixed.

    The chunks between begin and end at keys of their neighbours, whose outermost windows stay, so that curves and their
    bends are joined exactly. Chunks of one round do not depend on each other: wherever each of them is solved, and in
    what order, the keys are the same (the red-black order of Gauss and Seidel; Young 1971).

    Args:
        alive: called before each linearisation; it may raise to end the solve.
        windows: how many are solved at a time.
        overlap: how many beyond them, on both sides, are solved along in the first round.
    """
    keys, found = hemisphere_aligned(start), []
    for first, beyond in ((0, overlap), (1, 1)):
        chunks = chunks_of(layout.num_windows, beyond, windows, beyond)[first::2]
        stretches = [_stretch(model, layout, keys, schedule, chunk, ends_fixed=first == 1) for chunk in chunks]
        for chunk, solved in zip(chunks, each(stretches, alive), strict=True):
            lead = 2 * (chunk.kept.start - chunk.solved.start)
            kept = slice(2 * chunk.kept.start, 2 * chunk.kept.stop + 1)
            keys = keys.replaced(kept, solved.keys.select(slice(lead, lead + kept.stop - kept.start)))
            found.append(solved)
        keys = hemisphere_aligned(keys)
    return joined_solution(keys, found)


def solve_in_single(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    alive: Callable[[], None],
    each: Stretches,
) -> KeySolution:
    """Solve all keys as ``solve_long`` does, in single precision where they stand near enough to the origin for it."""
    xp = array_namespace(start.transl)
    if float(xp.max(abs(start.transl))) >= SINGLE_TO_M:
        return solve_long(model, layout, start, schedule, alive, each=each)
    single = model.astype(xp.float32), layout, start.astype(xp.float32)
    found = solve_long(*single, schedule, alive, each=each)
    return replace(found, keys=found.keys.astype(start.z.dtype))


def _stretch(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, schedule: Schedule, chunk: Chunk, *, ends_fixed: bool
) -> Stretch:
    """Return a chunk's problem; with ``ends_fixed`` the windows beyond it stay as they are."""
    part = layout.part(chunk.solved)
    number, fixed = np.arange(part.num_keys), np.zeros(part.num_keys, dtype=bool)
    if ends_fixed:
        fixed |= (number < 3) & (chunk.solved.start < chunk.kept.start)
        fixed |= (number >= part.num_keys - 3) & (chunk.solved.stop > chunk.kept.stop)
    return Stretch(model.part(chunk.keys), part, keys.select(chunk.keys), schedule, fixed)
