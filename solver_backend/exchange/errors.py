"""Define the named errors. Each states what happened, where, what is valid and what to try."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import IntEnum
from typing import NotRequired, TypedDict

from .early_signals import CANCELLED
from .plain_text import plain


class ExitCode(IntEnum):
    """Exit codes of the program."""

    RESULT = 0  # The program returned a result.
    USAGE = 2  # The command line, the job file or a setting is wrong.
    BAD_INPUT = 3
    """A file is missing, damaged or unusable, an output exists or cannot be written, or a strict solve has warnings."""
    FAILED = 4  # The solver or another part that does the work failed.
    CANCELLED = CANCELLED  # The user or a signal stopped the work. No file is left incomplete.


class ErrorEvent(TypedDict):
    """The ``error`` event of the progress protocol."""

    event: NotRequired[str]
    code: str
    message: str
    where: str
    hint: str


class MocapError(Exception):
    """Base class of all errors that are reported to users.

    Args:
        message: one sentence about what happened and what was expected.
        where: file, frame, camera, joint or marker concerned, or "" if none.
        hint: one sentence about what to try.
    """

    code = "error"  # Stable identifier in the progress stream: the class below ``MocapError`` in snake case.
    exit_code = ExitCode.BAD_INPUT  # Exit code of the command line.
    hint = ""  # Remedy for this class, used if an error does not state its own.

    def __init_subclass__(cls) -> None:
        if cls.__base__ is MocapError:
            cls.code = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def __init__(self, message: str, *, where: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.where = str(where)
        self.hint = hint or self.hint

    def __str__(self) -> str:
        return sentence(self.as_event())

    def as_event(self) -> ErrorEvent:
        """Return the error as the ``error`` event of the progress protocol."""
        return {"event": "error", "code": self.code, "message": self.message, "where": self.where, "hint": self.hint}


def sentence(event: Mapping[str, object]) -> str:
    """Return an ``error`` event as one line: what happened (where). Remedy."""
    message, where = str(event.get("message") or ""), event.get("where")
    if where:
        statement = message.rstrip(".")
        message = f"{statement} ({where}){message[len(statement) :]}".lstrip()
    return plain(" ".join(part for part in (message, str(event.get("hint") or "")) if part))


class CaptureNotRecognised(MocapError):
    """The file or folder is not a capture in a supported format."""


class CalibrationMissing(MocapError):
    """A multi-view capture has no camera calibration."""


class CalibrationMismatch(MocapError):
    """The calibration and the recording have different camera names."""


class CalibrationInvalid(MocapError):
    """The calibration describes an impossible camera."""

    hint = "Correct the calibration, or export it again."


class TooFewViews(MocapError):
    """Fewer than two cameras have detections."""


class FrameCountMismatch(MocapError):
    """The cameras recorded different numbers of frames."""


class NotSynchronised(MocapError):
    """With --sync on, the views do not confirm that the cameras are synchronised."""


class KeypointCountMismatch(MocapError):
    """The number of keypoints does not match the joint set."""


class FileMissing(MocapError):
    """A file is missing."""


class FileDamaged(MocapError):
    """The file is truncated, has another format, or is missing required parts."""

    hint = "Correct the file, or export it again."


class NonFiniteData(MocapError):
    """Required numbers are missing or infinite."""

    hint = "Correct these numbers, or export the file again."


class NoDetections(MocapError):
    """The detections are empty, or no two cameras see a person."""


class PersonUnknown(MocapError):
    """The capture has no person with this name."""


class RefinementUseless(MocapError):
    """A refinement did not improve the cameras."""


class MarkersUnknown(MocapError):
    """The markers have no labels, or labels that are not in any known layout."""


class MarkersMirrored(MocapError):
    """The markers form the mirror image of a person."""


class SubjectInvalid(MocapError):
    """The subject file is for another body or other markers, or contains impossible values."""

    hint = "Write the subject file again with markers calibrate."


class TakeTooShort(MocapError):
    """The take has fewer frames than the method needs."""


class OutputExists(MocapError):
    """The output exists. Use --overwrite to replace it."""


class OutputNotWritable(MocapError):
    """The output folder cannot be written to."""


class JobInvalid(MocapError):
    """The job file or a setting has an unknown key or an invalid value."""

    exit_code = ExitCode.USAGE


class BodyInvalid(MocapError):
    """The body file has missing keys, or arrays with wrong shapes or values."""

    hint = "Choose another body file, or see docs/reference/body-file.md."


class BodyUnknown(MocapError):
    """There is no body with this name, or no file at this path."""


class UnsafePickle(MocapError):
    """The pickle file requests code that no body model needs."""


class WeightsInvalid(MocapError):
    """The prior's weights are for another body, version or architecture."""

    hint = "Train the weights again, or reinstall the program."


class PriorInvalid(MocapError):
    """The pose prior contradicts itself or the body."""


class TrainingMismatch(MocapError):
    """The checkpoint and the run that continues it have different settings."""


class PoseInvalid(MocapError):
    """Poses have the wrong shape or are not rotations."""


class MotionInvalid(MocapError):
    """The motion file has missing keys or impossible values."""

    hint = "Choose another motion, or write it again."


class CaptureInvalid(MocapError):
    """The capture file has impossible or contradictory values."""

    hint = "Write the capture again with convert."


class BackendMissing(MocapError):
    """The solver, its array library or its Python interpreter is missing."""


class WarningsRefused(MocapError):
    """A solve with --strict raised warnings."""


class ResultRefused(MocapError):
    """The result is unusable, for example because no person is that size."""


class Cancelled(MocapError):
    """The user cancelled the work."""

    exit_code = ExitCode.CANCELLED


class ShapeMismatch(MocapError):
    """Two arrays that belong together have different shapes."""


class SchedulerUnsafe(MocapError):
    """The connection to a scheduler on another host is not encrypted and authenticated."""


class CommandLineInvalid(MocapError):
    """The command line has an unknown verb or option, or a required one is missing."""

    exit_code = ExitCode.USAGE


class SolverFailed(MocapError):
    """The program has a defect or ran out of memory."""

    exit_code = ExitCode.FAILED


def describe_exit_codes(bad_input: str, failed: str, more: str = "") -> str:
    """Return the last part of a command line's help text: the exit codes and the output with ``--json``.

    ``bad_input`` and ``failed`` explain the exit codes 3 and 4. ``more`` is additional text.
    """
    return f"""\
exit codes:
  0    there is a result
  2    the command line, the job file or a setting is wrong
  3    {bad_input}
  4    {failed}
  130  cancelled (Ctrl-C or a termination signal). Nothing is half-written
  other codes, such as 1: the program could not start, or the system ended it
{more}
With --json, standard output has one JSON object per line: any number of {{"event": "progress", ...}} and then exactly
one {{"event": "result", ...}} or {{"event": "error", "code": ..., "message": ..., "where": ..., "hint": ...}}.
"""
