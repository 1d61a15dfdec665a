"""Takes of any length in bounded memory: chunks of windows that overlap, joined at their keyframes."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

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
"""Windows solved at a time."""
OVERLAP_WINDOWS = 8
"""Windows beyond a chunk that are solved along with it: what comes later has no say in what is kept."""


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


def solve_long(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    alive: Callable[[], None] = lambda: None,
    windows: int = CHUNK_WINDOWS,
    overlap: int = OVERLAP_WINDOWS,
) -> KeySolution:
    """Solve all keys, chunk after chunk, each with the keys of the chunk before it fixed.

    A chunk goes on from the key at which the one before it ends, so that curves and their bends are joined exactly.

    Args:
        model: what the keys are judged by.
        layout: windows of the take.
        start: 2N + 1 keys.
        schedule: robust scales and iterations.
        alive: called before each linearisation; it may raise to end the solve.
        windows: how many are solved at a time.
        overlap: how many beyond them are solved along.
    """
    keys, found = hemisphere_aligned(start), []
    for chunk in chunks_of(layout.num_windows, 1, windows, overlap):
        part = layout.part(chunk.solved)
        fixed = np.arange(part.num_keys) < (3 if chunk.kept.start else 0)
        solved = solve_keys(model.part(chunk.keys), part, keys.select(chunk.keys), schedule, fixed, alive)
        keys = hemisphere_aligned(keys.replaced(chunk.keys, solved.keys))
        found.append(solved)
    return joined_solution(keys, found)


def covariance_of_joints(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, frames: PosedFrames, scale: float, inflation: float,
    chunk_windows: int = CHUNK_WINDOWS, overlap: int = OVERLAP_WINDOWS,
) -> Array:  # fmt: skip
    """Return (F, 24, 6) covariances of the joints, see ``joint_covariance`` and ``packed``, chunk after chunk.

    Args:
        model: what the keys were judged by.
        layout: windows of the take.
        keys: the solution.
        frames: F poses.
        scale: of Geman-McClure's penalty.
        inflation: see ``joint_covariance``.
        chunk_windows: windows at a time.
        overlap: windows on both sides of them whose frames are looked at too.
    """
    first, found = layout.bounds[0], []
    for chunk in chunks_of(layout.num_windows, overlap, chunk_windows, overlap):
        windows, some = layout.part(chunk.solved), keys.select(chunk.keys)
        system = model.part(chunk.keys).information(windows, some, scale).block_tridiagonal()
        poses = frames.select(index(windows.frames - first, keys.z))
        spread = packed(joint_covariance(model, windows, some, poses, system, inflation))
        low, high = layout.bounds[chunk.kept.start] + (chunk.kept.start > 0), layout.bounds[chunk.kept.stop]
        found.append(spread[low - windows.bounds[0] : high + 1 - windows.bounds[0]])
    return array_namespace(keys.z).concat(found)
