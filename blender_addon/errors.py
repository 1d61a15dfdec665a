"""The add-on's own errors. Errors of both programs are in ``_exchange.errors``."""

from __future__ import annotations

from ._exchange.errors import BackendMissing, ErrorEvent, ExitCode, MocapError


class Broken:
    """Mixin of errors that the input did not cause."""

    exit_code = ExitCode.FAILED


class SolverMissing(Broken, BackendMissing):
    """The solver's files or its interpreter are not there."""


class BodyMissing(MocapError):
    """The file of the body a motion was solved for is not there."""


class BodyMismatch(MocapError):
    """The motion was solved for another body than the one to bake."""


class BodyUnreachable(MocapError):
    """The body is in the scene and cannot be selected: its collection is hidden or excluded."""


class NothingToExport(MocapError):
    """There is no armature, motion or frame to export, or the format asks for more than the armature has."""


class ExporterMissing(Broken, MocapError):
    """This Blender was built without a format, or its exporter is switched off."""


class ExportFailed(Broken, MocapError):
    """Blender's exporter refused, or wrote nothing."""


class RenderFailed(Broken, MocapError):
    """Blender rendered nothing: no graphics driver, or a video format is missing."""


class PythonUnsuitable(MocapError):
    """The Python chosen for the solver does not start, is too old or lacks NumPy."""


class TakeMissing(MocapError):
    """The object to review or to solve again has no solved motion."""


class MapInvalid(MocapError):
    """A rig's map or preset is damaged, unknown, or names too few bones of the rig."""


class TargetUnsuitable(MocapError):
    """The rig to retarget to cannot play a person's motion without changes."""


class ActorMissing(MocapError):
    """There is no body of ours with a motion to retarget from."""


class SolverStopped(MocapError):
    """The solver ended with an error. Its code is kept, and its exit code if the user can act on it."""

    def __init__(self, event: ErrorEvent, exit_code: int) -> None:
        super().__init__(event.get("message", ""), where=event.get("where", ""), hint=event.get("hint", ""))
        self.code = event.get("code", "error")
        passed_on = ExitCode.USAGE, ExitCode.BAD_INPUT, ExitCode.CANCELLED
        self.exit_code = ExitCode(exit_code) if exit_code in passed_on else ExitCode.FAILED


class SolverDied(MocapError):
    """The solver's process ended without a message."""


class SolverNotUnderstood(MocapError):
    """Another program, or another version of the solver, wrote in the solver's place."""


class WindowClosed(MocapError):
    """The window that started a run is closed, so its result cannot be shown."""


class TakeTooSlow(Broken, MocapError):
    """A take of a batch took longer than it may."""


class TakeTooLarge(Broken, MocapError):
    """A take of a batch took more memory than it may."""


class ImportStopped(MocapError):
    """The import of a file of another program took more memory or time than it may."""


class BatchInvalid(MocapError):
    """A batch has no captures, or unreadable settings."""

    exit_code = ExitCode.USAGE


class EngineMissing(Broken, MocapError):
    """A batch was to be spread by a program that is not installed."""


class SchedulerMissing(Broken, MocapError):
    """No scheduler answers, or none that this program understands."""


class WorkersUnsuitable(Broken, MocapError):
    """There are no workers, or none of them can do the batch's takes."""


class BatchTaken(Broken, MocapError):
    """Another batch works in the same folder of results."""


class TakeUndoable(Broken, MocapError):
    """A take of a batch has ended every worker that tried it."""


class ShotsMissing(Broken, MocapError):
    """The workers failed to render some shots of a data set."""


class BlenderMissing(Broken, MocapError):
    """The command was started by a Python without Blender's module."""


class BakeFailed(Broken, MocapError):
    """An unexpected fault. The log has its place."""
