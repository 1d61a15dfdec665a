"""Create MediaPipe's environment next to the project's: ``python -m supply.detectors``.

MediaPipe's wheel 0.10.21 includes a pose model that runs offline (Apache-2.0). It requires an OpenCV that is not
headless and packages that its pose model does not use. So it is installed without its requirements, but with the
packages that its pose model imports, and pip's warning about this is disabled. Packages come from pip's registry, and
nothing else is downloaded.
"""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / ".venv-mediapipe"
MEDIAPIPE = "mediapipe==0.10.21"
IMPORTED = (
    "numpy>=1.26,<2", "opencv-contrib-python-headless>=4.10,<4.12", "absl-py>=2,<3", "attrs>=23", "matplotlib>=3.8,<4",
    "flatbuffers>=23.5,<26", "protobuf>=4.25.3,<5", "sounddevice>=0.4.4,<1",
)  # fmt: skip
"""Packages that MediaPipe's pose and holistic models import."""
PROBE = "import mediapipe; mediapipe.solutions.pose.Pose(); mediapipe.solutions.holistic"
OLDEST, NEWEST = (3, 9), (3, 12)
"""Oldest and newest Python with MediaPipe wheels."""


def main(folder: Path = FOLDER) -> int:
    """Create the environment unless it already works, and return the exit code."""
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if works(python):
        sys.stdout.write(f"MediaPipe is ready: {python}\n")
        return 0
    if not OLDEST <= sys.version_info[:2] <= NEWEST:
        sys.stderr.write(f"MediaPipe's wheel is for Python 3.9 to 3.12, not {sys.version.split()[0]}.\n")
        return 1
    sys.stdout.write(f"Making {folder.name} (once)\n")
    venv.create(folder, clear=True, with_pip=True)
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-warn-conflicts"]
    for command in ([*pip, "--no-deps", MEDIAPIPE], [*pip, *IMPORTED]):
        if subprocess.call(command) != 0:
            sys.stderr.write("A package could not be installed, see above. Check the network and call again.\n")
            return 1
    if not works(python):
        sys.stderr.write(f"MediaPipe is installed and does not start: {python} -c '{PROBE}' reports why.\n")
        return 1
    sys.stdout.write(f"MediaPipe is ready: {python}\n")
    return 0


def works(python: Path) -> bool:
    """Return whether a Python can start MediaPipe's pose model."""
    return python.is_file() and subprocess.run([str(python), "-c", PROBE], capture_output=True).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
