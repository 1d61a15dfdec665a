"""Choose a detector, run it in its own process and check what it answers."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from solver_backend.exchange.detectors import DETECTORS, MEDIAPIPE
from solver_backend.exchange.errors import CommandLineInvalid, MocapError
from solver_backend.exchange.plain_text import plain


class DetectorMissing(MocapError):
    """No detector is installed, or the Python or model that was named has none."""

    code = "detector_missing"


class DetectorOutputsUnknown(MocapError):
    """A model's inputs and outputs are of no kind we can read."""

    code = "detector_outputs_unknown"


class DetectorFailed(MocapError):
    """The detector's process broke."""

    code = "detector_failed"


_LARGEST_HEAD, _LARGEST_ANSWER = 1 << 20, 1 << 24
_MOST_ARRAYS = 32
"""Arrays that a detector's answer may hold; chosen by hand."""


def read_head(stream: IO[bytes]) -> dict[str, Any]:
    """Return the object of the next line.

    Raises:
        ValueError: the line is longer than a MiB, cut off, or no JSON object.
    """
    line = stream.readline(_LARGEST_HEAD)
    try:
        head = json.loads(line)
    except RecursionError as error:
        raise ValueError("the line is nested too deeply") from error
    if not isinstance(head, dict):
        raise ValueError("the line is not an object")
    return head


def read_arrays(head: dict[str, Any], stream: IO[bytes]) -> dict[str, np.ndarray]:
    """Return the arrays that a line announces in ``arrays``: their shapes by name; the bytes are little-endian float32.

    Raises:
        ValueError: it announces none, too many or too large ones, or their bytes are cut off.
    """
    shapes = head.get("arrays")
    if not isinstance(shapes, dict) or len(shapes) > _MOST_ARRAYS:
        raise ValueError("the line announces no arrays")
    return {name: _array(shape, stream) for name, shape in shapes.items()}


def _array(shape: Any, stream: IO[bytes]) -> np.ndarray:
    if not isinstance(shape, list) or not all(type(n) is int and 0 <= n < 1 << 24 for n in shape) or len(shape) > 8:
        raise ValueError(f"{str(shape)[:60]} is not a shape")
    size = 4 * math.prod(shape)
    if size > _LARGEST_ANSWER or len(data := stream.read(size)) < size:
        raise ValueError("an array is too large or cut off")
    return np.frombuffer(data, "<f4").reshape(shape).astype(np.float64)


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


CHILD = Path(__file__).with_name("child")
_ERRORS: dict[str, type[MocapError]] = {kind.code: kind for kind in (DetectorMissing, DetectorOutputsUnknown)}


class DetectorProcess:
    """A detector in a process of its own, as a context manager.

    Raises:
        DetectorMissing: its Python does not start, or lacks the detector.
        DetectorOutputsUnknown: the model is of no kind we can read.
        DetectorFailed: it broke; the message ends with the last line it wrote.
    """

    def __init__(self, choice: DetectorChoice) -> None:
        self._choice = choice
        self._log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONHOME", "PYTHONSTARTUP")}
        environment |= {"PYTHONPATH": str(CHILD), "PYTHONDONTWRITEBYTECODE": "1"}
        command = [str(choice.python), *choice.program, json.dumps(choice.options)]
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, env=environment
            )
        except OSError as error:
            self._log.close()
            raise DetectorMissing(
                f"The detector's Python does not start: {error.strerror}.", where=str(choice.python),
                hint="Check the path of --python.",
            ) from error  # fmt: skip
        assert self._process.stdin is not None and self._process.stdout is not None
        self._pictures: IO[bytes] = self._process.stdin
        self._answers: IO[bytes] = self._process.stdout

    def __enter__(self) -> DetectorProcess:
        try:
            self.about: dict[str, Any] = self._hello()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def end(self) -> None:
        """End the process, whatever it is doing; may be called from another thread and several times."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()

    def _close(self) -> None:
        """End the process and close what led to it; for the thread that talks to it alone."""
        self.end()
        for stream in (self._pictures, self._answers, self._log):
            with suppress(OSError):
                stream.close()

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return what the detector finds in a picture, see ``PoseDetector.detect``.

        Args:
            rgb: (H, W, 3) uint8.
            time_s: when it was filmed.
        """
        try:
            self._pictures.write(json.dumps({"shape": rgb.shape, "time_s": time_s}).encode() + b"\n")
            self._pictures.write(np.ascontiguousarray(rgb).data)
            self._pictures.flush()
        except OSError as error:
            raise self._broken() from error
        try:
            return read_arrays(read_head(self._answers), self._answers)
        except ValueError as error:
            raise self._broken() from error

    def _hello(self) -> dict[str, Any]:
        """Return what the process states of itself, once its detector is ready."""
        try:
            head = read_head(self._answers)
            if "error" in head:
                code, message, hint = (str(head["error"][key]) for key in ("code", "message", "hint"))
                where = str(self._choice.options.get("model", self._choice.python))
                raise _ERRORS.get(code, DetectorFailed)(plain(message), where=where, hint=plain(hint))
            if not isinstance(head["ready"], dict):
                raise TypeError("the detector does not describe itself")
            return head["ready"]
        except (ValueError, KeyError, TypeError) as error:
            raise self._broken() from error

    def _broken(self) -> DetectorFailed:
        self.end()
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        message = plain(lines[-1])[:300] if lines else "it wrote nothing"
        return DetectorFailed(
            f"The detector's process ended (exit code {self._process.returncode}): {message}",
            where=str(self._choice.python),
            hint="Run again; finished videos are kept. If it ends again, try another detector or Python.",
        )
