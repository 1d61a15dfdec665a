"""Find, probe or make the Python that solves or detects."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import threading
import venv
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from ..backend_environment import backend_command, backend_folder, environment_for_child
from ..conventions.file_paths import sessions_folder
from ..errors import PythonUnsuitable

_TIMEOUT_S = 60
_BELOW = "Scripts/python.exe" if os.name == "nt" else "bin/python"
"""Where an environment has its Python."""
MINORS = {"mediapipe": range(9, 13), "litert": range(10, 15)}
"""Python 3's minor versions that the wheels of MediaPipe 0.10.21 and of LiteRT 2 are for."""
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


@dataclass(frozen=True)
class DetectorFound:
    """What a Python has that finds people in pictures."""

    python: str
    mediapipe: str
    """Version, "" without it or without its pose model."""
    onnxruntime: str
    """Version, "" without it."""
    litert: str = ""
    """Version of Google's LiteRT, "" without it."""

    def __str__(self) -> str:
        versions = (("MediaPipe", self.mediapipe), ("ONNX Runtime", self.onnxruntime), ("LiteRT", self.litert))
        parts = [f"{name} {version}" for name, version in versions if version]
        return f"{' and '.join(parts) or 'no detector'} in Python {self.python}"


def environment_folder(kind: str = "mediapipe") -> Path:
    """Return the folder that *Set Up Detector* makes: of MediaPipe, or of LiteRT."""
    return sessions_folder() / ("detector" if kind == "mediapipe" else f"detector-{kind}")


def made_python() -> Path | None:
    """Return the Python that has a detector without being named: as set up here or for the solver, None without one."""
    folders = (environment_folder(), backend_folder() / ".venv-mediapipe")
    named = os.environ.get("MANIFOLD_MOCAP_DETECTOR_PYTHON", "")
    candidates = [*([Path(named)] if named else []), *(folder / _BELOW for folder in folders)]
    return next((python for python in candidates if python.is_file()), None)


def made_litert_python() -> Path | None:
    """Return the Python with LiteRT that was set up here, None without one."""
    python = environment_folder("litert") / _BELOW
    return python if python.is_file() else None


def probe_detector(python: Path) -> DetectorFound:
    """Start a Python and ask which detectors it has.

    Raises:
        PythonUnsuitable: it does not start.
    """
    kept = {name: value for name, value in os.environ.items() if not name.upper().startswith("PYTHON")}
    try:
        done = subprocess.run(
            [str(python), "-c", _PROBE], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False,
            stdin=subprocess.DEVNULL, env=kept,
        )  # fmt: skip
        return DetectorFound(**json.loads(done.stdout.splitlines()[-1]))
    except (OSError, ValueError, IndexError, TypeError, subprocess.TimeoutExpired) as error:
        hint = "Choose another Python, or press Set Up Detector."
        raise PythonUnsuitable("It does not answer as a Python does.", where=str(python), hint=hint) from error


def python_to_make_with(kind: str = "mediapipe") -> Path:
    """Return a Python that a detector's wheels are for and that makes environments: Blender's own, or the system's.

    Raises:
        PythonUnsuitable: there is none.
    """
    minors = MINORS[kind]
    fits = sys.version_info.major == 3 and sys.version_info.minor in minors
    if fits and find_spec("ensurepip") is not None:
        return Path(sys.executable)
    for candidate in _candidates(minors):
        if _minor(candidate) in minors:
            return Path(candidate)
    name, newest = ("MediaPipe", "LiteRT")[kind == "litert"], f"3.{minors[-1]}"
    own = f"is {sys.version_info.major}.{sys.version_info.minor}"
    why = "cannot make environments (ensurepip is missing)" if fits else own
    raise PythonUnsuitable(
        f"{name} needs Python 3.{minors[0]} to {newest}; this Blender's own {why}, and no other was found.",
        where="Set Up Detector",
        hint=f"Install Python {newest} from python.org (on Debian and Ubuntu python3-venv, too), or name a Python that "
        "has a detector in the preferences.",
    )


def _candidates(minors: range) -> Iterator[str]:
    names = [f"python3.{minor}" for minor in reversed(minors)] + ["python3", "python"]
    yield from filter(None, map(shutil.which, names))
    if os.name == "nt":
        programs = Path(os.environ.get("LOCALAPPDATA", "")) / "Programs" / "Python"
        yield from (str(path) for path in sorted(programs.glob("Python3*/python.exe"), reverse=True))


def _minor(python: str) -> int:
    """Return the minor version of a Python 3 that makes environments, -1 of others."""
    code = "import sys, venv, ensurepip; print(*sys.version_info[:2])"
    try:
        done = subprocess.run([python, "-I", "-c", code], capture_output=True, text=True, timeout=10, check=False)
        major, minor = map(int, done.stdout.split())
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return -1
    return minor if major == 3 else -1


MEDIAPIPE = "mediapipe==0.10.21"
IMPORTED = (
    "numpy>=1.26,<2", "opencv-contrib-python-headless>=4.10,<4.12", "absl-py>=2,<3", "attrs>=23", "matplotlib>=3.8,<4",
    "flatbuffers>=23.5,<26", "protobuf>=4.25.3,<5", "sounddevice>=0.4.4,<1",
)  # fmt: skip
"""What its pose and holistic models import, as in ``supply.detectors``."""
PROBE = "import mediapipe; mediapipe.solutions.pose.Pose(); mediapipe.solutions.holistic"
LITERT = ("ai-edge-litert>=2,<3", "numpy>=1.26,<3")
LITERT_PROBE = "import ai_edge_litert.interpreter"
NO_PIP = (
    "Its part ensurepip is missing: install python3-venv (Debian, Ubuntu), or use a Blender or Python from its maker."
)
LARGEST_MODEL = 64_000_000
"""Bytes; the largest that is known has 27 million."""


@dataclass(frozen=True)
class Kind:
    """A detector that can be set up."""

    name: str
    alone: tuple[str, ...]
    """Packages that are installed without what they ask for."""
    packages: tuple[str, ...]
    probe: str
    """Program that starts it."""


KINDS = {
    "mediapipe": Kind("MediaPipe", (MEDIAPIPE,), IMPORTED, PROBE), "litert": Kind("LiteRT", (), LITERT, LITERT_PROBE),
}  # fmt: skip
STAGES = ("Making the environment", "Installing the detector", "Installing what it needs", "Testing")


def main(folder: Path, kind: Kind, wheels: Path | None) -> int:
    """Make the environment and return the exit code."""
    progress(0)
    unfinished = folder.with_name(f"{folder.name} unfinished")
    try:
        venv.create(unfinished, clear=True, with_pip=True)
    except subprocess.CalledProcessError:
        return fail(f"Python {sys.version.split()[0]} cannot make environments.", Path(sys.executable), NO_PIP)
    except OSError as error:
        return fail(f"The environment could not be made: {error}", folder, "Check the free space and the rights there.")
    python = Path("Scripts/python.exe" if os.name == "nt" else "bin/python")
    source = [] if wheels is None else ["--no-index", "--find-links", str(wheels)]
    pip = [str(unfinished / python), "-m", "pip", "install", "--disable-pip-version-check", "--no-input", *source]
    alone = [[*pip, "--no-deps", *kind.alone]] if kind.alone else []
    for number, command in enumerate([*alone, [*pip, *kind.packages]], start=1):
        progress(number)
        if wrong := run(command):
            where = "the folder of wheels" if wheels is not None else "the package registry that pip is set up for"
            return fail(
                f"A package could not be installed from {where}: {wrong}", folder, "See the log, then try again."
            )
    progress(3)
    if wrong := run([str(unfinished / python), "-c", kind.probe]):
        return fail(f"{kind.name} is installed and does not start: {wrong}", folder, "See the log.")
    models = [] if wheels is None else unpacked_models(wheels, unfinished / "models")
    shutil.rmtree(folder, ignore_errors=True)
    unfinished.replace(folder)
    models = [folder / "models" / path.name for path in models]
    write({"event": "result", "python": str(folder / python), "models": [str(path) for path in models]})
    return 0


def unpacked_models(wheels: Path, folder: Path) -> list[Path]:
    """Return the models of the npm packages in a folder, unpacked beside the environment; those too large are left."""
    found = []
    for package in sorted(wheels.glob("mediapipe-*.tgz")):
        with tarfile.open(package) as members:
            for member in members:
                name = Path(member.name).name
                if member.isfile() and name.endswith(".tflite") and member.size <= LARGEST_MODEL:
                    stream = members.extractfile(member)
                    if stream is not None:
                        folder.mkdir(exist_ok=True)
                        found.append(folder / name)
                        found[-1].write_bytes(stream.read())
    return found


def run(command: list[str]) -> str:
    """Run a command, its output in the log, and return the last line of what went wrong, "" where nothing did."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    sys.stderr.write(done.stdout)
    return "" if done.returncode == 0 else (done.stdout.strip().splitlines() or [f"exit code {done.returncode}"])[-1]


def progress(done: int) -> None:
    """Report the stage that begins."""
    write({"event": "progress", "stage": STAGES[done], "done": done, "total": len(STAGES)})


def fail(message: str, folder: Path, hint: str) -> int:
    """Report an error and return the exit code."""
    write({"event": "error", "code": "detector_not_made", "message": message, "where": str(folder), "hint": hint})
    return 1


def write(event: dict[str, object]) -> None:
    """Write an event as a line."""
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def end_with_parent() -> None:
    """End when standard input does: the program that started this has cancelled it or died."""
    sys.stdin.read()
    os._exit(130)


if __name__ == "__main__":
    threading.Thread(target=end_with_parent, daemon=True).start()
    sys.exit(main(Path(sys.argv[1]), KINDS[sys.argv[2]], Path(sys.argv[3]) if len(sys.argv) > 3 else None))


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
