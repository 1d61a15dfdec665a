"""The errors that only the add-on raises; those that the solver raises, too, are in ``_exchange.errors``."""

from __future__ import annotations

from ._exchange.errors import ErrorEvent, MocapError


class BodyMissing(MocapError):
    """The file of the body a motion was solved for is not there."""

    code = "body_missing"


class BodyMismatch(MocapError):
    """The motion was solved for another body than the one to bake."""

    code = "body_mismatch"


class BodyUnreachable(MocapError):
    """The body is in the scene and cannot be selected: its collection is hidden or excluded."""

    code = "body_unreachable"


class NothingToExport(MocapError):
    """There is no armature, motion or frame to export, or the format asks for more than the armature has."""

    code = "nothing_to_export"


class ExporterMissing(MocapError):
    """This Blender was built without a format, or its exporter is switched off."""

    code = "exporter_missing"


class ExportFailed(MocapError):
    """Blender's exporter refused, or wrote nothing."""

    code = "export_failed"


class RenderFailed(MocapError):
    """Blender rendered nothing: no graphics driver, or a video format is missing."""

    code = "render_failed"


class PythonUnsuitable(MocapError):
    """The Python chosen for the solver does not start, is too old or lacks NumPy."""

    code = "python_unsuitable"


class TakeMissing(MocapError):
    """What was to be reviewed or solved again has no solved motion."""

    code = "take_missing"


class MapInvalid(MocapError):
    """A rig's map or preset is damaged, unknown, or names too few bones of the rig."""

    code = "map_invalid"


class TargetUnsuitable(MocapError):
    """The rig to retarget to cannot play a person's motion as it is."""

    code = "target_unsuitable"


class ActorMissing(MocapError):
    """There is no body of ours with a motion to retarget from."""

    code = "actor_missing"


class SolverStopped(MocapError):
    """The solver ended with an error; code and exit code are its own.

    Args:
        event: the ``error`` event.
        exit_code: of the process.
    """

    def __init__(self, event: ErrorEvent, exit_code: int) -> None:
        super().__init__(event.get("message", ""), where=event.get("where", ""), hint=event.get("hint", ""))
        self.code = event.get("code", "error")
        self.exit_code = exit_code


class WindowClosed(MocapError):
    """The window in which a run was started is closed, and with it what follows the run."""

    code = "window_closed"


class TakeTooSlow(MocapError):
    """A take of a batch took longer than it may."""

    code = "take_too_slow"


class TakeTooLarge(MocapError):
    """A take of a batch took more memory than it may."""

    code = "take_too_large"


class BatchInvalid(MocapError):
    """A batch has no captures, or its settings cannot be read."""

    code = "batch_invalid"


class EngineMissing(MocapError):
    """A batch was to be spread by a program that is not installed."""

    code = "engine_missing"


class SchedulerMissing(MocapError):
    """No scheduler answers, or none that this program understands."""

    code = "scheduler_missing"


class WorkersUnsuitable(MocapError):
    """There are no workers, or none of them can do the batch's takes."""

    code = "workers_unsuitable"


class BatchTaken(MocapError):
    """Another batch works in the same folder of results."""

    code = "batch_taken"


class TakeUndoable(MocapError):
    """A take of a batch has ended every worker that tried it."""

    code = "take_undoable"


class ShotsMissing(MocapError):
    """Some shots of a data set could not be made by the workers."""

    code = "shots_missing"


class BlenderMissing(MocapError):
    """The command was started by a Python without Blender's module."""

    code = "blender_missing"


class BakeFailed(MocapError):
    """Something broke that nobody foresaw; the log holds where."""

    code = "bake_failed"
