"""Takes of any length in bounded memory: chunks of windows that overlap, joined at their keyframes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.keyframes.optimise import BundleModel, KeySolution, Schedule, joined_solution, solve_keys
from solver_backend.fitters.keyframes.posterior import joint_covariance
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.geometry.arrays import Array, index
from solver_backend.geometry.symmetric import packed

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
        model: what evaluates the keys.
        layout: windows of the take.
        start: 2N + 1 keys.
        schedule: robust scales and iterations.
        alive: called before each linearisation; it may raise to end the solve.
        windows: how many are solved at a time.
        overlap: how many beyond them, on both sides, are solved along in the first round.
        each: solves the chunks of a round.
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
    model: BundleModel, layout: KeyframeLayout, start: Keyframes, schedule: Schedule, alive: Callable[[], None],
    each: Stretches,
) -> KeySolution:  # fmt: skip
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


def covariance_of_joints(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, frames: PosedFrames, scale: float, inflation: float,
    constant_m: np.ndarray, chunk_windows: int = CHUNK_WINDOWS, overlap: int = OVERLAP_WINDOWS, stride: int = 1,
    done: Callable[[int, int], None] = lambda number, total: None,
) -> Array:  # fmt: skip
    """Return (F, 24, 6) covariances of the joints, see ``joint_covariance`` and ``packed``, chunk after chunk.

    Args:
        model: what evaluated the keys.
        layout: windows of the take.
        keys: the solution.
        frames: F poses.
        scale: of Geman-McClure's penalty.
        inflation: see ``joint_covariance``.
        constant_m: see ``joint_covariance``.
        chunk_windows: windows at a time.
        overlap: windows on both sides of them whose frames are looked at too.
        stride: see ``joint_covariance``.
        done: called with the number of chunks that are done and of all.
    """
    first, found = layout.bounds[0], []
    chunks = chunks_of(layout.num_windows, overlap, chunk_windows, overlap)
    for chunk in chunks:
        windows, some = layout.part(chunk.solved), keys.select(chunk.keys)
        part = model.part(chunk.keys)
        system = part.information(windows, some, scale).block_tridiagonal()
        poses = frames.select(index(windows.frames - first, keys.z))
        spread = packed(joint_covariance(model, windows, some, poses, system, inflation, constant_m, stride))
        low, high = layout.bounds[chunk.kept.start] + (chunk.kept.start > 0), layout.bounds[chunk.kept.stop]
        found.append(spread[low - windows.bounds[0] : high + 1 - windows.bounds[0]])
        done(len(found), len(chunks))
    return array_namespace(keys.z).concat(found)
