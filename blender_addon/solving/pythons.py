"""Find and test Python installations for the solver and the detectors."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..backend_environment import backend_command, backend_folder, environment_for_child
from ..conventions.file_paths import sessions_folder
from ..errors import PythonUnsuitable

_TIMEOUT_S = 60  # Seconds to wait for an interpreter. Chosen by hand.
_BELOW = "Scripts/python.exe" if os.name == "nt" else "bin/python"  # Path of the Python inside an environment.
MINORS = {"mediapipe": range(9, 13), "litert": range(10, 15)}
"""Minor versions of Python 3 that have wheels of both MediaPipe 0.10.21 and LiteRT 2."""
_DETECTORS = {"mediapipe": "MediaPipe", "onnxruntime": "ONNX Runtime", "litert": "LiteRT"}
_PROBE = """
import json, sys
from importlib.metadata import version
found = {"python": sys.version.split()[0], "mediapipe": "", "onnxruntime": "", "litert": ""}
for name in ("mediapipe", "onnxruntime"):
    try:
        module = __import__(name)
        found[name] = module.__version__ if name != "mediapipe" or hasattr(module, "solutions") else ""
    except Exception:
        pass
try:
    import ai_edge_litert.interpreter
    found["litert"] = version("ai-edge-litert")
except Exception:
    pass
print(json.dumps(found))
"""


def environment_folder(kind: str = "mediapipe") -> Path:
    """Return the folder of the MediaPipe or LiteRT environment that *Set Up Detector* makes."""
    return sessions_folder() / ("detector" if kind == "mediapipe" else f"detector-{kind}")


def made_python() -> Path | None:
    """Return the detector Python: from the environment variable, from *Set Up Detector*, or the solver's."""
    folders = (environment_folder(), backend_folder() / ".venv-mediapipe")
    named = os.environ.get("MANIFOLD_MOCAP_DETECTOR_PYTHON", "")
    candidates = [*([Path(named)] if named else []), *(folder / _BELOW for folder in folders)]
    return next((python for python in candidates if python.is_file()), None)


def made_litert_python() -> Path | None:
    """Return the Python that *Set Up Detector* made for LiteRT, or None if there is none."""
    python = environment_folder("litert") / _BELOW
    return python if python.is_file() else None


def probe_detector(python: Path, packages: Path | None = None) -> str:
    """Return a text about the detectors in a Python. Raise ``PythonUnsuitable`` if it does not start."""
    kept = {name: value for name, value in os.environ.items() if not name.upper().startswith("PYTHON")}
    kept |= {} if packages is None else {"PYTHONPATH": str(packages)}
    try:
        done = _ask(str(python), _PROBE, kept)
        found = json.loads(done.stdout.splitlines()[-1])
        parts = [f"{name} {found[key]}" for key, name in _DETECTORS.items() if found[key]]
        return f"{' and '.join(parts) or 'no detector'} in Python {found['python']}"
    except (OSError, ValueError, IndexError, KeyError, TypeError, subprocess.TimeoutExpired) as error:
        hint = "Choose another Python, or press Set Up Detector."
        raise PythonUnsuitable("This program is not a working Python.", where=str(python), hint=hint) from error


def python_to_make_with(kind: str = "mediapipe") -> Path:
    """Return a Python that can install a detector's wheels: Blender's own or one from the system."""
    minors = MINORS[kind]
    fits = sys.version_info.major == 3 and sys.version_info.minor in minors
    if fits and find_spec("ensurepip") is not None:
        return Path(sys.executable)
    for candidate in _candidates(minors):
        if _minor(candidate) in minors:
            return Path(candidate)
    name, newest = ("MediaPipe", "LiteRT")[kind == "litert"], f"3.{minors[-1]}"
    own = f"is {sys.version_info.major}.{sys.version_info.minor}"
    why = "cannot create environments (ensurepip is missing)" if fits else own
    raise PythonUnsuitable(
        f"{name} needs Python 3.{minors[0]} to {newest}. Blender's own Python {why}, and no other was found.",
        where="Set Up Detector",
        hint=f"Install Python {newest} from python.org (on Debian and Ubuntu, also python3-venv), or set a Python that "
        "has a detector in the preferences.",
    )


def detector_kind() -> str:
    """Return which detector Blender's Python supports. MediaPipe comes first, because it includes its models."""
    fits = (kind for kind, minors in MINORS.items() if sys.version_info.minor in minors)
    return next(fits, "mediapipe") if find_spec("ensurepip") is not None else "mediapipe"


def _candidates(minors: range) -> Iterator[str]:
    names = [f"python3.{minor}" for minor in reversed(minors)] + ["python3", "python"]
    yield from filter(None, map(shutil.which, names))
    if os.name == "nt":
        programs = Path(os.environ.get("LOCALAPPDATA", "")) / "Programs" / "Python"
        yield from (str(path) for path in sorted(programs.glob("Python3*/python.exe"), reverse=True))


def _minor(python: str) -> int:
    """Return the minor version of a Python 3 that can make environments, or -1 for any other program."""
    code = "import sys, venv, ensurepip; print(*sys.version_info[:2])"
    try:
        done = subprocess.run([python, "-I", "-c", code], capture_output=True, text=True, timeout=10, check=False)
        major, minor = map(int, done.stdout.split())
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return -1
    return minor if major == 3 else -1


_LEAST = (3, 11)  # Oldest Python version that can run the solver, as in pyproject.toml.
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
    torch: str  # '' if torch is missing.
    devices: tuple[str, ...]
    solver: str


def probe_python(python: Path | None) -> PythonFound:
    """Return a Python's versions and devices. Raise ``PythonUnsuitable`` if it does not start."""
    executable = backend_command(python)[0]
    try:
        done = _ask(executable, _SOLVER_PROBE, environment_for_child(python))
        values = json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 and done.stdout.strip() else None
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise _unsuitable(f"It does not respond like Python: {error}", executable) from error
    if values is None:
        message = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise _unsuitable(f"This Python cannot run the solver: {message}", executable)
    if tuple(int(part) for part in values["python"].split(".")[:2]) < _LEAST:
        raise _unsuitable(f"This is Python {values['python']}, but 3.11 or later is needed.", executable)
    if not values["numpy"]:
        raise _unsuitable(f"This Python {values['python']} has no NumPy.", executable)
    found: dict[str, Any] = {**values, "devices": tuple(values["devices"])}
    return PythonFound(**found)


def _ask(python: str, program: str, environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    words, no_input = [python, "-c", program], subprocess.DEVNULL
    return subprocess.run(
        words, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False, env=environment, stdin=no_input
    )


def _unsuitable(message: str, executable: str) -> PythonUnsuitable:
    hint = "Choose another Python, or leave the field empty to use Blender's own."
    return PythonUnsuitable(message, where=executable, hint=hint)
