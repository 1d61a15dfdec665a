"""Choose a detector, run it in a separate process, and validate its output."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import numpy as np

from solver_backend.exchange.errors import CommandLineInvalid, MocapError
from solver_backend.exchange.joint_sets import HAND_COLUMNS, NUM_HAND_POINTS
from solver_backend.exchange.json_file import read_json_file
from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.plausible import FARTHEST_PX
from solver_backend.exchange.schema import Shape, fits
from solver_backend.exchange.video_settings import DETECTORS, LARGEST_DESCRIPTION, MEDIAPIPE
from solver_backend.types import JointSet


class DetectorMissing(MocapError):
    """No detector is installed, or the given Python or model file does not contain one."""


class DetectorOutputsUnknown(MocapError):
    """The model's inputs and outputs match no known detector."""


class DetectorFailed(MocapError):
    """The detector process ended with an error."""


_LARGEST_HEAD, _LARGEST_ANSWER, _MOST_ARRAYS = 1 << 20, 1 << 24, 32  # Largest line and array in bytes, and array count.
READY_S, ANSWER_S = 300.0, 60.0  # Time limits in s for starting and detecting. Large models on slow machines take 10 s.
_LOG_BYTES = 1 << 16  # Number of bytes read from the end of a detector's log.
_POSE: dict[str, Shape] = {"keypoints": (None, None, 3)}
_HAND: dict[str, Shape] = {"points": (NUM_HAND_POINTS, 2), "presence": (1,), "right": (1,)}
"""Arrays in an answer about a body or a hand, and their shapes. None allows any length."""


class AnswerInvalid(ValueError):
    """A detector's answer violates the protocol."""


def read_head(stream: IO[bytes]) -> dict[str, Any]:
    """Read the next line of a detector's output as a JSON object. Raise ``EOFError`` if it is truncated."""
    line = stream.readline(_LARGEST_HEAD)
    if not line.endswith(b"\n"):
        raise AnswerInvalid("a line is too long") if len(line) == _LARGEST_HEAD else EOFError("a line is cut off")
    try:
        head = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise AnswerInvalid("a line is not JSON") from error
    if not isinstance(head, dict):
        raise AnswerInvalid("a line is not a JSON object")
    return head


def read_arrays(head: dict[str, Any], stream: IO[bytes]) -> dict[str, np.ndarray]:
    """Read the float32 arrays announced in a detector's JSON line. Raise ``EOFError`` if they are truncated."""
    shapes = head.get("arrays")
    if not isinstance(shapes, dict) or len(shapes) > _MOST_ARRAYS:
        raise AnswerInvalid("a line announces no arrays")
    return {name: _array(shape, stream) for name, shape in shapes.items()}


def _array(shape: Any, stream: IO[bytes]) -> np.ndarray:
    if not isinstance(shape, list) or not all(type(n) is int and 0 <= n < 1 << 24 for n in shape) or len(shape) > 8:
        raise AnswerInvalid(f"{str(shape)[:60]} is not a shape")
    size = 4 * math.prod(shape)
    if size > _LARGEST_ANSWER:
        raise AnswerInvalid("an array is too large")
    if len(data := stream.read(size)) < size:
        raise EOFError("an array is cut off")
    with np.errstate(invalid="ignore"):  # signalling NaNs would cause warnings
        return np.frombuffer(data, "<f4").reshape(shape).astype(np.float64)


PYTHON_VARIABLE = "MANIFOLD_MOCAP_DETECTOR_PYTHON"  # Environment variable that contains the path of MediaPipe's Python.
WORKER = ".py"  # File suffix of a user-written detector.
_ROOT = Path(__file__).resolve().parents[3]
_MADE = _ROOT / ".venv-mediapipe" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
"""Python interpreter that ``dev.py detectors`` installs next to the project's environment."""
PACKAGES_VARIABLE = "MANIFOLD_MOCAP_PACKAGES"  # Environment variable that contains the extension's wheel folder.
INCLUDED = _ROOT / "detector"  # Folder of the models in an extension that includes a detector.
POSE_MODEL, HAND_MODEL = "pose_landmark_full.tflite", "hand_landmark_full.tflite"
_MODULES = {".onnx": "onnx_pose", ".tflite": "litert_pose"}  # Worker module for each model suffix.
DESCRIPTION, _DESCRIBED = ".json", "described_pose"  # File suffix of a model description, and the worker that reads it.
_MEDIAPIPE_POINTS = 39  # Number of points in MediaPipe's landmark model: 33 body points and 6 for internal use.
HINT = (
    "In Blender, use Set Up Detector in the From Videos panel, or install the extension that includes a detector. "
    "Otherwise, specify a Python that has MediaPipe 0.10.21 with --python."
)


def check_answer(found: dict[str, np.ndarray], about: dict[str, Any] | None) -> dict[str, np.ndarray]:
    """Validate a detector's arrays. Impossible points become NaN with confidence 0.

    Args:
        about: description of the detector, or None for a hand detector.
    """
    expected = dict(_HAND if about is None else _POSE)
    if "hands" in found and about is not None:
        expected["hands"] = (len(found.get("keypoints", ())), 2, NUM_HAND_POINTS, 3)
    for name, shape in expected.items():
        array = found.get(name)
        if array is None:
            raise AnswerInvalid(f"it has no '{name}'")
        if not fits(array.shape, shape):
            raise AnswerInvalid(f"'{name}' has the shape {array.shape}")
    if about is not None and found["keypoints"].shape[1] < (count := joint_set_of(about).num_keypoints):
        raise AnswerInvalid(f"it has {found['keypoints'].shape[1]} keypoints instead of {count}")
    if about is None:
        good = all(bool((np.abs(found[name]) < FARTHEST_PX).all()) for name in expected)
        return {name: found[name] if good else np.zeros_like(found[name]) for name in expected}
    possible = {name: (np.abs(found[name]) < FARTHEST_PX).all(-1, keepdims=True) for name in expected}
    return {name: np.where(possible[name], found[name], np.array([np.nan, np.nan, 0.0])) for name in expected}


def joint_set_of(about: dict[str, Any]) -> JointSet:
    """Return the joint set that a detector's description states, or the one that its keypoint count implies."""
    if about.get("joint_set") in list(JointSet):
        return JointSet(about["joint_set"])
    count = about.get("num_keypoints", 0)
    fitting = [s for s in JointSet.fitting(count) if s is not JointSet.H36M_17] if type(count) is int else []
    if not fitting:
        message = f"The model finds {str(count)[:20]} keypoints, which does not match any known joint set."
        hint = "Use a model with 17 (COCO), 26 (Halpe), 33 (MediaPipe) or 133 (COCO WholeBody) keypoints."
        raise DetectorOutputsUnknown(message, where=plain(str(about.get("name", "")))[:200], hint=hint)
    return fitting[0]


def included_model(name: str) -> Path | None:
    """Return the path of a model that the extension includes, or None if the model or LiteRT is missing."""
    path = INCLUDED / name
    return path if path.is_file() and find_spec("ai_edge_litert") is not None else None


@dataclass(frozen=True)
class DetectorChoice:
    """A detector and the Python interpreter that runs it."""

    module: str  # Module in ``pose_workers``, or the path of a user-written worker (``.py``).
    python: Path
    options: dict[str, Any]
    one_hand: bool = False  # True if it detects the points of one hand in a crop, not people.

    @property
    def program(self) -> list[str]:
        """Python arguments that start the detector. The options follow them."""
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
    """Choose a detector by name or by model file.

    Args:
        name: one of ``DETECTORS``, or the path of a model: RTMPose, RTMO, YOLO-pose or MoveNet in ONNX format,
            MediaPipe in LiteRT format, or a description of any other model.
        python: interpreter to use. By default, MediaPipe runs in its own environment if there is one. All other
            detectors, and the MediaPipe models in the extension, run in our interpreter.
        hands: also detect hands if the detector supports it. The included detector only detects bodies.
        worker: a user-written program that replaces the detector (see ``pose_workers.serve``).
    """
    own_python = _interpreter(python)
    if people < 1:
        raise CommandLineInvalid(f"The detector cannot search for {people} people.", hint="Use --people 1 or more.")
    options: dict[str, Any] = {"people": people}
    if worker is not None:
        there = worker if worker.suffix == WORKER else Path()
        path = _existing(there, "There is no such worker.", str(worker), "Specify a file that ends in .py.")
        return DetectorChoice(os.path.abspath(path), own_python, {**options, "hands": hands})
    ours = python is None and name.lower() == MEDIAPIPE and not _is_set_up(environment)
    if ours and (model := included_model(POSE_MODEL)) is not None:
        return DetectorChoice(_MODULES[".tflite"], own_python, {**options, "model": str(model)})
    if (named := DETECTORS.get(name.lower())) is not None:
        python = _mediapipe_python(environment) if python is None and named.own_environment else own_python
        return DetectorChoice(named.worker, python, {**options, "hands": hands})
    module = _MODULES.get(Path(name).suffix.lower())
    if Path(name).suffix.lower() == DESCRIPTION:
        return DetectorChoice(_DESCRIBED, own_python, {**options, **_described(Path(name))})
    if module is None:
        endings = " or ".join([*_MODULES, DESCRIPTION])
        hint = f"Use --detector {' or '.join(DETECTORS)}, or the path of a model that ends in {endings}."
        raise CommandLineInvalid(f"'{name}' is not a known detector.", hint=hint)
    return DetectorChoice(module, own_python, {**options, "model": _model(Path(name))})


def chosen_hand_detector(model: Path, *, python: Path | None = None) -> DetectorChoice:
    """Choose MediaPipe's hand model, run by LiteRT.

    Args:
        model: ``hand_landmark_full.tflite`` from the npm package @mediapipe/hands.
        python: interpreter that has ai-edge-litert. The default is our own.
    """
    python, options = _interpreter(python), {"model": _model(model), "one_hand": True}
    return DetectorChoice(_MODULES[".tflite"], python, options, one_hand=True)


def _existing(path: Path, message: str, where: str, hint: str) -> Path:
    if not os.path.isfile(path):  # unlike Path.is_file, raises no error for a name that is too long
        raise DetectorMissing(message, where=where, hint=hint)
    return path


def _interpreter(python: Path | None) -> Path:
    if python is None:
        return Path(sys.executable)
    return _existing(python, "There is no such Python.", str(python), "Check the path of --python.")


def _model(path: Path) -> str:
    return os.path.abspath(_existing(path, "There is no such model.", str(path), "Check the path."))


def _described(path: Path) -> dict[str, Any]:
    """Read a model description. Return it with the model's path and the keypoint counts that its joint set allows."""
    description = read_json_file(path, LARGEST_DESCRIPTION)
    name = description.get("model") if isinstance(description, dict) else None
    if not isinstance(name, str) or not name:
        hint = f"Write the name of a file that ends in {' or '.join(_MODULES)}."
        raise DetectorOutputsUnknown("The description does not specify a model.", where=str(path), hint=hint)
    if Path(name.replace("\\", "/")).name != name or Path(name).suffix.lower() not in _MODULES:
        hint = f"Write the name of a file next to the description that ends in {' or '.join(_MODULES)}."
        raise DetectorOutputsUnknown(f"{plain(name)[:60]} is not the name of a model.", where=str(path), hint=hint)
    if description.get("joint_set") not in list(JointSet):
        message = f"The joint set {str(description.get('joint_set'))[:60]} is not known."
        raise DetectorOutputsUnknown(message, where=str(path), hint=f"Choose one of {', '.join(JointSet)}.")
    joint_set = JointSet(description["joint_set"])
    counts = [joint_set.num_keypoints, *(n for known, n in HAND_COLUMNS if known is joint_set)]
    counts += [_MEDIAPIPE_POINTS] if joint_set is JointSet.MEDIAPIPE_33 else []
    return {"description": description, "counts": counts, "model": _model(path.parent / name)}


def _mediapipe_python(environment: Mapping[str, str]) -> Path:
    if named := environment.get(PYTHON_VARIABLE):
        return _existing(Path(named), f"{PYTHON_VARIABLE} is not the path of a Python.", named, HINT)
    return _existing(_MADE, "No detector is installed.", str(_MADE.parents[1]), HINT)


def _is_set_up(environment: Mapping[str, str]) -> bool:
    """Return whether MediaPipe has a separate Python environment."""
    return bool(environment.get(PYTHON_VARIABLE)) or _MADE.is_file()


CHILD = Path(__file__).with_name("child")
_ERRORS: dict[str, type[MocapError]] = {kind.code: kind for kind in (DetectorMissing, DetectorOutputsUnknown)}


class DetectorProcess:
    """A detector that runs in a separate process. Use it as a context manager.

    A detector that does not answer in time is restarted once per image.

    Args:
        threads: number of threads that the detector's model uses.

    Raises:
        DetectorMissing: the chosen Python does not start, or has no detector installed.
        DetectorOutputsUnknown: the model has an unknown format.
        DetectorFailed: the detector crashed, did not answer, or gave unusable answers.
    """

    def __init__(self, choice: DetectorChoice, threads: int = 1) -> None:
        self._choice, self._threads = choice, threads
        self._log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it exists as long as the process
        self._late = self._ended = False
        self._start()

    def _start(self) -> None:
        environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONHOME", "PYTHONSTARTUP")}
        python, pipe = self._choice.python, subprocess.PIPE
        ours = environment.get(PACKAGES_VARIABLE, "") if python == Path(sys.executable) else ""
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(CHILD), ours]))
        environment |= {"PYTHONDONTWRITEBYTECODE": "1", "POSE_WORKER_THREADS": str(self._threads)}
        command = [str(python), *self._choice.program, json.dumps(self._choice.options)]
        try:
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=self._log, env=environment)
        except OSError as error:
            self._log.close()
            message = f"The detector's Python cannot be started: {error.strerror}."
            raise DetectorMissing(message, where=str(python), hint="Check the path of --python.") from error
        assert self._process.stdin is not None and self._process.stdout is not None
        self._pictures, self._answers = self._process.stdin, self._process.stdout
        if self._ended:  # ended by another thread during the restart of a detector that did not answer
            self._kill()

    def __enter__(self) -> DetectorProcess:
        try:
            self.about: dict[str, Any] = self._hello()
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def end(self) -> None:
        """Kill the process. Any thread may call this repeatedly."""
        self._ended = True
        self._kill()

    def _kill(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()

    def _close(self) -> None:
        self.end()
        self._close_streams(self._pictures, self._answers, self._log)

    @staticmethod
    def _close_streams(*streams: IO[bytes]) -> None:
        for stream in streams:
            with suppress(OSError):
                stream.close()

    @contextmanager
    def _within(self, seconds: float) -> Iterator[None]:
        self._late = False
        timer = threading.Timer(seconds, self._time_out)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
        if self._late:  # the answer arrived while the process was being killed
            raise EOFError("the response arrived too late")

    def _time_out(self) -> None:
        self._late = True
        self._kill()

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Run the detector on an image (H, W, 3) uint8. Return its arrays (see ``check_answer``)."""
        for again in (True, False):
            try:
                with self._within(ANSWER_S):
                    self._pictures.write(json.dumps({"shape": rgb.shape, "time_s": time_s}).encode() + b"\n")
                    self._pictures.write(np.ascontiguousarray(rgb).data)
                    self._pictures.flush()
                    found = read_arrays(read_head(self._answers), self._answers)
                return check_answer(found, None if self._choice.one_hand else self.about)
            except (OSError, EOFError, AnswerInvalid) as error:
                if not (self._late and again) or self._ended:
                    raise self._broken(error, ANSWER_S) from error
                self._close_streams(self._pictures, self._answers)
                self._start()
                self.about = self._hello()
        raise AssertionError

    def _hello(self) -> dict[str, Any]:
        try:
            with self._within(READY_S):
                head = read_head(self._answers)
            if "error" in head:
                if not isinstance(head["error"], dict):
                    raise AnswerInvalid("its error is not a JSON object")
                code, message, hint = (str(head["error"][key]) for key in ("code", "message", "hint"))
                where = str(self._choice.options.get("model", self._choice.python))
                raise _ERRORS.get(code, DetectorFailed)(plain(message), where=where, hint=plain(hint))
            about = head["ready"]
            if not isinstance(about, dict) or not isinstance(about.get("name"), str):
                raise AnswerInvalid("the detector does not describe itself")
        except (OSError, EOFError, AnswerInvalid, KeyError, TypeError) as error:
            raise self._broken(error, READY_S) from error
        if not self._choice.one_hand:
            joint_set_of(about)
        return {**about, "name": plain(about["name"])[:200]}

    def _broken(self, error: Exception, seconds: float) -> DetectorFailed:
        late = self._late
        self.end()
        self._log.seek(max(self._log.seek(0, os.SEEK_END) - _LOG_BYTES, 0))
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        last = plain(lines[-1])[:300] if lines else "it wrote nothing"
        if late:
            message = f"The detector did not respond for {seconds:g} s: {last}"
        elif isinstance(error, OSError | EOFError):
            message = f"The detector process ended (exit code {self._process.returncode}): {last}"
        else:
            message = f"The detector's response cannot be used: {plain(str(error))[:200]} ({last})"
        hint = "Run the command again, which skips finished videos. If it fails again, try another detector or Python."
        return DetectorFailed(message, where=str(self._choice.python), hint=hint)
