"""Named errors of the add-on: what happened, where, and what to try."""

from __future__ import annotations

from collections.abc import Mapping


class AddonError(Exception):
    """Base of every error a user of the add-on can cause or meet.

    Args:
        message: one sentence that says what happened and what was expected.
        where: file, camera or joint it concerns ("" if none).
        hint: one sentence that says what to try ("" if none).
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

    def as_event(self) -> dict[str, str]:
        """Return the error as the ``error`` event of the progress protocol."""
        return {"event": "error", "code": self.code, "message": self.message, "where": self.where, "hint": self.hint}


class FileMissing(AddonError):
    """A file that was asked for is not there."""

    code = "file_missing"


class FileDamaged(AddonError):
    """A file is truncated, of another format than expected, or lacks required arrays."""

    code = "file_damaged"


class MotionInvalid(AddonError):
    """The arrays of a motion file disagree or hold impossible values."""

    code = "motion_invalid"


class CaptureInvalid(AddonError):
    """The arrays of a capture file disagree or hold impossible values."""

    code = "capture_invalid"


class BodyInvalid(AddonError):
    """A body file has wrong shapes, another tree or values that are not finite."""

    code = "body_invalid"


class BodyMissing(AddonError):
    """The file of the body a motion was solved for is not there."""

    code = "body_missing"


class BodyMismatch(AddonError):
    """The motion was solved for another body than the one to bake."""

    code = "body_mismatch"


class OutputExists(AddonError):
    """An output is already there and is not overwritten."""

    code = "output_exists"


class OutputNotWritable(AddonError):
    """The output folder cannot be written to."""

    code = "output_not_writable"


class NothingToExport(AddonError):
    """There is no armature, motion or frame to export, or the format asks for more than the armature has."""

    code = "nothing_to_export"


class ExporterMissing(AddonError):
    """This Blender was built without a format, or its exporter is switched off."""

    code = "exporter_missing"


class ExportFailed(AddonError):
    """Blender's exporter refused, or wrote nothing."""

    code = "export_failed"


class RenderFailed(AddonError):
    """Blender rendered nothing: no graphics driver, or a video format is missing."""

    code = "render_failed"


class BackendMissing(AddonError):
    """The solver, or a Python to run it with, is not there."""

    code = "backend_missing"


class PythonUnsuitable(AddonError):
    """The Python chosen for the solver does not start, is too old or lacks NumPy."""

    code = "python_unsuitable"


class TakeMissing(AddonError):
    """What was to be reviewed or solved again has no solved motion."""

    code = "take_missing"


class SolverStopped(AddonError):
    """The solver ended with an error; code and exit code are its own.

    Args:
        event: the ``error`` event.
        exit_code: of the process.
    """

    def __init__(self, event: dict[str, str], exit_code: int) -> None:
        super().__init__(event.get("message", ""), where=event.get("where", ""), hint=event.get("hint", ""))
        self.code = event.get("code", "error")
        self.exit_code = exit_code


class BatchInvalid(AddonError):
    """A batch has no captures, or its settings cannot be read."""

    code = "batch_invalid"


class BlenderMissing(AddonError):
    """The command was started by a Python without Blender's module."""

    code = "blender_missing"


class BakeFailed(AddonError):
    """Something broke that nobody foresaw; the log holds where."""

    code = "bake_failed"


class Cancelled(AddonError):
    """The user cancelled the work."""

    code = "cancelled"


def sentence(event: Mapping[str, str]) -> str:
    """Return an ``error`` event as one line: what happened, where, what to try."""
    where = f"({event['where']})" if event.get("where") else ""
    return " ".join(part for part in (event.get("message", ""), where, event.get("hint", "")) if part)
