"""Run one method on one capture in a separate process, and store the result under ``build/bench_bundle/runs``.

A result is valid while the capture and every module that the method imports do not change.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from research.baselines import BaselineResult
from research.simulation.benchmark import BenchmarkSettings
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.synthesis.faults import DetectorFaults
from tests.benchmarks.comparison.captures import capture_path, filmed
from tests.benchmarks.comparison.code_version import ROOT, code_version
from tests.benchmarks.comparison.judgement import Row, judged, worst_joints
from tests.benchmarks.comparison.methods import Method

FOLDER = ROOT / "build" / "bench_bundle" / "runs"


@dataclass(frozen=True)
class Run:
    """Method, take and settings of a run."""

    method: Method
    take: str
    """As in ``captures.TAKES``."""
    settings: BenchmarkSettings = field(default_factory=BenchmarkSettings)
    bad: str | None = None
    """A name of ``captures.BAD``."""

    @property
    def path(self) -> Path:
        """Path of the stored result."""
        parts = [
            code_version(self.method.module), json.dumps(self.method.changes), self.method.kind,
            capture_path(self.take, self.settings, self.bad).name,
            os.environ.get("OMP_NUM_THREADS", ""),
        ]  # fmt: skip
        return FOLDER / f"{hashlib.sha256(chr(0).join(parts).encode()).hexdigest()[:16]}.json"


@dataclass(frozen=True)
class Outcome:
    """Result of a run."""

    row: Row  # Figures of the judgement, ``seconds``, ``cpu_s`` (independent of other load) and ``peak_mb``.
    notes: list[str]  # Messages about problems.
    worst: list[Any]  # Joints with the largest mean error.
    motion: Path | None  # The solved motion.


def outcome(run: Run) -> Outcome:
    """Return the result of a run, made now or earlier, and evaluate it again."""
    solve_apart(run)
    stored = json.loads(run.path.read_text(encoding="utf-8"))
    capture, path = filmed(run.take, run.settings, run.bad), run.path.with_suffix(".npz")
    if stored["body"]:
        motion = read_motion(path)
        assert motion.keypoints3d is not None
        result = BaselineResult(motion.keypoints3d, motion)
    else:
        with np.load(path, allow_pickle=False) as arrays:
            result = BaselineResult(arrays["keypoints3d"].astype(np.float64))
    row = judged(capture, result) | stored["spent"]
    return Outcome(row, stored["notes"], worst_joints(capture, result), path if stored["body"] else None)


def solve_apart(run: Run) -> None:
    """Execute a run in a separate process, unless it was done."""
    if run.path.exists():
        return
    order = json.dumps({**asdict(run), "out": str(run.path)})
    command = [sys.executable, "-m", "tests.benchmarks.comparison.runs", order]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{run.method.name} on {run.take} failed:\n{done.stderr[-2000:]}")


def outcomes(runs: list[Run], tell: Callable[[str], None], jobs: int = 1) -> dict[Run, Outcome]:
    """Return the results of all runs, ``jobs`` at a time. Report the progress and the remaining time after each."""
    for run in runs:
        filmed(run.take, run.settings, run.bad)
    missing, begin = [run for run in runs if not run.path.exists()], time.monotonic()
    with ThreadPoolExecutor(jobs) as pool:
        waiting = {pool.submit(solve_apart, run): run for run in missing}
        for number, future in enumerate(as_completed(waiting), start=1):
            future.result()
            run, left = waiting[future], (time.monotonic() - begin) / number * (len(missing) - number)
            tell(f"[{number}/{len(missing)}, {left / 60:.1f} min left] {run.method.name}, {run.take} {run.bad or ''}, "
                 f"{run.settings.num_views} views")  # fmt: skip
    return {run: outcome(run) for run in runs}


def peak_memory_mb() -> float:
    """Return the peak memory of this process. ``ru_maxrss`` would include its parent's memory at the fork."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(re.search(r"VmHWM:\s+(\d+)", status.read_text(encoding="ascii"))[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(order: str) -> int:
    """Execute one run, given as JSON, and write its result."""
    asked = json.loads(order)
    method = Method(asked["method"]["kind"], tuple((k, v) for k, v in asked["method"]["changes"]))
    detector = asked["settings"].pop("detector")
    detector = DetectorFaults(**detector | {"swap_frames": tuple(detector["swap_frames"])})
    settings = BenchmarkSettings(**asked["settings"], detector=detector)
    capture, solve = filmed(asked["take"], settings, asked["bad"]), method.solver()
    begin, begin_cpu = time.perf_counter(), time.process_time()
    result = solve(capture)
    seconds, cpu_s = time.perf_counter() - begin, time.process_time() - begin_cpu
    peak_mb = peak_memory_mb()
    out, motion = Path(asked["out"]), result.motion
    out.parent.mkdir(parents=True, exist_ok=True)
    if motion is None:
        np.savez(out.with_suffix(".npz"), keypoints3d=result.keypoints3d)
    else:
        write_motion(out.with_suffix(".npz"), motion, overwrite=True)
    spent = {"seconds": seconds, "cpu_s": cpu_s, "peak_mb": peak_mb}
    notes = [] if motion is None else list(motion.provenance.get("notes", []))
    text = json.dumps({"spent": spent, "notes": notes, "body": motion is not None})
    partial = out.with_suffix(".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1]))
