"""Operators for live motion and the sensor array, which move a body, a character or a face."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from shlex import split
from typing import TYPE_CHECKING

import bpy

from ..._exchange.errors import FileMissing, MocapError
from ..._exchange.vmc.sender import FACES, PORTS
from ...conventions.file_paths import absolute, stored
from ...conventions.naming import counted, next_path
from ...conventions.skeleton import SMPL, SMPL_HANDS
from ..acquisition_properties import GAMMA_S, PARTS, allowed_address, sending_options
from ..layout import redraw
from ..preferences import chosen_python, detector_for
from ..project_files import files_folder, usable
from ..setting_properties import choice
from .base import INTERNAL, OBJECT_MODE, Call, MocapOperator, Need, Steps, operator, options
from .retarget import chosen_settings, chosen_target, table_map

if TYPE_CHECKING:
    from ..._exchange.verb_results import OaksResult, SensorsResult
    from ...body.body_file import BodyFile
    from ...retarget.live_rig import LiveRig
    from ...scene.live_figure import LiveFace, LiveFigure
    from ...solving.live import LiveRun

_INTERVAL_S = 1 / 60  # Seconds between polls. Even with the time of a poll, this allows more than 30 poses per second.
_PANELS_S = 0.25  # Seconds between redraws of the panels, so that values stay readable.


class CurrentLive:
    """The live session in this Blender, and the objects that it moves. There is at most one."""

    def __init__(self) -> None:
        self.run: LiveRun | None = None
        self.figure: LiveFigure | None = None
        self.on_recorded: Callable[[str], None] | None = None
        """Function that receives the path of the recording when the run ends."""
        self.face: LiveFace | None = None
        self.character: LiveRig | None = None
        self.area = 0
        """Pointer to the viewport that started the run, or 0 once this viewport has framed the first pose."""
        self.of_sensors = False
        """True if the current or last run belongs to the sensor array and not to the Live panel."""
        self._panels_drawn = 0.0
        self.failure = ""
        self.recorded = ""
        """Path of the last recording, relative to the .blend file if possible."""

    @property
    def busy(self) -> bool:
        """A live run is active."""
        return self.run is not None

    def begin(
        self,
        run: LiveRun,
        scene: bpy.types.Scene,
        *,
        body: bool = True,
        fingers: bool = False,
        on_recorded: Callable[[str], None] | None = None,
        face: LiveFace | None = None,
        own_face: bool = False,
        character: Callable[[BodyFile], LiveRig] | None = None,
    ) -> None:
        """Add the live body or character to a scene. Stop the run if this fails.

        ``fingers`` is True if the poses include fingers. With ``own_face``, the live body shows the received face.
        """
        import numpy as np

        from ...body.body_file import default_body_path, read_body
        from ...body.face import add_face_shapes
        from ...body.looks import show_look
        from ...scene.live_figure import LiveFace, create_live_figure

        try:
            own = read_body(default_body_path(), SMPL_HANDS if fingers else SMPL)
            rig = None if character is None else character(own)
            figure = create_live_figure(scene, own, np.zeros(10), shown=body or own_face)
            if own_face:
                add_face_shapes(bpy.data.objects[figure.mesh], own)
                face = LiveFace(figure.mesh)
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
        """Show the latest pose. Return the seconds until the next call, or None if the run has ended."""
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
                if there:
                    self._frame(figure)
            if not there and not run.process.cancelling:
                self.failure = "The run was stopped, because the live body or its character was deleted or undone."
                run.stop()
        if run.finished:
            self._ended(run)
        if pose is not None or run.finished:
            now = time.monotonic()
            panels = run.finished or now - self._panels_drawn > _PANELS_S
            self._panels_drawn = now if panels else self._panels_drawn
            redraw("WINDOW", "UI") if panels else redraw("WINDOW")
        return None if self.run is None else _INTERVAL_S

    def _frame(self, figure: LiveFigure) -> None:
        """Frame the body's first pose in the viewport that started the run."""
        from .import_results import frame_body

        address, self.area = self.area, 0
        for window in bpy.context.window_manager.windows if address else ():
            for area in (area for area in window.screen.areas if area.as_pointer() == address):
                with bpy.context.temp_override(window=window, area=area):
                    bpy.context.view_layer.update()
                    frame_body(bpy.context, bpy.data.objects[figure.armature])

    def _reshape(self, run: LiveRun, figure: LiveFigure) -> None:
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
        """Kill the run, because the file or the add-on is being closed."""
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
    """Kill the live run when another file is opened."""
    live.abandon()


ALONE = Need("Live is running. Stop it first", lambda context: not live.busy)


def _source_of(scene: bpy.types.Scene) -> str:
    capture = scene.mocap.capture
    return scene.mocap.live.source or (capture.source if len(capture.marker_items) else "")


def _has_source(context: bpy.types.Context) -> bool:
    settings = context.scene.mocap.live
    chosen = {"VMC": settings.listen, "CAMERAS": True}
    return bool(chosen[settings.kind] if settings.kind in chosen else _source_of(context.scene))


def _has_cameras(context: bpy.types.Context) -> bool:
    settings = context.scene.mocap.live
    return settings.kind != "CAMERAS" or bool(settings.cameras and settings.calibration)


_SOURCE = Need("Choose a marker recording or a motion, or import one", _has_source)
_CAMERAS = Need("Enter the cameras, such as webcam:0 webcam:1, and choose their calibration", _has_cameras)


@operator("Start Live", ALONE, OBJECT_MODE, _SOURCE, _CAMERAS)
def live_start(self: MocapOperator, context: bpy.types.Context) -> None:
    """Animate a body live with markers or poses from a recording, another program or cameras."""
    from ...scene.live_figure import LiveFace, read_face_table

    scene, settings = context.scene, context.scene.mocap.live
    _require_there(settings.subject, settings.face_table if settings.kind == "VMC" else "")
    face, body = None, True
    if settings.kind == "VMC":
        body = allowed_address(settings.listen, tuple(PORTS)).scheme not in FACES
        if settings.face_mesh:
            table = read_face_table(absolute(settings.face_table)) if settings.face_table else {}
            face = LiveFace(settings.face_mesh, table)
    run = _cameras(context) if settings.kind == "CAMERAS" else _file_or_program(context)
    character = partial(_character, self, context) if settings.drive and body else None
    own_face = settings.kind == "VMC" and face is None
    fingers = _has_poses(scene)
    live.begin(run, scene, face=face, own_face=own_face, body=body, fingers=fingers, character=character)
    live.area = context.area.as_pointer() if context.area is not None else 0
    if settings.record and replays_motion(scene):
        self.tell("Nothing is recorded, because the source is already a motion. Add it with Import Motion")


def _character(operator: MocapOperator, context: bpy.types.Context, body: BodyFile) -> LiveRig:
    import numpy as np

    from ...retarget.live_rig import LiveRig

    scene = context.scene
    rig = LiveRig(chosen_target(context), scene, table_map(context), chosen_settings(scene), body, np.zeros(10))
    operator.tell(*rig.notes, kind="WARNING")
    return rig


def _has_poses(scene: bpy.types.Scene) -> bool:
    """Return whether the live source provides poses instead of points. Poses may include fingers."""
    return scene.mocap.live.kind == "VMC" or replays_motion(scene)


def replays_motion(scene: bpy.types.Scene) -> bool:
    """Return whether the live source is a motion file, which has its own body and is not recorded again."""
    from ..._exchange.motion_file import is_motion

    source = _source_of(scene)
    return scene.mocap.live.kind not in ("VMC", "CAMERAS") and bool(source) and is_motion(absolute(source))


def _file_or_program(context: bpy.types.Context) -> LiveRun:
    scene, settings = context.scene, context.scene.mocap.live
    if settings.kind == "VMC":
        address = allowed_address(settings.listen, tuple(PORTS))
        if address.scheme in FACES:  # a face is not forwarded and has no body
            return _start(context, "live stream", [str(address)], "", ".csv" if settings.record else None)
        source, suffix = str(address), ".npz"
    else:
        _require_there(_source_of(scene))
        source = absolute(_source_of(scene))
        suffix = "" if replays_motion(scene) else ".c3d"
    words = [str(source), *sending_options(settings)]
    return _start(
        context, "live stream", words, suffix and settings.subject, suffix if settings.record and suffix else None
    )


def _cameras(context: bpy.types.Context) -> LiveRun:
    from ...solving.live import SENSORS_GRACE_S

    settings, videos = context.scene.mocap.live, context.scene.mocap.videos
    _require_there(settings.calibration)
    sources = [
        text if ":" in text and not absolute(text).exists() else _video(text) for text in split(settings.cameras)
    ]
    words = [*sources, *options(calibration=absolute(settings.calibration)), *videos.detector_arguments()]
    words += [*sending_options(settings), *options(python=detector_for(context))]
    record = ".npz" if settings.record else None
    return _start(context, "live cameras", words, settings.subject, record, grace_s=SENSORS_GRACE_S)


def _start(
    context: bpy.types.Context,
    verb: str,
    words: list[str],
    subject: str,
    suffix: str | None,
    name: str = "live",
    **more: float,
) -> LiveRun:
    """Start a live run that records to a file with this suffix, or does not record if it is None."""
    from ...solving.live import start_live

    folder = usable(files_folder(context.scene))
    record = None if suffix is None else next_path(folder, name, suffix)
    words = [*words, *options(subject=subject and absolute(subject), record=record)]
    return start_live(verb, words, chosen_python(context), folder, **more)


def _video(text: str) -> str:
    """Return a camera argument ``[NAME=]VIDEO`` with an absolute video path."""
    name, equals, path = text.rpartition("=") if not absolute(text).exists() else ("", "", text)
    return f"{name}{equals}{absolute(path)}"


@operator("Stop", Need("Live is not running", lambda context: live.busy), options=INTERNAL)
def live_stop(self: MocapOperator, context: bpy.types.Context) -> None:
    """Stop the live run and save its recording."""
    if live.run is not None:
        live.run.stop()


def _require_there(*paths: str) -> None:
    for path in paths:
        if path and not absolute(path).exists():
            raise FileMissing("This file does not exist.", where=absolute(path).name, hint="Choose another one.")


_PARTS = tuple((name, *texts[:2]) for name, texts in PARTS.items())
_SENSORS = Need("Choose a sensor recording, or find cameras", lambda context: context.scene.mocap.sensors.sensors())


@operator("Find Cameras")
def find_sensors(self: MocapOperator, context: bpy.types.Context) -> Steps:
    """List the OAK cameras on USB and the network."""
    result: OaksResult = yield Call("sensors list", [], usable(files_folder(context.scene)), of_capture=False)
    sensors, found = context.scene.mocap.sensors, list(result["oaks"])
    known = {oak.partition("=")[0] for oak in sensors.oaks.split()}
    sensors.oaks = " ".join([*sensors.oaks.split(), *(oak for oak in found if oak not in known)])
    message = f"{counted(len(found), 'camera')}: {', '.join(found)}" if found else "No OAK camera was found"
    return self.finish(message, warn=not found)


class MOCAP_OT_start_sensors(MocapOperator, bpy.types.Operator):
    """Start the sensors, and show and record their data."""

    bl_label = "Start Sensors"
    needs = (ALONE, OBJECT_MODE, _SENSORS)

    part: choice("For", "Purpose of the recording", _PARTS, "TAKE", options={"SKIP_SAVE"})

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return PARTS[properties.part][1]

    def work(self, context: bpy.types.Context) -> None:
        from ...solving.live import SENSORS_GRACE_S

        scene, sensors, part = context.scene, context.scene.mocap.sensors, self.part
        _require_there(sensors.subject, sensors.source if sensors.kind == "FOLDER" else "")
        words = {"WAND": ["--wand"], "GAMMA": ["--wand", "--seconds", f"{GAMMA_S:g}"], "TAKE": ["--poses"]}[part]
        words = [*sensors.sensors(), *words, *(sending_options(sensors) if part == "TAKE" else [])]
        subject, suffix = sensors.subject if part == "TAKE" else "", "" if sensors.record else None
        run = _start(context, "sensors live", words, subject, suffix, PARTS[part][2], grace_s=SENSORS_GRACE_S)
        live.begin(run, scene, body=part == "TAKE", on_recorded=partial(_keep_recording, scene.name, part))


_WAVED = Need("Wave the wand first, or choose a recording of it", lambda context: context.scene.mocap.sensors.wand)


@operator("Calibrate", _WAVED)
def calibrate_sensors(self: MocapOperator, context: bpy.types.Context) -> Steps:
    """Calibrate the sensors with the wand, and set the origin and up axis with the Γ on the floor."""
    sensors = context.scene.mocap.sensors
    _require_there(sensors.wand, sensors.gamma)
    folder = usable(files_folder(context.scene))
    words = [*sensors.calibrating(), *options(out=next_path(folder, "sensor_array", ".toml"))]
    result: SensorsResult = yield Call("sensors calibrate", words, folder, of_capture=False)
    sensors = context.scene.mocap.sensors
    sensors.calibration = stored(Path(result["calibration"]))
    notes = [*result.get("findings", ()), *result.get("notes", ())]
    sensors.findings = "\n".join(str(sentence) for sentence in notes)
    look = f". See {counted(len(notes), 'note')} in the panel" if notes else ""
    return self.finish(f"The sensors are calibrated{look}", warn=result.get("findings"))


def _keep_recording(scene: str, part: str, recorded: str) -> None:
    found = bpy.data.scenes.get(scene)
    if found is not None and recorded:
        setattr(found.mocap.sensors, PARTS[part][2], recorded)
