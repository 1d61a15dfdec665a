"""Solve the demo capture with the add-on's operator in the bpy module. The best of three counts.

"added" is the operator's time without the solver's process, in which the command line does the same job: writing the
job, starting the process, reading the motion, creating the body and its action. Processor seconds are given with wall
seconds because machines are shared. "poll" is the timer's longest work, which it does ten times per second.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

import blender_addon
from blender_addon.solving.child import SolverProcess
from blender_addon.solving.run import Run
from tests.benchmarks.metric import Metric

REPEATS = 3
_PROGRESS = '{"event": "progress", "stage": "Working", "done": 1, "total": 2, "eta_s": 3.0}'


def run() -> list[Metric]:
    """Solve, and separate the process's time from the rest."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    blender_addon.register()
    try:
        with TemporaryDirectory() as folder:
            bpy.context.scene.mocap.folder = folder
            bpy.ops.mocap.demo_capture()
            solver, added, added_cpu = np.min([_solved() for _ in range(REPEATS)], axis=0)
    finally:
        blender_addon.unregister()
    return [
        Metric("longest_poll_cpu_ms", 1000 * _longest_poll_s(), "ms", rel_tol=1.0, abs_tol=2.0),
        Metric("solver_s", solver, "s", rel_tol=2.0),
        Metric("added_s", added, "s", rel_tol=1.0, abs_tol=0.5),
        Metric("added_percent", 100 * added / solver, "%", rel_tol=1.0, abs_tol=5.0),
        Metric("added_cpu_s", added_cpu, "s", rel_tol=0.6, abs_tol=0.2),
    ]


def _longest_poll_s() -> float:
    """Return the processor seconds of the longest poll of a process that writes 20,000 lines at once."""
    code = f"import sys\nfor i in range(10_000): print({_PROGRESS!r}); print('a line of the log', file=sys.stderr)"
    run = Run("solve", SolverProcess([sys.executable, "-c", code], os.environ, Path.cwd()))
    run.process.wait()
    polls = []
    while not run.finished:
        start = time.process_time()
        run.poll()
        polls.append(time.process_time() - start)
    return max(polls)


def _solved() -> tuple[float, float, float]:
    """Return wall seconds of the solver's process, and wall and processor seconds of everything else."""
    bpy.context.scene.mocap.review.armature = None  # so that each run also creates the body
    with _waiting() as waited:
        start, processor = time.perf_counter(), time.process_time()
        bpy.ops.mocap.solve()
        wall, processor = time.perf_counter() - start, time.process_time() - processor
    return waited[0], wall - waited[0], processor


@contextmanager
def _waiting() -> Iterator[list[float]]:
    """Yield a list that receives the seconds for which the add-on waits for the process."""
    waited: list[float] = []
    wait = SolverProcess.wait

    def timed(self: SolverProcess) -> int:
        start = time.perf_counter()
        code = wait(self)
        waited.append(time.perf_counter() - start)
        return code

    SolverProcess.wait = timed
    try:
        yield waited
    finally:
        SolverProcess.wait = wait
