"""Errors of the add-on. Errors shared with the solver are in ``_exchange.errors``."""

from __future__ import annotations

from ._exchange.errors import BackendMissing, ErrorEvent, ExitCode, MocapError


class Broken:
    """Mixin for errors that are not caused by the user's input."""

    exit_code = ExitCode.FAILED


class SolverMissing(Broken, BackendMissing):
    """The solver's files or its interpreter are missing."""


class BodyMissing(MocapError):
    """The motion's body file is missing."""


class BodyMismatch(MocapError):
    """The motion was solved for a body other than the one to bake."""


class BodyUnreachable(MocapError):
    """The body cannot be selected because its collection is hidden or excluded."""


class NothingToExport(MocapError):
    """There is nothing to export, or the armature lacks required data."""


class ExporterMissing(Broken, MocapError):
    """This Blender was built without the format's exporter, or the exporter is disabled."""


class ExportFailed(Broken, MocapError):
    """Blender's exporter failed or wrote no file."""


class RenderFailed(Broken, MocapError):
    """Blender rendered nothing because a graphics driver or a video format is missing."""


class PythonUnsuitable(MocapError):
    """The Python chosen for the solver does not start, is too old, or lacks NumPy."""


class TakeMissing(MocapError):
    """The object has no solved motion to review or to solve again."""


class MapInvalid(MocapError):
    """A rig's bone map or preset is damaged or unknown, or names too few bones of the rig."""


class TargetUnsuitable(MocapError):
    """The target rig cannot play a person's motion without changes."""


class ActorMissing(MocapError):
    """There is no body or other armature with a motion to retarget from."""


class SolverStopped(MocapError):
    """The solver ended with an error. This exception has that error's code."""

    def __init__(self, event: ErrorEvent, exit_code: int) -> None:
        super().__init__(event.get("message", ""), where=event.get("where", ""), hint=event.get("hint", ""))
        self.code = event.get("code", "error")
        passed_on = ExitCode.USAGE, ExitCode.BAD_INPUT, ExitCode.CANCELLED
        self.exit_code = ExitCode(exit_code) if exit_code in passed_on else ExitCode.FAILED


class SolverDied(MocapError):
    """The solver's process ended without a message."""


class SolverNotUnderstood(MocapError):
    """Another program or another version of the solver wrote the process's output."""


class WindowClosed(MocapError):
    """The window that started a run was closed, so its result cannot be shown."""


class TakeTooSlow(Broken, MocapError):
    """A take of a batch exceeded its time limit."""


class TakeTooLarge(Broken, MocapError):
    """A take of a batch exceeded its memory limit."""


class ImportStopped(MocapError):
    """Importing a file of another program exceeded its memory or time limit."""


class BatchInvalid(MocapError):
    """A batch has no captures, or unreadable settings."""

    exit_code = ExitCode.USAGE


class EngineMissing(Broken, MocapError):
    """The package for distributing a batch is missing."""


class SchedulerMissing(Broken, MocapError):
    """No scheduler of a compatible version answers."""


class WorkersUnsuitable(Broken, MocapError):
    """There are no workers, or no worker can process the batch."""


class BatchTaken(Broken, MocapError):
    """Another batch is using the same results folder."""


class TakeUndoable(Broken, MocapError):
    """A take of a batch crashed every worker that tried it."""


class ShotsMissing(Broken, MocapError):
    """The workers could not render some shots of a data set."""


class BlenderMissing(Broken, MocapError):
    """The command needs a Python with Blender's module."""


class BakeFailed(Broken, MocapError):
    """An unexpected error occurred. The log contains its location."""
