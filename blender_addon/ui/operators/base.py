"""Shapes of operators: one undo step, one sentence where something is wrong, what they need first, what is dropped."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy.app.handlers import persistent

from ..._exchange.errors import MocapError, sentence
from ...errors import WindowClosed
from ..preferences import chosen_python
from ..project_files import following

if TYPE_CHECKING:
    from ...solving.run import Run

if TYPE_CHECKING:
    Operator, FileHandler = bpy.types.Operator, bpy.types.FileHandler
else:
    Operator = FileHandler = object  # Blender's own stands beside a mixin, not above it


class MocapOperator(Operator):
    """Mixin of operators that change the scene in one undo step; ``work`` does what the operator is for.

    Modules that do the work are imported there, not at the top: registering loads no arrays and no solver.
    """

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do the work, or report what is wrong."""
        try:
            return self.work(context)
        except MocapError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def work(self, context: bpy.types.Context) -> set[str]:
        """Do what the operator is for and return its answer.

        Raises:
            MocapError: it cannot be done.
        """
        raise NotImplementedError


class NeedsBody(MocapOperator):
    """Mixin of operators on the solved body."""

    edits_body = False
    """Whether the body is changed, which one that is linked from another file does not allow."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a body."""
        return _there(cls, context.scene.mocap.review.armature)


class NeedsTake(NeedsBody):
    """Mixin of operators on the take the body plays."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a solved take."""
        review = context.scene.mocap.review
        return _there(cls, review.armature, review.take)


class ViewportDrop(FileHandler):
    """Mixin of what takes files that are dropped on the 3D viewport."""

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Only there."""
        return context.area is not None and context.area.type == "VIEW_3D"


def _there(operator: type[NeedsBody], armature: bpy.types.Object | None, *more: bpy.types.ID | None) -> bool:
    if armature is None or None in more:
        operator.poll_message_set("Solve a capture first")
        return False
    if operator.edits_body and not armature.is_editable:
        operator.poll_message_set("This body is linked: choose Object > Library Override > Make first")
        return False
    return True


_INTERVAL_S = 0.1
_REDRAW_S = 1.0
"""Least time between two redraws of progress: on a slow screen they would take time from the solver."""


class Current:
    """The run that is under way and the one before; there is at most one of each in a Blender."""

    def __init__(self) -> None:
        self.run: Run | None = None
        self.last: Run | None = None
        self.about: tuple[str, str] = ("", "")
        """Scene and capture file that the last run was about: nowhere else is its outcome shown."""

    @property
    def busy(self) -> bool:
        """Whether a run is under way."""
        return self.run is not None

    def finish(self) -> None:
        """Keep the run as the last one."""
        self.run, self.last = None, self.run
        following.solver_reads = False

    def lose(self, scene: bpy.types.Scene, error: MocapError) -> None:
        """End the run at once and keep why, for the scene that it was started in."""
        if self.run is not None:
            self.run.process.kill()
            self.run.error = error.as_event()
            self.finish()
            self.about = _subject(scene)

    def abandon(self) -> None:
        """End the run at once and forget everything; for leaving a file or switching the add-on off."""
        if self.run is not None:
            self.run.process.kill()
        self.run = self.last = None
        following.solver_reads = False

    def last_for(self, scene: bpy.types.Scene, verbs: tuple[str, ...]) -> Run | None:
        """Return the last run if it did one of these verbs, for this scene and the capture that its panels show."""
        if self.busy or self.last is None or self.last.verb not in verbs or self.about != _subject(scene):
            return None
        return self.last


current = Current()


def _subject(scene: bpy.types.Scene) -> tuple[str, str]:
    return scene.name, scene.mocap.capture.file


@persistent
def after_load(*_: object) -> None:
    """Forget the runs of the file before; what went wrong there is no fault of this one."""
    current.abandon()
    following.failure = ""


class SolverOperator(MocapOperator):
    """Mixin of modal operators that start the solver; ``received`` takes its result.

    Escape is not taken: the run is cancelled by the panel's button alone.
    """

    is_of_capture = True
    """Its run belongs to the capture that panels were about when it started, whatever is active when it ends."""
    _held = -1
    _timer: bpy.types.Timer | None = None
    _shown = 0.0
    _scene = ""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One run at a time."""
        if current.busy:
            cls.poll_message_set("The solver is running; wait or cancel first")
            return False
        return True

    def received(self, context: bpy.types.Context, result: Any) -> set[str]:
        """Take the result into the scene and return the operator's answer."""
        raise NotImplementedError

    def rescue(self, context: bpy.types.Context) -> str:
        """Take what a run that failed has finished into the scene, and report it in a sentence; "" if there is nothing.

        Raises:
            MocapError: what is there cannot be read.
        """
        return ""

    def launch(self, context: bpy.types.Context, verb: str, arguments: list[str], folder: Path) -> set[str]:
        """Start the solver and follow it; without a window, wait for it.

        Raises:
            MocapError: it cannot be started.
        """
        from ...solving.run import start

        self._hold(context)
        return self.follow(context, start(verb, arguments, chosen_python(context), folder))

    def follow(self, context: bpy.types.Context, run: Run) -> set[str]:
        """Follow a run that was started; without a window, wait for it."""
        if not self._scene:
            self._hold(context)
        current.run = run
        following.solver_reads = True
        if bpy.app.background:
            run.process.wait()
            while not run.finished:
                run.poll()
            return self._ended(context)
        manager = context.window_manager
        self._timer = manager.event_timer_add(_INTERVAL_S, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _hold(self, context: bpy.types.Context) -> None:
        """Keep in mind what the run belongs to."""
        self._scene = context.scene.name
        self._held = context.scene.mocap.capture_index if self.is_of_capture else -1

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Poll on each tick; every other event passes through."""
        run = current.run
        if run is None:  # abandoned
            self._stop_timer(context)
            _show(context, None)
            return {"CANCELLED"}
        if event.type == "TIMER" and run.poll() and time.monotonic() - self._shown > _REDRAW_S:
            self._shown = time.monotonic()
            _show(context, f"Motion capture: {run.headline} ({run.share:.0%})")
        if not run.finished:
            return {"PASS_THROUGH"}
        self._stop_timer(context)
        return self._ended(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """End the run when Blender closes the window or opens another file; other windows show why."""
        self._stop_timer(context)
        hint = "Start it again from a window that stays open."
        error = WindowClosed("The run ended: the window in which it was started was closed.", hint=hint)
        scene = bpy.data.scenes.get(self._scene)
        current.abandon() if scene is None else current.lose(scene, error)

    def _ended(self, context: bpy.types.Context) -> set[str]:
        """Take the outcome into the scene the run was started in, whichever is shown now."""
        scene, shown, window = bpy.data.scenes.get(self._scene), context.scene, context.window
        if scene is None or scene == shown or window is None:
            return self._outcome(context)
        window.scene = scene
        try:
            return self._outcome(context)
        finally:
            window.scene = shown

    def _outcome(self, context: bpy.types.Context) -> set[str]:
        context.scene.mocap.held = self._held
        try:
            return self._taken_in(context)
        finally:
            current.about = _subject(context.scene)
            context.scene.mocap.held = -1

    def _taken_in(self, context: bpy.types.Context) -> set[str]:
        run = current.run
        assert run is not None
        current.finish()
        _show(context, None)
        try:
            if run.result is not None:
                return self.received(context, run.result)
            error = run.error or {}
            if error.get("code") == "cancelled":
                self.report({"INFO"}, sentence(error))
            elif rescued := self.rescue(context):
                self.report({"WARNING"}, f"{sentence(error)} {rescued}")
                return {"FINISHED"}
            else:
                self.report({"ERROR"}, sentence(error))
        except MocapError as error:
            run.error = error.as_event()
            self.report({"ERROR"}, str(error))
        return {"CANCELLED"}

    def _stop_timer(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None


class OfCapture(SolverOperator):
    """Mixin of operators that work on the capture."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a capture."""
        if not context.scene.mocap.capture.file:
            cls.poll_message_set("Import a capture first")
            return False
        return super().poll(context)


class OfTake(SolverOperator):
    """Mixin of operators that work on the solved take."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a solved take."""
        if context.scene.mocap.review.take is None:
            cls.poll_message_set("Solve the capture first")
            return False
        return super().poll(context)


class MOCAP_OT_cancel(bpy.types.Operator):
    """Ends the run under way."""

    bl_idname = "mocap.cancel"
    bl_label = "Cancel"
    bl_description = "End the run under way; nothing is left half-written and earlier takes stay"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while there is a run."""
        return current.busy

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask the solver to end; its operator notices."""
        if current.run is not None:
            current.run.cancel()
        return {"FINISHED"}


class MOCAP_OT_dismiss(bpy.types.Operator):
    """Takes the outcome of the last run off the panels."""

    bl_idname = "mocap.dismiss"
    bl_label = "Dismiss"
    bl_description = "Remove this message; the log is removed with it"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only what is over."""
        return current.last is not None and not current.busy

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Forget it."""
        current.last = None
        return {"FINISHED"}


def _show(context: bpy.types.Context, status: str | None) -> None:
    """Redraw the sidebars, and write a line into the status bar or give it back."""
    for window in context.window_manager.windows:
        if not bpy.app.background:
            window.workspace.status_text_set(status)
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" else ():
                if region.type == "UI":  # the view itself may be slow to draw
                    region.tag_redraw()
