"""A detector's process: started, fed with pictures, ended; what goes wrong in it has a name here."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.plain_text import plain
from solver_backend.videos.detect.answers import read_arrays, read_head
from solver_backend.videos.detect.choice import DetectorChoice
from solver_backend.videos.detect.errors import DetectorFailed, DetectorMissing, DetectorOutputsUnknown

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
