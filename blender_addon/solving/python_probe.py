"""What a Python has that could run the solver."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from ..backend_environment import backend_command, environment_for_child
from ..errors import PythonUnsuitable

_SOLVER_TIMEOUT_S = 60
"""Seconds that an interpreter has to answer; chosen by hand."""
_LEAST = (3, 11)
"""Version of Python that the solver needs, as pyproject.toml has it."""
_SOLVER_PROBE = """
import json, sys
found = {"python": sys.version.split()[0], "numpy": "", "torch": "", "devices": [], "solver": ""}
if sys.version_info >= (3, 11):
    try:
        import numpy
        found["numpy"] = numpy.__version__
    except ImportError:
        pass
    try:
        import torch
        found["torch"], found["devices"] = torch.__version__, ["CPU"]
        if torch.cuda.is_available():
            found["devices"] += [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
        if torch.backends.mps.is_available():
            found["devices"].append("Apple GPU")
    except ImportError:
        pass
    if found["numpy"]:
        import solver_backend
        found["solver"] = solver_backend.__version__
print(json.dumps(found))
"""


@dataclass(frozen=True)
class PythonFound:
    """Versions and devices of a Python that can run the solver."""

    python: str
    numpy: str
    torch: str
    """'' without torch."""
    devices: tuple[str, ...]
    solver: str


def probe_python(python: Path | None) -> PythonFound:
    """Start a Python and ask what it has.

    Args:
        python: interpreter; None for Blender's own.

    Raises:
        SolverMissing: there is no such file, or the solver is not there.
        PythonUnsuitable: it does not start, is too old, or has no NumPy.
    """
    executable = backend_command(python)[0]
    try:
        done = subprocess.run(
            [executable, "-c", _SOLVER_PROBE], capture_output=True, text=True, timeout=_SOLVER_TIMEOUT_S, check=False,
            env=environment_for_child(python), stdin=subprocess.DEVNULL,
        )  # fmt: skip
        values = json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 and done.stdout.strip() else None
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise _unsuitable(f"It does not answer as a Python does: {error}", executable) from error
    if values is None:
        message = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise _unsuitable(f"This Python cannot run the solver: {message}", executable)
    if tuple(int(part) for part in values["python"].split(".")[:2]) < _LEAST:
        raise _unsuitable(f"This is Python {values['python']}; 3.11 or later is needed.", executable)
    if not values["numpy"]:
        raise _unsuitable(f"This Python {values['python']} has no NumPy.", executable)
    return PythonFound(**{**values, "devices": tuple(values["devices"])})


def _unsuitable(message: str, executable: str) -> PythonUnsuitable:
    hint = "Choose another Python, or leave the field empty to use Blender's own."
    return PythonUnsuitable(message, where=executable, hint=hint)
