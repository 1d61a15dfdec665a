"""Which detector, in which Python, with which options."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solver_backend.exchange.detectors import DETECTORS, MEDIAPIPE
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.videos.detect.errors import DetectorMissing

PYTHON_VARIABLE = "MANIFOLD_MOCAP_DETECTOR_PYTHON"
"""Environment variable that names the Python that has MediaPipe."""
WORKER = ".py"
"""How the file of a detector of the user's own ends."""
ENVIRONMENT = ".venv-mediapipe"
"""Folder that ``dev.py detectors`` makes beside the project's own environment."""
_MODULES = {".onnx": "onnx_pose", ".tflite": "litert_pose"}
"""Worker of a model, by how its file ends."""
HINT = (
    "Set Up Detector in Blender's panel From Videos makes one; or name a Python that has MediaPipe 0.10.21: --python."
)


@dataclass(frozen=True)
class DetectorChoice:
    """A detector that can be started."""

    module: str
    """Module of ``pose_workers``, or the path of a worker of the user's own, which ends in ``.py``."""
    python: Path
    """The Python it runs in."""
    options: dict[str, Any]
    """What it gets as JSON when it starts."""

    @property
    def program(self) -> list[str]:
        """What the Python is started with, before the options."""
        return [self.module] if self.module.endswith(WORKER) else ["-m", f"pose_workers.{self.module}"]


def chosen_detector(
    name: str = MEDIAPIPE,
    *,
    python: Path | None = None,
    people: int = 1,
    hands: bool = False,
    worker: Path | None = None,
    environment: Mapping[str, str] = os.environ,
) -> DetectorChoice:
    """Return the detector of a name.

    Args:
        name: one of ``DETECTORS``, or the path of a model: RTMPose, RTMO, YOLO-pose or MoveNet in ONNX, MediaPipe in
            LiteRT.
        python: Python to run it in; else the environment for MediaPipe, or our own for a model.
        people: people looked for in a picture.
        hands: also find hands, where the detector can.
        worker: a program of the user's own that is asked instead (see ``pose_workers.serve``).
        environment: the process's environment variables.

    Raises:
        CommandLineInvalid: the name is neither.
        DetectorMissing: there is no such model, worker or Python, or no environment for MediaPipe.
    """
    if python is not None and not python.is_file():
        raise DetectorMissing("There is no such Python.", where=str(python), hint="Check the path of --python.")
    if people < 1:
        raise CommandLineInvalid(f"{people} people cannot be looked for.", hint="--people 1, or more.")
    options: dict[str, Any] = {"people": people}
    if worker is not None:
        if worker.suffix != WORKER or not worker.is_file():
            raise DetectorMissing("There is no such worker.", where=str(worker), hint="Name a file that ends in .py.")
        own = {**options, "hands": hands}
        return DetectorChoice(os.path.abspath(worker), python or Path(sys.executable), own)
    if (named := DETECTORS.get(name.lower())) is not None:
        python = python or (_mediapipe_python(environment) if named.own_environment else Path(sys.executable))
        return DetectorChoice(named.worker, python, {**options, "hands": hands})
    model = Path(name)
    module = _MODULES.get(model.suffix.lower())
    if module is None:
        endings = " or ".join(_MODULES)
        hint = f"--detector {' or '.join(DETECTORS)}, or the path of a model that ends in {endings}."
        raise CommandLineInvalid(f"'{name}' is not a known detector.", hint=hint)
    if not model.is_file():
        raise DetectorMissing("There is no such model.", where=str(model), hint="Check the path.")
    return DetectorChoice(module, python or Path(sys.executable), {**options, "model": os.path.abspath(model)})


def chosen_hand_detector(model: Path, *, python: Path | None = None) -> DetectorChoice:
    """Return MediaPipe's hand model run by LiteRT.

    Args:
        model: ``hand_landmark_full.tflite``, which the user takes from the npm package @mediapipe/hands.
        python: Python that has ai-edge-litert; our own if None.

    Raises:
        DetectorMissing: there is no such model or Python.
    """
    if python is not None and not python.is_file():
        raise DetectorMissing("There is no such Python.", where=str(python), hint="Check the path of --python.")
    if not model.is_file():
        raise DetectorMissing("There is no such model.", where=str(model), hint="Check the path.")
    return DetectorChoice("litert_hands", python or Path(sys.executable), {"model": os.path.abspath(model)})


def _mediapipe_python(environment: Mapping[str, str]) -> Path:
    named = environment.get(PYTHON_VARIABLE)
    if named:
        if not Path(named).is_file():
            raise DetectorMissing(f"{PYTHON_VARIABLE} names no Python.", where=named, hint=HINT)
        return Path(named)
    folder = Path(__file__).resolve().parents[3] / ENVIRONMENT
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.is_file():
        raise DetectorMissing("No detector is installed.", where=str(folder), hint=HINT)
    return python
