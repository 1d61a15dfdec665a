"""Ours against BundleMoCap++'s own optimiser: window after window, Algorithm 1, gradients by automatic differentiation.

The first windows of a take of 2,000 frames and 4 views are solved as published (strong Wolfe, at most 30 iterations,
PyTorch on one thread, landmarks in place of the mesh) and their processor time is scaled to the take; ours is the whole
way from keypoints to motion. Their first key and shape cost nothing here.
"""

from __future__ import annotations

import time
from dataclasses import fields, replace

import numpy as np

from solver_backend.fitters.baselines.bundlemocap import MAX_ITERATIONS, BundleMoCapPlusPlus
from solver_backend.fitters.baselines.person import Prepared, prepare
from solver_backend.fitters.baselines.windows import SPHERICAL, KeyState, Window
from solver_backend.fitters.initial import fit_to_points
from solver_backend.fitters.keyframes import KeyframeLayout
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solve import solve
from solver_backend.geometry.arrays import Array, constant
from solver_backend.solver.riemannian import MinimiseSettings, gradient_descent
from solver_backend.types import Capture
from tests.benchmarks.autograd_window import AutogradWindow
from tests.benchmarks.captures import LONG_TAKE, filmed
from tests.benchmarks.metric import BenchmarkSkipped, Metric

WINDOWS = 5
"""Windows that are solved as published."""


def run() -> list[Metric]:
    """Solve both ways."""
    capture = filmed(LONG_TAKE)
    seconds, evaluations = published_seconds(capture, WINDOWS)
    metrics = [
        Metric("published_s", seconds, "s", rel_tol=1.0),
        Metric("published_evaluations", evaluations, "", rel_tol=0.2),
    ]
    for backend in ("numpy", "torch"):
        begin, begin_cpu = time.perf_counter(), time.process_time()
        solve(capture, SolveSettings(backend=backend))
        cpu = time.process_time() - begin_cpu
        metrics += [
            Metric(f"{backend}_s", time.perf_counter() - begin, "s", rel_tol=1.0),
            Metric(f"{backend}_cpu_s", cpu, "s", rel_tol=1.0),
            Metric(f"{backend}_times_faster", seconds / cpu, "", direction="higher", rel_tol=0.5),
        ]
    return metrics


def published_seconds(capture: Capture, count: int) -> tuple[float, float]:
    """Return processor seconds for the whole take, told from its first windows, and evaluations a window."""
    try:
        import torch
    except ImportError as error:
        raise BenchmarkSkipped("It needs PyTorch.") from error
    layout = KeyframeLayout.even(capture.num_frames, BundleMoCapPlusPlus().window)
    prepared = prepare(capture)
    threads, evaluations = torch.get_num_threads(), 0
    key = first_key(prepared)
    torch.set_num_threads(1)
    begin = time.process_time()
    for number in range(count):
        window = window_of(prepared, layout, number, key, torch.zeros(1, dtype=torch.float64))
        start = tuple(part.repeat(2, axis=0) for part in key)
        found = gradient_descent(SPHERICAL, window.objective, start, MinimiseSettings(MAX_ITERATIONS))
        key, evaluations = tuple(part[-1:] for part in found.state), evaluations + found.evaluations
    spent = time.process_time() - begin
    torch.set_num_threads(threads)
    return spent / count * layout.num_windows, evaluations / count


def first_key(prepared: Prepared) -> KeyState:
    """Return the pose of the first frame that is seen."""
    problem = prepared.problem
    fitted = fit_to_points(prepared.subject, problem.prior, problem.observations, prepared.seen[:1])
    return fitted.z, fitted.root, fitted.transl


def window_of(prepared: Prepared, layout: KeyframeLayout, number: int, key: KeyState, like: Array) -> AutogradWindow:
    """Return one window of the take from its first key on."""
    problem = prepared.problem
    where, time_in_window = layout.positions(layout.frames)
    index = np.flatnonzero(where == number)
    term, scale = problem.term.select(index), BundleMoCapPlusPlus().scale
    window = Window(prepared.subject, problem.prior, SPHERICAL, term, scale, time_in_window[index], key)
    tensors = {field.name: getattr(term, field.name) for field in fields(term) if field.name != "model"}
    return AutogradWindow(window, replace(term, **{name: constant(part, like) for name, part in tensors.items()}))
