"""Live: a body that moves while points come, shown by a timer; stopped by a button, and recorded to be solved."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import bpy

from ..._exchange.errors import FileMissing, MocapError
from ...conventions.file_paths import absolute, stored
from ...conventions.numbered import next_path
from ...review.live_doubt import show_doubt
from ..locations import files_folder, usable
from ..preferences import chosen_python
from ..sending_properties import allowed_address, sending_options
from .base import MocapOperator

if TYPE_CHECKING:
    from ...scene.live_face import LiveFace
    from ...scene.live_figure import LiveFigure
    from ...solving.live import LiveRun

_INTERVAL_S = 1 / 60
"""Seconds from one look to the next: with the time that a look takes, more than 30 a second."""
"""Seconds from one look at new poses to the next: thirty a second are drawn."""


class CurrentLive:
    """The live run of this Blender, and what shows it; there is at most one."""

    def __init__(self) -> None:
        self.run: LiveRun | None = None
        self.figure: LiveFigure | None = None
        self.on_recorded: Callable[[str], None] | None = None
        """Called with the recording at the end."""
        self.face: LiveFace | None = None
        """What the face of another program moves."""
        self.of_sensors = False
        """Whether the run, or the last one, is of the Rig panel's sensors; else it is of the Live panel."""
        self.failure = ""
        self.recorded = ""
        """The take that the last run recorded, as the scene stores paths."""

    @property
    def busy(self) -> bool:
        """Whether a run is under way."""
        return self.run is not None

    def begin(
        self, run: LiveRun, scene: bpy.types.Scene, *, body: bool = True,
        on_recorded: Callable[[str], None] | None = None, face: LiveFace | None = None,
    ) -> None:  # fmt: skip
        """Show a run in a scene from now on, with a body or points alone; say where it recorded to at its end.

        Only sensors' runs take ``on_recorded``: their recording is a folder of the rig's.

        Raises:
            MocapError, RuntimeError: what shows it cannot be made; the run is ended.
        """
        import numpy as np

        from ...body.body_file import default_body_path, read_body
        from ...scene.live_figure import create_live_figure

        try:
            figure = create_live_figure(scene, read_body(default_body_path()), np.zeros(10), shown=body)
        except (MocapError, RuntimeError):
            run.process.kill()
            raise
        self.run, self.figure, self.on_recorded, self.of_sensors = run, figure, on_recorded, on_recorded is not None
        self.face = face
        self.failure = self.recorded = ""
        if not bpy.app.timers.is_registered(self.tick):
            bpy.app.timers.register(self.tick, first_interval=_INTERVAL_S)

    def tick(self) -> float | None:
        """Show the newest pose; return seconds until the next look, None at the end."""
        run, figure = self.run, self.figure
        if run is None or figure is None:
            return None
        pose = run.poll()
        if run.betas is not None and not (run.betas == figure.betas).all():
            figure.reshape(run.betas)
        if pose is not None:
            if self.face is not None and pose.face:
                self.face.show(pose.face)
            there = figure.show_points(pose.points, pose.off_m)
            if pose.rotvec is not None and pose.transl is not None:
                there = figure.pose(pose.rotvec, pose.transl) and there
                if there and pose.sigma_m is not None:
                    show_doubt(bpy.data.objects[figure.armature], pose.sigma_m, unsure=pose.state == "unsure")
            if not there and not run.process.cancelling:
                self.failure = "The live body was taken away (by undo, or deleted): the run was stopped."
                run.stop()
        if run.finished:
            self._ended(run)
        if pose is not None or run.finished:
            _redraw()
        return None if self.run is None else _INTERVAL_S

    def _ended(self, run: LiveRun) -> None:
        self.failure = self.failure or run.failure
        recorded, on_recorded = "" if run.recorded is None else stored(run.recorded), self.on_recorded
        self.run = self.on_recorded = None
        if on_recorded is None:
            self.recorded = recorded
        else:
            on_recorded(recorded)

    def abandon(self) -> None:
        """End the run at once; for leaving a file or switching the add-on off."""
        if bpy.app.timers.is_registered(self.tick):
            bpy.app.timers.unregister(self.tick)
        if self.run is not None:
            self.run.process.kill()
            self.run.process.wait()
        self.run = self.figure = self.on_recorded = self.face = None
        self.failure = self.recorded = ""


live = CurrentLive()


@bpy.app.handlers.persistent
def before_load(*_: object) -> None:
    """End the run when another file is opened."""
    live.abandon()


class MOCAP_OT_live_start(MocapOperator, bpy.types.Operator):
    """Starts the live run."""

    bl_idname = "mocap.live_start"
    bl_label = "Start Live"
    bl_description = "Let a body move as markers or poses come: from a recording at its own rate, or another program"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One run at a time, in object mode, and something to replay or to listen at."""
        settings = context.scene.mocap.live
        source = settings.listen if settings.kind == "VMC" else source_of(context.scene)
        return may_begin(cls, context, source, "Choose a recording of markers or a motion, or import one")

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start the solver's process and make what shows it."""
        from ..._exchange.motion_file import is_motion
        from ...scene.live_face import LiveFace, read_face_table
        from ...solving.live import start_live

        scene, settings = context.scene, context.scene.mocap.live
        options, subject, face = sending_options(settings), settings.subject, None
        if settings.kind == "VMC":
            source, suffix = str(allowed_address(settings.listen)), ".npz"
            require_there(subject, settings.face_table)
            if settings.face_mesh:
                table = read_face_table(absolute(settings.face_table)) if settings.face_table else {}
                face = LiveFace(settings.face_mesh, table)
        else:
            require_there(source_of(scene), subject)
            source = absolute(source_of(scene))
            suffix = "" if is_motion(source) else ".c3d"  # a motion that is replayed is there already
            subject = subject if suffix else ""
        folder = usable(files_folder(scene))
        record = next_path(folder, "live", suffix) if settings.record and suffix else None
        run = start_live(
            source, chosen_python(context), folder, subject=absolute(subject) if subject else None, record=record,
            options=options,
        )  # fmt: skip
        live.begin(run, scene, face=face)
        return {"FINISHED"}


class MOCAP_OT_live_stop(bpy.types.Operator):
    """Stops the live run."""

    bl_idname = "mocap.live_stop"
    bl_label = "Stop"
    bl_description = "End the live run; what it recorded is written first"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a run."""
        return live.busy

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask the process to end."""
        if live.run is not None:
            live.run.stop()
        return {"FINISHED"}


def may_begin(operator: type[bpy.types.Operator], context: bpy.types.Context, source: object, without: str) -> bool:
    """Return whether a live run may begin: one at a time, in object mode, from a source; or say why not."""
    why = without if not source else ""
    why = "Change to object mode first" if context.mode != "OBJECT" else why
    why = "Live is running; stop it first" if live.busy else why
    if why:
        operator.poll_message_set(why)
    return not why


def require_there(*paths: str) -> None:
    """Raise ``FileMissing`` for the first path that is given and not there."""
    for path in paths:
        if path and not absolute(path).exists():
            raise FileMissing("It is not there.", where=absolute(path).name, hint="Choose another one.")


def source_of(scene: bpy.types.Scene) -> str:
    """Return the recording to replay: the chosen one, or that of the capture if it has markers; "" if none."""
    capture = scene.mocap.capture
    return scene.mocap.live.source or (capture.source if len(capture.marker_items) else "")


def _redraw() -> None:
    """Let panels and viewports show what is new."""
    for window in bpy.context.window_manager.windows if bpy.context.window_manager else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


CLASSES = (MOCAP_OT_live_start, MOCAP_OT_live_stop)
