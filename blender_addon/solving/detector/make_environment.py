"""Make a Python environment with MediaPipe; run as a file by a Python that its wheel is for, with nothing of ours.

Usage: ``python make_environment.py FOLDER [WHEELS]``. It writes JSON lines: progress, and a result or an error. With
WHEELS, a folder of wheels, nothing is downloaded. MediaPipe's wheel 0.10.21 carries its pose model (Apache-2.0); it is
installed without what it asks for, which holds a second OpenCV, and with what its pose model imports.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import venv
from pathlib import Path

MEDIAPIPE = "mediapipe==0.10.21"
IMPORTED = (
    "numpy>=1.26,<2", "opencv-contrib-python-headless>=4.10,<4.12", "absl-py>=2,<3", "attrs>=23", "matplotlib>=3.8,<4",
    "flatbuffers>=23.5,<26", "protobuf>=4.25.3,<5", "sounddevice>=0.4.4,<1",
)  # fmt: skip
"""What its pose and holistic models import, as in ``supply.detectors``."""
PROBE = "import mediapipe; mediapipe.solutions.pose.Pose(); mediapipe.solutions.holistic"
STAGES = ("Making the environment", "Installing MediaPipe", "Installing what it needs", "Testing")


def main(folder: Path, wheels: Path | None) -> int:
    """Make the environment and return the exit code."""
    progress(0)
    try:
        venv.create(folder, clear=True, with_pip=True)
    except (OSError, subprocess.CalledProcessError) as error:
        return fail(f"The environment could not be made: {error}", folder, "Check the free space and the rights there.")
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    source = [] if wheels is None else ["--no-index", "--find-links", str(wheels)]
    pip = [str(python), "-m", "pip", "install", "--disable-pip-version-check", "--no-input", *source]
    for number, command in enumerate(([*pip, "--no-deps", MEDIAPIPE], [*pip, *IMPORTED]), start=1):
        progress(number)
        if wrong := run(command):
            where = "the folder of wheels" if wheels is not None else "the package registry that pip is set up for"
            return fail(
                f"A package could not be installed from {where}: {wrong}", folder, "See the log, then try again."
            )
    progress(3)
    if wrong := run([str(python), "-c", PROBE]):
        return fail(f"MediaPipe is installed and does not start: {wrong}", folder, "See the log.")
    write({"event": "result", "python": str(python)})
    return 0


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
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None))
