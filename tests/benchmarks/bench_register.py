"""Import and register the add-on in a fresh process of the bpy module, with compiled byte code, the best of seven.

Processor seconds are given with wall seconds because machines are shared.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.benchmarks.metric import Metric

REPEATS = 7
ROOT = Path(__file__).resolve().parents[2]
MEASURED = """
import sys, time
sys.path.insert(0, {folder!r})
import bpy
wall, processor = time.perf_counter(), time.process_time()
import blender_addon
blender_addon.register()
print("took", 1000 * (time.perf_counter() - wall), 1000 * (time.process_time() - processor), flush=True)
blender_addon.unregister()
"""
"""Source code that measures the add-on of a folder."""


def run() -> list[Metric]:
    """Register the add-on."""
    return measure("register", [sys.executable, "-c", MEASURED.format(folder=str(ROOT))])


def measure(name: str, command: list[str], environment: dict[str, str] | None = None) -> list[Metric]:
    """Run a command that executes ``MEASURED``, and return the best wall and processor milliseconds."""
    runs = [_took(command, environment) for _ in range(REPEATS)]
    best = [min(values) for values in zip(*runs, strict=True)]
    return [
        Metric(f"{name}{what}_ms", value, "ms", rel_tol=0.5, abs_tol=10)
        for what, value in zip(("", "_cpu"), best, strict=True)
    ]


def _took(command: list[str], environment: dict[str, str] | None) -> tuple[float, float]:
    environment = dict(environment or os.environ)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # if it is set, every run compiles
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    line = next(line for line in done.stdout.splitlines() if line.startswith("took "))
    wall, processor = line.split()[1:]
    return float(wall), float(processor)
