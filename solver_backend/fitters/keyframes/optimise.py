"""Solve latent keyframes: by the sliding window of the thesis (6.3.2) or all keyframes of a take at once."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

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
from solver_backend.fitters.model.subject import Keyframes, PosedFrames, Subject, hemisphere_aligned
from solver_backend.fitters.problem import Convergence
from solver_backend.geometry.arrays import Array, array_namespace, index
from solver_backend.priors.base import PosePrior
from solver_backend.solver.levenberg_marquardt import LMSettings, minimise
from solver_backend.solver.normal_equations import LazyNormalEquations


@dataclass(frozen=True)
class Schedule:
    """Robust scales from wide to narrow and the linearisations spent on each."""

    scales: tuple[float, ...]  # Geman-McClure scales, in standard deviations.
    iterations: int  # Largest number of linearisations per scale.
    stride: int = 1  # Use every n-th frame of the data.
    tolerance: float = 1e-4  # A scale is done when the cost changes by less than this share.
    hessian_frames: int = HESSIAN_FRAMES  # Frames of a window whose Hessians are formed.
    promise: float = 0.0  # Share of the tolerance that a step must promise to be tried; 0 tries every step.


@dataclass(frozen=True)
class KeySolution:
    """A minimum of the objective."""

    keys: Keyframes
    cost: float  # Of data and priors at the last robust scale.
    convergence: Convergence  # Of the last robust scale.


@dataclass(frozen=True)
class BundleModel:
    """The objective as a function of the keys."""

    subject: Subject
    prior: PosePrior
    objective: BundleObjective
    free: StateLayout  # Unknown blocks of a key. Residual rotations that are not free do not act.
    screw: bool = False  # Move the root on screws of SE(3) between keys.

    def part(self, keys: slice) -> BundleModel:
        """Return the model of a range of keys."""
        return replace(self, objective=self.objective.part(keys))

    def astype(self, precision: Any) -> BundleModel:
        """Return the model in a precision; single precision halves memory traffic."""
        return replace(self, subject=self.subject.astype(precision), objective=self.objective.astype(precision))

    def poses(
        self, keys: Keyframes, layout: KeyframeLayout, frames: np.ndarray | None = None, *, spline: bool = False
    ) -> PosedFrames:
        """Return the poses of the given frame numbers, or of all frames of the layout.

        They lie on the windows' own curves, which the solver uses, or on the spline of control points, the result.
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
        """Return the objective (N,) of each window, and a function that forms the equations.

        A key shared by two windows counts for the later one. See ``data_equations`` for ``decoded``.
        """
        data = data_equations(self.frames, keys, rows, scale, hessian_frames, decoded)

        def form() -> KeyframeNormalEquations:
            equations = data.normal_equations()
            for term in self.objective.keys:
                term.add_to(equations, keys)
            return equations

        return self._at_windows(data.cost, keys), form

    def information(self, layout: KeyframeLayout, keys: Keyframes, scale: float) -> KeyframeNormalEquations:
        """Return the equations at a solution, for its covariance, from the frames that form Hessians."""
        # With fixed codes, stride the rows before sampling them, so that few frames are posed.
        stride = 1 if CODE in self.free else max(1, int(np.diff(layout.bounds).max()) // HESSIAN_FRAMES)
        rows = layout.rows(stride)
        return self.equations(rows.sampled(rows.columns(HESSIAN_FRAMES)), keys, scale)[1]()

    @property
    def frames(self) -> FrameData:
        """The data of the frames."""
        return FrameData(self.subject, self.prior, self.objective.frames, self.free, self.screw)

    def _at_windows(self, cost: Array, keys: Keyframes) -> Array:
        """Return the costs (N,) of windows with those of the terms on their keys added."""
        for term in self.objective.keys:
            at_keys = term.cost(keys, self.free)
            cost = cost + at_keys[:-1:2] + at_keys[1::2]
            cost[-1] += at_keys[-1]
        return cost


def _joined_solution(keys: Keyframes, parts: list[KeySolution]) -> KeySolution:
    """Return the solution made of all parts; costs of shared windows count twice."""
    return KeySolution(keys, sum(part.cost for part in parts), Convergence.joined(part.convergence for part in parts))


def solve_sliding(
    model: BundleModel, layout: KeyframeLayout, start: Keyframes, schedule: Schedule, progress: Progress = silent
) -> KeySolution:
    """Solve window after window: the first key is fixed, the n others are free (thesis 6.3.2, eqs. 6.6-6.8).

    Of the n N + 1 start keys only the first is trusted; the others are guesses.
    """
    keys, found = start, []
    fixed = np.arange(layout.free + 1) == 0
    for w in range(layout.num_windows):
        window = slice(layout.free * w, layout.free * (w + 1) + 1)
        solved = solve_keys(model, layout.part(slice(w, w + 1)), keys.select(window), schedule, fixed)
        keys = keys.replaced(window, solved.keys)
        found.append(solved)
        progress("Sliding bundle", w + 1, layout.num_windows)
    return _joined_solution(hemisphere_aligned(keys), found)


def solve_keys(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    fixed: np.ndarray | None = None,
    alive: Callable[[], None] = lambda: None,
) -> KeySolution:
    """Solve all free keyframes at once; a step of the block-tridiagonal equations is linear in the take's length.

    Args:
        fixed: (n N + 1,) bool, keys that do not move; None for none.
        alive: called before each linearisation; may raise to stop the solve.
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
    """Least squares over the keys of a model."""

    model: BundleModel
    layout: KeyframeLayout
    rows: WindowRows
    hessian_frames: int
    decoded: list[Array] | None
    fixed: np.ndarray

    def linearise(self, state: Keyframes, scale: float) -> tuple[Array, LazyNormalEquations]:
        """Return the costs of the windows and their equations, formed on demand."""
        cost, form = self.model.equations(self.rows, state, scale, self.hessian_frames, self.decoded)
        return cost[None], LazyNormalEquations(lambda: form().with_fixed(self.fixed).block_tridiagonal())

    def retract(self, state: Keyframes, step: Array) -> Keyframes:
        """Return the keys moved by a step."""
        by_key = array_namespace(step).reshape(step, (-1, self.model.free.dof))[: self.layout.num_keys]
        return state.retract(by_key, self.model.free)


CHUNK_WINDOWS = 100  # Windows solved at a time, which bounds memory; chosen by hand.
OVERLAP_WINDOWS = 8
"""Windows on both sides of a chunk that are solved with it. Windows farther away do not affect the kept ones
(``tests/fitters/keyframes/test_chunked.py``)."""
SINGLE_TO_M = 100.0  # Within this distance of the origin single precision resolves places to 8 µm (2⁻²⁴ · 128 m).


@dataclass(frozen=True)
class Chunk:
    """Windows whose solution is kept, and the wider range that is solved for it."""

    kept: slice
    solved: slice

    @property
    def keys(self) -> slice:
        """Keys of the solved windows."""
        return slice(2 * self.solved.start, 2 * self.solved.stop + 1)

    @property
    def beyond(self) -> tuple[bool, bool]:
        """There are windows before, and after, the kept ones."""
        return self.solved.start < self.kept.start, self.solved.stop > self.kept.stop


def chunks_of(num_windows: int, before: int, windows: int, overlap: int) -> list[Chunk]:
    """Cut N windows into chunks of about ``windows``, each solved with some windows before and after it."""
    count = max(1, round(num_windows / windows))
    bounds = np.round(np.linspace(0, num_windows, count + 1)).astype(int).tolist()
    return [
        Chunk(slice(a, b), slice(max(0, a - before), min(num_windows, b + overlap)))
        for a, b in itertools.pairwise(bounds)
    ]


@dataclass(frozen=True)
class Stretch:
    """A range of windows as a problem that can be solved anywhere."""

    model: BundleModel  # With the measurements of its frames, or of all frames.
    layout: KeyframeLayout  # Its windows, by the model's frame numbers.
    keys: Keyframes  # Start.
    schedule: Schedule
    fixed: np.ndarray  # (2N + 1,) bool, keys that do not move.

    @classmethod
    def cut(
        cls,
        model: BundleModel,
        layout: KeyframeLayout,
        keys: Keyframes,
        schedule: Schedule,
        windows: slice,
        fixed_ends: tuple[bool, bool],
    ) -> Stretch:
        """Return a range of windows; its three first or last keys do not move where the end is fixed."""
        part, some = layout.part(windows), slice(2 * windows.start, 2 * windows.stop + 1)
        number = np.arange(part.num_keys)
        fixed = (number < 3) & fixed_ends[0] | (number >= part.num_keys - 3) & fixed_ends[1]
        return cls(model.part(some), part, keys.select(some), schedule, fixed)

    def solve(self, alive: Callable[[], None] = lambda: None) -> KeySolution:
        """Return the solution; ``alive`` is called before each linearisation."""
        return solve_keys(self.model, self.layout, self.keys, self.schedule, self.fixed, alive)

    def alone(self) -> Stretch:
        """Return the range with the measurements of its own frames only, to be sent to another process."""
        frames = self.layout.frames
        objective = replace(self.model.objective, frames=self.model.objective.frames.select(index(frames, self.keys.z)))
        bounds = self.layout.bounds - self.layout.bounds[0]
        return replace(self, model=replace(self.model, objective=objective), layout=KeyframeLayout(bounds))


Stretches = Callable[[Sequence[Stretch], Callable[[], None]], list[KeySolution]]
"""Solves independent stretches; the second argument may raise to stop the work."""


def in_turn(stretches: Sequence[Stretch], alive: Callable[[], None]) -> list[KeySolution]:
    """Solve stretches in this process, one after the other."""
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
    """Solve all keys in two rounds of chunks: every other chunk with an overlap, then those between with fixed ends.

    Chunks of the second round begin and end at keys of their neighbours, so curves and their bends join exactly. Chunks
    of one round are independent: the keys do not depend on where and in what order each is solved (red-black order of
    Gauss and Seidel; Young 1971).

    Args:
        windows: windows per chunk.
        overlap: further windows on both sides in the first round.
    """
    keys, found = hemisphere_aligned(start), []
    for first, beyond in ((0, overlap), (1, 1)):
        chunks = chunks_of(layout.num_windows, beyond, windows, beyond)[first::2]
        stretches = [
            Stretch.cut(model, layout, keys, schedule, chunk.solved, chunk.beyond if first else (False, False))
            for chunk in chunks
        ]
        for chunk, solved in zip(chunks, each(stretches, alive), strict=True):
            lead = 2 * (chunk.kept.start - chunk.solved.start)
            kept = slice(2 * chunk.kept.start, 2 * chunk.kept.stop + 1)
            keys = keys.replaced(kept, solved.keys.select(slice(lead, lead + kept.stop - kept.start)))
            found.append(solved)
        keys = hemisphere_aligned(keys)
    return _joined_solution(keys, found)


def solve_in_single(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    alive: Callable[[], None],
    each: Stretches,
) -> KeySolution:
    """Solve all keys as ``solve_long`` does, in single precision where they are near enough to the origin."""
    xp = array_namespace(start.transl)
    if float(xp.max(abs(start.transl))) >= SINGLE_TO_M:
        return solve_long(model, layout, start, schedule, alive, each=each)
    single = model.astype(xp.float32), layout, start.astype(xp.float32)
    found = solve_long(*single, schedule, alive, each=each)
    return replace(found, keys=found.keys.astype(start.z.dtype))
