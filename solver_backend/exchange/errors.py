"""Named errors: what happened, where, what would be valid and what to try."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import NotRequired, TypedDict

from .early_signals import CANCELLED
from .plain_text import plain


class ErrorEvent(TypedDict):
    """The ``error`` event of the progress protocol."""

    event: NotRequired[str]
    code: str
    message: str
    where: str
    hint: str


class MocapError(Exception):
    """Base of every error a user can cause or meet.

    Args:
        message: one sentence that states what happened and what was expected.
        where: file, frame, camera, joint or marker it concerns ("" if none).
        hint: one sentence that states what to try.
    """

    code = "error"
    """Stable identifier, written to the progress stream."""

    def __init__(self, message: str, *, where: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.where = str(where)
        self.hint = hint

    def __str__(self) -> str:
        return sentence(self.as_event())

    def as_event(self) -> ErrorEvent:
        """Return the error as the ``error`` event of the progress protocol."""
        return {"event": "error", "code": self.code, "message": self.message, "where": self.where, "hint": self.hint}


def sentence(event: Mapping[str, object]) -> str:
    """Return an ``error`` event as one line: what happened, where, what to try."""
    where = f"({event['where']})" if event.get("where") else ""
    return plain(" ".join(str(part) for part in (event.get("message"), where, event.get("hint")) if part))


class CaptureNotRecognised(MocapError):
    """The path is not a capture of any format we read."""

    code = "capture_not_recognised"


class CalibrationMissing(MocapError):
    """No camera calibration was found for a multi-view capture."""

    code = "calibration_missing"


class CalibrationMismatch(MocapError):
    """The calibration names other cameras than the recording."""

    code = "calibration_mismatch"


class CalibrationInvalid(MocapError):
    """A camera is impossible: rotation not orthonormal, focal length not positive, and the like."""

    code = "calibration_invalid"


class TooFewViews(MocapError):
    """Fewer than two cameras have detections."""

    code = "too_few_views"


class FrameCountMismatch(MocapError):
    """The cameras recorded different numbers of frames."""

    code = "frame_count_mismatch"


class NotSynchronised(MocapError):
    """Synchronisation is required, and the views do not confirm any."""

    code = "not_synchronised"


class KeypointCountMismatch(MocapError):
    """The number of keypoints does not fit the joint set."""

    code = "keypoint_count_mismatch"


class FileMissing(MocapError):
    """A file that was asked for is not there."""

    code = "file_missing"


class FileDamaged(MocapError):
    """A file is truncated, of another format than its name states, or lacks required fields."""

    code = "file_damaged"


class NonFiniteData(MocapError):
    """NaN or infinite values stand where numbers are required."""

    code = "non_finite_data"


class NoDetections(MocapError):
    """Nothing was detected: every confidence is zero, or nobody is seen by two cameras."""

    code = "no_detections"


class PersonUnknown(MocapError):
    """The capture shows nobody of this name."""

    code = "person_unknown"


class RefinementUseless(MocapError):
    """Cameras corrected by the people they film fit these no better."""

    code = "refinement_useless"


class MarkersUnknown(MocapError):
    """Optical markers have no labels, or labels that no layout knows."""

    code = "markers_unknown"


class MarkersMirrored(MocapError):
    """Optical markers are a mirror image of a body's."""

    code = "markers_mirrored"


class SubjectInvalid(MocapError):
    """A subject file is of another body or other markers than the take, or its values are impossible."""

    code = "subject_invalid"


class TakeTooShort(MocapError):
    """The take has fewer frames than the method needs."""

    code = "take_too_short"


class OutputExists(MocapError):
    """The output is already there and will not be overwritten."""

    code = "output_exists"


class OutputNotWritable(MocapError):
    """The output folder cannot be written to."""

    code = "output_not_writable"


class JobInvalid(MocapError):
    """The job file or a setting has an unknown key, a wrong type or an impossible value."""

    code = "job_invalid"


class BodyInvalid(MocapError):
    """A body model file lacks keys, or its arrays have the wrong shapes or values."""

    code = "body_invalid"


class BodyUnknown(MocapError):
    """No body has the name that was asked for, or there is no file at its path."""

    code = "body_unknown"


class UnsafePickle(MocapError):
    """A pickle asks for a class or function that a body model has no business with."""

    code = "unsafe_pickle"


class WeightsInvalid(MocapError):
    """Prior weights are for another body, version or architecture."""

    code = "weights_invalid"


class PriorInvalid(MocapError):
    """A pose prior does not fit its own joints or codes, or not the body."""

    code = "prior_invalid"


class TrainingMismatch(MocapError):
    """A checkpoint was made with other settings than the run that wants to go on from it."""

    code = "training_mismatch"


class PoseInvalid(MocapError):
    """Poses or rotations have the wrong shape, are not finite or are off SO(3)."""

    code = "pose_invalid"


class MotionInvalid(MocapError):
    """A motion file lacks keys, or its arrays disagree or hold impossible values."""

    code = "motion_invalid"


class CaptureInvalid(MocapError):
    """The arrays of a capture file disagree or hold impossible values."""

    code = "capture_invalid"


class BackendMissing(MocapError):
    """The chosen array backend, the solver or a Python to run it with is not there."""

    code = "backend_missing"


class WarningsRefused(MocapError):
    """A solve that was to be strict has warnings."""

    code = "warnings_refused"


class ResultRefused(MocapError):
    """A solve's result is surely useless: nobody has that size, or the views contradict each other."""

    code = "result_refused"


class Cancelled(MocapError):
    """The user cancelled the work."""

    code = "cancelled"


class ShapeMismatch(MocapError):
    """Two arrays that are compared, or an array and what it stands for, have different shapes."""

    code = "shape_mismatch"


class SchedulerUnsafe(MocapError):
    """A scheduler is on another host, and the connection to it would be neither encrypted nor authenticated."""

    code = "scheduler_unsafe"


class CommandLineInvalid(MocapError):
    """The command line names an unknown verb or option, or lacks one."""

    code = "command_line_invalid"


class SolverFailed(MocapError):
    """The solver itself broke: a defect of the program or a machine out of memory, not of the input."""

    code = "solver_failed"


class ExitCode(IntEnum):
    """How a run ended."""

    RESULT = 0
    """There is a result."""
    USAGE = 2
    """The command line, the job file or a setting is wrong."""
    BAD_INPUT = 3
    """A file is missing, damaged or unusable, the output cannot be written, or a strict solve has warnings."""
    FAILED = 4
    """The solver, or what else does the work, failed."""
    CANCELLED = CANCELLED
    """The user, or a signal, ended the work; nothing was left half-written."""

    @classmethod
    def of(cls, error: MocapError) -> ExitCode:
        """Return the exit code of a named error."""
        if isinstance(error, Cancelled):
            return cls.CANCELLED
        if isinstance(error, SolverFailed):
            return cls.FAILED
        return cls.USAGE if isinstance(error, CommandLineInvalid | JobInvalid) else cls.BAD_INPUT


def describe_exit_codes(bad_input: str, failed: str, more: str = "") -> str:
    """Return the end of a command line's help.

    Args:
        bad_input: what 3 stands for.
        failed: what 4 stands for.
        more: lines below the table.
    """
    return f"""\
exit codes:
  0    there is a result
  2    the command line, the job file or a setting is wrong
  3    {bad_input}
  4    {failed}
  130  cancelled (Ctrl-C or a termination signal); nothing was left half-written
{more}
With --json, standard output carries one JSON object a line: any number of {{"event": "progress", ...}} and then exactly
one {{"event": "result", ...}} or {{"event": "error", "code": ..., "message": ..., "where": ..., "hint": ...}}.
"""
