"""Landmarks of 53 markers with pose correctives: positions and all derivatives of 1,000 frames in float64.

Derivatives are by 66 rotations, 10 shapes and the markers' offsets. The best of eleven runs counts, for elapsed time
and for CPU time, which is more reliable if other programs share the cores. torch runs with one thread and with two. Two
threads wait for each other after every product, and lose far more than half on shared cores.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.geometry.rotations import exp_so3
from tests.benchmarks.metric import Metric

FRAMES, RUNS = 1000, 11


def run() -> list[Metric]:
    """Time both array backends."""
    body = load_body()
    names = marker_layout("MANIFOLD_53")
    landmarks = marker_landmarks(body, names)
    rng = np.random.default_rng(0)
    state = {
        "betas": rng.normal(size=10),
        "global_orient": exp_so3(rng.normal(size=(FRAMES, 3))),
        "local": exp_so3(0.4 * rng.normal(size=(FRAMES, 21, 3))),
        "transl": rng.normal(size=(FRAMES, 3)),
        "offsets": 0.01 * rng.normal(size=(len(names), 3)),
    }
    metrics = _timed("numpy", lambda: pose_landmarks(body, landmarks, **state, jacobian=True))
    try:
        import torch
    except ImportError:
        return metrics
    threads = torch.get_num_threads()
    tensors = {key: torch.as_tensor(value) for key, value in state.items()}
    for count, label in ((1, "torch"), (2, "torch_2_threads")):
        torch.set_num_threads(count)
        metrics += _timed(label, lambda: pose_landmarks(body, landmarks, **tensors, jacobian=True))
    torch.set_num_threads(threads)
    return metrics


def _timed(backend: str, work: Callable[[], object]) -> list[Metric]:
    elapsed, cpu = [], []
    for _ in range(RUNS):
        start, start_cpu = time.perf_counter(), time.process_time()
        work()
        elapsed.append(1e3 * (time.perf_counter() - start))
        cpu.append(1e3 * (time.process_time() - start_cpu))
    return [
        Metric(f"{backend}_ms", min(elapsed), "ms", rel_tol=1.0),
        Metric(f"{backend}_cpu_ms", min(cpu), "ms", rel_tol=1.0),
    ]
