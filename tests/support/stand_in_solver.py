"""A program in the place of a Python that runs the solver: quick, and as bad as a take's name asks for."""

from __future__ import annotations

import sys
from pathlib import Path

_PROGRAM = """#!{python} -S
import json, os, pathlib, signal, sys, time
verb, given = sys.argv[3], sys.argv[4:]  # after -m solver_backend
def fail(code, message):
    print(json.dumps(dict(event="result", problems=[], diagnostics=[], frames=3, unsure_frames=0, unseen_frames=0,
    motion="m", capture="c", name="c", fps=30, cameras=[], notes=[], people=[], person="",
    reprojection_median_px=2.5)), flush=True)
"""


def write_stand_in(folder: Path, seconds: float = 0.2) -> Path:
    """Write the program and return its path, for ``BatchRequest.python``.

    Takes called ``poison…`` kill the process that started the solver, ``crash…`` die, ``bad…`` fail by name.

    Args:
        folder: where to write it.
        seconds: how long a solve takes.
    """
    path = folder / "stand_in"
    path.write_text(_PROGRAM.format(python=sys.executable, seconds=seconds))
    path.chmod(0o755)
    return path
