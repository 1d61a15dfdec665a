"""Takes of any length in bounded memory: stretches of windows that overlap, joined at their keyframes."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from array_api_compat import array_namespace

from solver_backend.fitters.keyframes.optimise import BundleModel, KeySolution, Schedule, joined_solution, solve_keys
from solver_backend.fitters.keyframes.posterior import joint_covariance
from solver_backend.fitters.model.keyframe_curve import KeyframeLayout, Keyframes, hemisphere_aligned
from solver_backend.fitters.model.subject import PosedFrames, select_frames
from solver_backend.geometry.arrays import Array, index
from solver_backend.geometry.symmetric import packed

STRETCH_WINDOWS = 100
"""Windows solved at a time."""
OVERLAP_WINDOWS = 8
"""Windows beyond a stretch that are solved along with it: what comes later has no say in what is kept."""


@dataclass(frozen=True)
class Part:
    """Some windows of a take."""

    kept: slice
    """Windows whose solution is kept."""
    solved: slice
    """Windows that are looked at for it."""

    @property
    def keys(self) -> slice:
        """The keys of the windows that are looked at."""
        return slice(2 * self.solved.start, 2 * self.solved.stop + 1)


def parts_of(num_windows: int, before: int, stretch: int, overlap: int) -> list[Part]:
    """Cut N windows into parts of about ``stretch``, each looked at with some windows before and after it."""
    count = max(1, round(num_windows / stretch))
    bounds = np.round(np.linspace(0, num_windows, count + 1)).astype(int).tolist()
    return [
        Part(slice(a, b), slice(max(0, a - before), min(num_windows, b + overlap)))
        for a, b in itertools.pairwise(bounds)
    ]


def solve_long(
    model: BundleModel,
    layout: KeyframeLayout,
    start: Keyframes,
    schedule: Schedule,
    alive: Callable[[], None] = lambda: None,
    stretch: int = STRETCH_WINDOWS,
    overlap: int = OVERLAP_WINDOWS,
) -> KeySolution:
    """Solve all keys, stretch after stretch, each with the keys of the stretch before it held.

    A stretch goes on from the key at which the one before it ends, so that curves and their bends are joined exactly.

    Args:
        model: what the keys are judged by.
        layout: windows of the take.
        start: 2N + 1 keys.
        schedule: robust scales and iterations.
        alive: called before each linearisation; it may raise to end the solve.
        stretch: windows solved at a time.
        overlap: windows beyond them that are solved along.
    """
    keys, found = hemisphere_aligned(start), []
    for part in parts_of(layout.num_windows, 1, stretch, overlap):
        layout_of_part = layout.part(part.solved)
        held = 3 if part.kept.start else 0
        free = np.arange(layout_of_part.num_keys) >= held
        some = keys.select(part.keys)
        solved = solve_keys(model.part(part.keys), layout_of_part, some, schedule, free, alive)
        keys = hemisphere_aligned(keys.replaced(part.keys, solved.keys))
        found.append(solved)
    return joined_solution(keys, found)


def covariance_of_joints(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, frames: PosedFrames, scale: float, inflation: float,
    stretch: int = STRETCH_WINDOWS, overlap: int = OVERLAP_WINDOWS,
) -> Array:  # fmt: skip
    """Return (F, 24, 6) covariances of the joints, see ``joint_covariance`` and ``packed``, stretch after stretch.

    Args:
        model: what the keys were judged by.
        layout: windows of the take.
        keys: the solution.
        frames: F poses.
        scale: of Geman-McClure's penalty.
        inflation: see ``joint_covariance``.
        stretch: windows at a time.
        overlap: windows on both sides of them whose frames are looked at too.
    """
    first, found = layout.bounds[0], []
    for part in parts_of(layout.num_windows, overlap, stretch, overlap):
        windows, some = layout.part(part.solved), keys.select(part.keys)
        system = model.part(part.keys).information(windows, some, scale).equations()
        poses = select_frames(frames, index(windows.frames - first, keys.z))
        spread = packed(joint_covariance(model, windows, some, poses, system, inflation))
        low, high = layout.bounds[part.kept.start] + (part.kept.start > 0), layout.bounds[part.kept.stop]
        found.append(spread[low - windows.bounds[0] : high + 1 - windows.bounds[0]])
    return array_namespace(keys.z).concat(found)
