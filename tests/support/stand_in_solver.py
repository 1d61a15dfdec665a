"""A program in the place of a Python that runs the solver: quick, and as bad as a take's name asks for."""

from __future__ import annotations

import sys
from pathlib import Path

_PROGRAM = """#!{python} -S
import json, os, pathlib, signal, sys, time
verb, given = sys.argv[3], sys.argv[4:]  # after -m solver_backend
def fail(code, message):
    print(json.dumps(dict(event="error", code=code, message=message, where="", hint="")), flush=True)
    sys.exit(3)
def write(path, data):
    try:
        part = path.with_name(f".{{path.name}}.{{os.getpid()}}")
        part.write_bytes(data)
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        fail("output_not_writable", f"The output cannot be written: {{error.strerror}}.")
if verb == "convert":
    write(pathlib.Path(given[2]), pathlib.Path(given[0]).read_bytes())
else:
    job = pathlib.Path(given[1])
    name = job.name.removesuffix(".job.json")
    time.sleep({seconds})
    if name.startswith("poison"):
        os.kill(os.getppid(), signal.SIGKILL)
    if name.startswith("crash"):
        os.kill(os.getpid(), signal.SIGSEGV)
    if name.startswith("bad"):
        fail("too_few_views", "One camera.")
    for key in ("out", "report"):
        write(job.parent / json.loads(job.read_text())[key], b"x" * 100_000)
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
