"""Compare our method with BundleMoCap++'s optimiser: one window after another, Algorithm 1, automatic differentiation.

The first windows of a take of 2,000 frames and 4 views are solved as published: strong Wolfe, at most 30 iterations,
PyTorch in single precision, the mesh posed with its correctives, and keypoints regressed from its vertices as with
SMPL. A second run in double precision has our landmarks instead of the mesh. PyTorch may use all cores. Its time is
extrapolated to the take. Our time includes all steps from keypoints to motion. The published method's first key and
shape are not counted.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace

import numpy as np

from research.baselines.bundlemocap import MAX_ITERATIONS, BundleMoCapPlusPlus
from research.baselines.person import Prepared, prepare
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.pipeline import solve
from solver_backend.fitters.recipes.bundlemocap import KEYS, KeyState, Window
from solver_backend.fitters.single_frame import fit_to_points
from solver_backend.geometry.arrays import Array, constant
from solver_backend.solver.descent import MinimiseSettings, gradient_descent
from solver_backend.types import Capture
from tests.benchmarks.comparison.autograd_window import AutogradWindow, keypoint_regressor, resident
from tests.benchmarks.comparison.captures import LONG_TAKE, filmed
from tests.benchmarks.metric import BenchmarkSkipped, Metric

WINDOWS = 3  # Number of windows that are solved as published.


def run() -> list[Metric]:
    """Solve in both ways."""
    try:
        import torch
    except ImportError as error:
        raise BenchmarkSkipped("It needs PyTorch.") from error
    capture = filmed(LONG_TAKE)
    before = torch.get_num_threads()
    torch.set_num_threads(os.cpu_count() or 1)
    spent, metrics = {}, []
    for body, mesh in (("mesh", True), ("landmarks", False)):
        spent[body], evaluations = published_seconds(capture, WINDOWS, mesh=mesh)
        metrics += [
            Metric(f"published_{body}_s", spent[body], "s", rel_tol=1.0),
            Metric(f"published_{body}_evaluations", evaluations, "", rel_tol=0.2),
        ]
    torch.set_num_threads(before)
    for backend in ("numpy", "torch"):
        begin = time.perf_counter()
        solve(capture, SolveSettings(backend=backend))
        seconds = time.perf_counter() - begin
        metrics.append(Metric(f"{backend}_s", seconds, "s", rel_tol=1.0))
        metrics += [
            Metric(f"{backend}_times_faster_than_{body}", found / seconds, "", direction="higher", rel_tol=0.5)
            for body, found in spent.items()
        ]
    return metrics


def published_seconds(capture: Capture, count: int, *, mesh: bool) -> tuple[float, float]:
    """Return seconds for the whole take, extrapolated from its first windows, and evaluations per window."""
    import torch

    layout = KeyframeLayout.even(capture.num_frames, BundleMoCapPlusPlus().window)
    prepared, evaluations = prepare(capture), 0
    key = first_key(prepared)
    like = torch.zeros(1, dtype=torch.float32 if mesh else torch.float64)
    windows = [window_of(prepared, layout, number, key, like, mesh=mesh) for number in range(count)]
    begin = time.perf_counter()
    for window in windows:
        window = replace(window, window=replace(window.window, first=key))
        start = tuple(part.repeat(2, axis=0) for part in key)
        found = gradient_descent(KEYS, window.objective, start, MinimiseSettings(MAX_ITERATIONS))
        key, evaluations = tuple(part[-1:] for part in found.state), evaluations + found.evaluations
    return (time.perf_counter() - begin) / count * layout.num_windows, evaluations / count


def first_key(prepared: Prepared) -> KeyState:
    """Return the pose of the first visible frame."""
    problem = prepared.problem
    fitted = fit_to_points(problem, prepared.subject, prepared.seen[:1])
    return fitted.z, fitted.root, fitted.transl


def window_of(
    prepared: Prepared, layout: KeyframeLayout, number: int, key: KeyState, like: Array, *, mesh: bool = False
) -> AutogradWindow:
    """Return one window of the take, starting at its first key."""
    problem = prepared.problem
    where, time_in_window = layout.positions(layout.frames)
    index = np.flatnonzero(where == number)
    term, scale = problem.measurements.term.select(index), BundleMoCapPlusPlus().scale
    window = Window(prepared.subject, problem.prior, term, scale, time_in_window[index], key)
    cameras = {name: constant(getattr(term.cameras, name), like) for name in ("K", "distortion", "R", "t")}
    tensors = {name: constant(getattr(term, name), like) for name in ("xy", "weight", "confidence")}
    term = replace(term, cameras=replace(term.cameras, **cameras), **tensors)
    if not mesh:
        return AutogradWindow(window, term)
    body, landmarks = prepared.subject.body, prepared.subject.landmarks
    none, eye = np.zeros(10), np.eye(3)
    rest = pose_landmarks(body, landmarks, none, eye[None], np.tile(eye, (1, 21, 1, 1)), np.zeros((1, 3))).points[0]
    return AutogradWindow(window, term, (resident(body, like), constant(keypoint_regressor(body, rest), like)))
