"""Live: a body, and a character, that move while points or poses come; stopped by a button, and recorded."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from shlex import split
from typing import TYPE_CHECKING

import bpy

from ..._exchange.errors import FileMissing, MocapError
from ..._exchange.vmc.address import FACES, PORTS
from ...conventions.file_paths import absolute, stored
from ...conventions.naming import next_path
from ..acquisition_properties import allowed_address, sending_options
from ..preferences import chosen_python, detector_for
from ..project_files import files_folder, usable
from .base import MocapOperator
from .retarget import chosen_target, table_map

if TYPE_CHECKING:
    from ...body.body_file import BodyFile
    from ...retarget.live_rig import LiveRig
    from ...scene.live_figure import LiveFace, LiveFigure
    from ...solving.live import LiveRun

_INTERVAL_S = 1 / 60
"""Seconds from one look at new poses to the next: with the time that a look takes, more than 30 a second."""
_PANELS_S = 0.25
"""Seconds from one time that panels are drawn to the next: nobody reads figures that change faster."""


class CurrentLive:
    """The live run of this Blender, and what shows it; there is at most one."""

    def __init__(self) -> None:
        self.run: LiveRun | None = None
        self.figure: LiveFigure | None = None
        self.on_recorded: Callable[[str], None] | None = None
        """Called with the recording at the end."""
        self.face: LiveFace | None = None
        """What the face of another program moves."""
        self.character: LiveRig | None = None
        """The rig that stands as the body does."""
        self.of_sensors = False
        """Whether the run, or the last one, is of the Rig panel's sensors; else it is of the Live panel."""
        self._panels_drawn = 0.0
        self.failure = ""
        self.recorded = ""
        """The take that the last run recorded, as the scene stores paths."""

    @property
    def busy(self) -> bool:
        """Whether a run is under way."""
        return self.run is not None

    def begin(
        self, run: LiveRun, scene: bpy.types.Scene, *, body: bool = True, fingers: bool = False,
        on_recorded: Callable[[str], None] | None = None, face: LiveFace | None = None,
        character: Callable[[BodyFile], LiveRig] | None = None,
    ) -> None:  # fmt: skip
        """Show a run in a scene from now on, with a body or points alone; report where it recorded to at its end.

        Points and cameras give no fingers, and a body without them is drawn in half the time.

        Only sensors' runs take ``on_recorded``: their recording is a folder of the rig's.

        Raises:
            MocapError, RuntimeError: what shows it cannot be made; the run is ended.
        """
        import numpy as np

        from ...body.body_file import default_body_path, read_body
        from ...body.looks import show_look
        from ...conventions.skeleton import SMPL, SMPL_HANDS
        from ...scene.live_figure import create_live_figure

        try:
            own = read_body(default_body_path(), SMPL_HANDS if fingers else SMPL)
            rig = None if character is None else character(own)
            figure = create_live_figure(scene, own, np.zeros(10), shown=body)
            show_look(bpy.data.objects[figure.mesh], scene.mocap.look)
        except (MocapError, RuntimeError):
            run.process.kill()
            run.process.wait()
            raise
        self.run, self.figure, self.on_recorded, self.of_sensors = run, figure, on_recorded, on_recorded is not None
        self.face, self.character = face, rig
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
            self._reshape(run, figure)
        if pose is not None:
            if self.face is not None and pose.face:
                self.face.show(pose.face)
            there = figure.show_points(pose.points, pose.off_m)
            if pose.rotvec is not None and pose.transl is not None:
                there = figure.pose(pose.rotvec, pose.transl) and there
                there = (self.character is None or self.character.pose(pose.rotvec, pose.transl)) and there
                figure.show_doubt(pose.rotvec, pose.transl, pose.sigma_m, unsure=pose.state == "unsure")
            if not there and not run.process.cancelling:
                self.failure = "The live body or its character was removed (undone or deleted): the run was stopped."
                run.stop()
        if run.finished:
            self._ended(run)
        if pose is not None or run.finished:
            now = time.monotonic()
            panels = run.finished or now - self._panels_drawn > _PANELS_S
            self._panels_drawn = now if panels else self._panels_drawn
            _redraw(panels=panels)
        return None if self.run is None else _INTERVAL_S

    def _reshape(self, run: LiveRun, figure: LiveFigure) -> None:
        """Give the body its shape, and let the character know of it; a rig that does not suit it ends the run."""
        assert run.betas is not None
        figure.reshape(run.betas)
        try:
            if self.character is not None:
                self.character.reshape(run.betas)
        except MocapError as error:
            self.failure = str(error)
            run.stop()

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
        self.run = self.figure = self.on_recorded = self.face = self.character = None
        self.failure = self.recorded = ""


live = CurrentLive()


@bpy.app.handlers.persistent
def before_load(*_: object) -> None:
    """End the run when another file is opened."""
    live.abandon()


def _redraw(*, panels: bool) -> None:
    """Let viewports show what is new, and the panels beside them, which take far longer to draw, if asked for."""
    for window in bpy.context.window_manager.windows if bpy.context.window_manager else ():
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" else ():
                if panels or region.type == "WINDOW":
                    region.tag_redraw()


class MOCAP_OT_live_start(MocapOperator, bpy.types.Operator):
    """Starts the live run."""

    bl_idname = "mocap.live_start"
    bl_label = "Start Live"
    bl_description = "Move a body live, as markers or poses arrive from a recording or another program"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One run at a time, in object mode, and something to replay or to listen at."""
        settings = context.scene.mocap.live
        source, without = source_of(context.scene), "Choose a recording of markers or a motion, or import one"
        if settings.kind == "VMC":
            source = settings.listen
        elif settings.kind == "CAMERAS":
            source = settings.cameras and settings.calibration
            without = "Name the cameras, such as webcam:0 webcam:1, and their calibration"
        return may_begin(cls, context, source, without)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start the solver's process and make what shows it."""
        from ...scene.live_figure import LiveFace, read_face_table

        scene, settings = context.scene, context.scene.mocap.live
        require_there(settings.subject, settings.face_table if settings.kind == "VMC" else "")
        face, body = None, True
        if settings.kind == "VMC":
            body = allowed_address(settings.listen, tuple(PORTS)).scheme not in FACES
            if settings.face_mesh:
                table = read_face_table(absolute(settings.face_table)) if settings.face_table else {}
                face = LiveFace(settings.face_mesh, table)
        run = _cameras(context) if settings.kind == "CAMERAS" else _file_or_program(context)
        character = partial(self._character, context) if settings.drive and body else None
        live.begin(run, scene, face=face, body=body, fingers=_has_poses(scene), character=character)
        return {"FINISHED"}

    def _character(self, context: bpy.types.Context, body: BodyFile) -> LiveRig:
        """Return the retarget's target as a rig that follows the body, and report what is unsure about it.

        Raises:
            MapInvalid, TargetUnsuitable: there is none, or it cannot play.
        """
        import numpy as np

        from ...retarget.live_rig import LiveRig
        from ...retarget.motion.transfer import TransferSettings
        from ...retarget.retarget import RetargetSettings

        chosen = context.scene.mocap.retarget
        way = TransferSettings(chosen.way == "place", chosen.way == "root", scale=chosen.scale)
        settings = RetargetSettings(chosen.limbs, way)
        rig = LiveRig(chosen_target(context), context.scene, table_map(context), settings, body, np.zeros(10))
        for note in rig.notes:
            self.report({"WARNING"}, note)
        return rig


def _has_poses(scene: bpy.types.Scene) -> bool:
    """Return whether the source is poses, which may have fingers: another program's, or a motion's."""
    from ..._exchange.motion_file import is_motion

    kind = scene.mocap.live.kind
    return kind == "VMC" or (kind != "CAMERAS" and is_motion(absolute(source_of(scene))))


def _file_or_program(context: bpy.types.Context) -> LiveRun:
    """Start a run of a recording, a motion, or another program's poses or face.

    Raises:
        MocapError: a file is not there, or an address is none.
    """
    from ..._exchange.motion_file import is_motion
    from ...solving.live import start_live

    scene, settings = context.scene, context.scene.mocap.live
    options, subject = sending_options(settings), settings.subject
    if settings.kind == "VMC":
        address = allowed_address(settings.listen, tuple(PORTS))
        source, suffix = str(address), ".csv" if address.scheme in FACES else ".npz"
        if address.scheme in FACES:
            options, subject = [], ""  # a face is not sent on, and is nobody's body
    else:
        require_there(source_of(scene))
        source = absolute(source_of(scene))
        suffix = "" if is_motion(source) else ".c3d"  # a motion that is replayed is there already
        subject = subject if suffix else ""
    folder = usable(files_folder(scene))
    record = next_path(folder, "live", suffix) if settings.record and suffix else None
    return start_live(
        source, chosen_python(context), folder, subject=absolute(subject) if subject else None, record=record,
        options=options,
    )  # fmt: skip


def _cameras(context: bpy.types.Context) -> LiveRun:
    """Start a run of cameras.

    Raises:
        MocapError: a file is not there.
    """
    from ...solving.live import start_cameras

    scene, settings, videos = context.scene, context.scene.mocap.live, context.scene.mocap.videos
    require_there(settings.calibration)
    sources = [
        text if ":" in text and not absolute(text).exists() else _video(text) for text in split(settings.cameras)
    ]
    python = detector_for(context)
    options = [*videos.detector_arguments(), *sending_options(settings)]
    options += ["--python", str(python)] if python is not None else []
    folder = usable(files_folder(scene))
    return start_cameras(
        sources, absolute(settings.calibration), chosen_python(context), folder,
        subject=absolute(settings.subject) if settings.subject else None,
        record=next_path(folder, "live", ".npz") if settings.record else None, options=options,
    )  # fmt: skip


def _video(text: str) -> str:
    """Return ``[NAME=]VIDEO`` with the video's whole path, which may be relative to the .blend file."""
    name, equals, path = text.rpartition("=") if not absolute(text).exists() else ("", "", text)
    return f"{name}{equals}{absolute(path)}"


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
    """Return whether a live run may begin: one at a time, in object mode, from a source; or report why not."""
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
