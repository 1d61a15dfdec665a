"""Import captures, and motions of files, other armatures and gloves, by panel, menu or drop."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy_extras.io_utils import ImportHelper

from ..._exchange.errors import FileMissing
from ...conventions.file_paths import absolute, stored
from ...conventions.naming import counted, next_path
from ...solving.take_paths import MARKER_SUFFIXES, capture_folder, capture_root, is_session, safe_name
from ..project_files import bring_home, files_folder, usable
from ..properties import SCENE_SETUP
from ..setting_properties import choice, number, switch, text
from .base import (
    IDLE,
    OBJECT_MODE,
    PRESETS,
    TAKE,
    UNDOABLE,
    Call,
    Need,
    SolverOperator,
    ViewportDrop,
    choose_file,
    chosen_files,
    current,
    is_chosen,
    options,
)

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult, ClipResult, GlovesResult, Remarks
    from ...scene.bake import BakeSettings

THROUGH_BLENDER = (".fbx", ".glb", ".gltf", ".vrm", ".blend")
"""Files that Blender imports. A second Blender does this, so that the open file stays unchanged."""
MOTIONS = (".npz", ".bvh", ".mvnx", ".c3d", *THROUGH_BLENDER)
GLOVES = (".bvh", ".csv", ".npz", *THROUGH_BLENDER)


class BringsMotion(SolverOperator):
    """Mixin of operators that fit a clip and bake it on a body of its own."""

    verb = "motion"
    is_of_capture = False

    def bake_settings(self, context: bpy.types.Context) -> BakeSettings:
        """Return the settings of the bake."""
        raise NotImplementedError

    def bring(self, context: bpy.types.Context, clip: Path, name: str, more: Sequence[str] = ()) -> Call:
        """Return the command line that fits a clip into the motion file of a name, with further options of the verb."""
        folder = usable(files_folder(context.scene))
        out = options(out=next_path(folder, safe_name(name), ".npz"))
        return Call([str(clip), *out, *more], folder, clip.suffix.lower() in THROUGH_BLENDER)

    def received(self, context: bpy.types.Context, result: ClipResult) -> str:
        """Bake the motion and report the findings."""
        from ...scene.session import undisturbed
        from .import_results import add_motion, frame_body

        with undisturbed(context):
            take = add_motion(context, Path(result["motion"]), self.bake_settings(context))
        frame_body(context, take.armature)
        bring_home()
        self.tell(*remarks(result), *take.notes, kind="WARNING")
        off_mm = result.get("distance_mm")
        near = "" if off_mm is None else f"; limbs are {off_mm:.1f} mm from the clip's (root mean square)"
        return f"Baked '{take.action.name}'{near}"


def remarks(result: Remarks) -> tuple[str, ...]:
    """Return the findings in a clip once each, problems first."""
    return tuple(dict.fromkeys((*result.get("problems", ()), *result.get("notes", ()))))


_ARMATURE = text("Armature", "Armature of an FBX, glTF or Blender file, if several move")
_TIMES = -1e6, 1e6
"""Seconds between which times are accepted."""
_HANDS = (
    ("NAMED", "By Name", "Use the names of the file and its joints"),
    ("LEFT", "Left", "The left hand"),
    ("RIGHT", "Right", "The right hand"),
)


class MOCAP_OT_import_motion(BringsMotion, bpy.types.Operator, choose_file(MOTIONS), ImportHelper):
    """Import a solved motion, or fit a clip (BVH, FBX, glTF, VRM, MVNX, C3D segments, AMASS) to our body."""

    bl_label = "Import Motion"
    bl_options = UNDOABLE | PRESETS
    needs = (OBJECT_MODE, IDLE)

    filename_ext = ".npz"
    capture_path: text("Capture", "Capture file of a solved motion, to add its cameras, footage and detections")
    body_path: text("Body", "Body file, empty for the one of the solve, or the neutral one")
    armature: _ARMATURE
    clip: text("Action", "Action of an FBX, glTF or Blender file, empty for the active one")
    keep_height: switch("Keep Height", "Keep the height of a clip instead of placing it on the floor")
    scene_setup: SCENE_SETUP
    floor: switch("Floor", "Add a floor of metre tiles", on=True)

    def work(self, context: bpy.types.Context) -> Any:
        """Bake one of our motions at once, or start the fit of a clip."""
        from ..._exchange.motion_file import is_motion

        file = absolute(self.filepath)
        return self._bake(context, file) if not file.is_file() or is_motion(file) else super().work(context)

    def call(self, context: bpy.types.Context) -> Call:
        file = absolute(self.filepath)
        named = {"armature": self.armature, "action": self.clip} if file.suffix.lower() in THROUGH_BLENDER else {}
        body = absolute(self.body_path) if self.body_path else ""
        given = [f"--{name}={value}" for name, value in {**named, "body": body}.items() if value]
        return self.bring(context, file, file.stem, [*given, *options(keep_height=self.keep_height)])

    def bake_settings(self, context: bpy.types.Context) -> BakeSettings:
        from ...scene.bake import BakeSettings
        from .import_results import takes_over

        take_over = takes_over(context.scene, self.scene_setup)
        return BakeSettings(frame_start=context.scene.frame_start, set_scene=take_over, floor=self.floor)

    def _bake(self, context: bpy.types.Context, file: Path) -> str:
        from .import_results import add_motion, set_up_said

        settings = self.bake_settings(context)
        paths = (absolute(text) if text else None for text in (self.capture_path, self.body_path))
        take = add_motion(context, file, settings, *paths)
        current.last = None
        self.tell(*take.notes, kind="WARNING")
        message = f"Baked '{take.action.name}' with {counted(len(take.cameras), 'camera')}"
        return f"{message}; {set_up_said(context.scene, take_over=settings.set_scene)}"


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    text = "Motion onto Body (.npz, .bvh, .fbx, .glb, .vrm, .mvnx, .c3d)"
    self.layout.operator(MOCAP_OT_import_motion.bl_idname, text=text)


def foreign_actor(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the armature chosen as actor, or the active one, unless it is one of our bodies."""
    from ...retarget.rig_actor import is_actor

    settings = context.scene.mocap.retarget
    chosen = settings.actor
    rig = context.active_object if chosen is None or context.scene.objects.get(chosen.name) != chosen else chosen
    return None if rig is None or rig.type != "ARMATURE" or rig == settings.target or is_actor(rig) else rig


class MOCAP_OT_motion_from_rig(BringsMotion, bpy.types.Operator):
    """Add a body with the actor's proportions and motion, to clean up, edit and export like a solved take."""

    bl_label = "Bring onto Body"
    needs = (Need("Select the armature with the motion, or choose it as the actor", foreign_actor), IDLE)

    _skeleton = None  # Input of the solver, removed after the run.

    def call(self, context: bpy.types.Context) -> Call:
        from ..._exchange.skeleton_file import write_skeleton
        from ...retarget.rig_actor import played_frames, skeleton_of_rig

        rig = foreign_actor(context)
        assert rig is not None  # see needs
        _, times = played_frames(rig)
        self._start = round(float(times[0]))
        skeleton = skeleton_of_rig(rig, context.scene)
        folder = usable(files_folder(context.scene))
        self._skeleton = next_path(folder, f"{safe_name(skeleton.name)} skeleton", ".npz")
        write_skeleton(self._skeleton, skeleton)
        return self.bring(context, self._skeleton, skeleton.name)

    def begin(self, context: bpy.types.Context, call: Call) -> set[str]:
        try:
            return super().begin(context, call)
        except BaseException:
            self._remove()
            raise

    def bake_settings(self, context: bpy.types.Context) -> BakeSettings:
        """Start with the actor's motion, and keep the scene as it is."""
        from ...scene.bake import BakeSettings

        return BakeSettings(frame_start=self._start, set_scene=False, floor=False)

    def cancel(self, context: bpy.types.Context) -> None:
        super().cancel(context)
        self._remove()

    def _ended(self, context: bpy.types.Context) -> set[str]:
        try:
            return super()._ended(context)
        finally:
            self._remove()

    def _remove(self) -> None:
        if self._skeleton is not None:
            self._skeleton.unlink(missing_ok=True)


class MOCAP_OT_add_gloves(SolverOperator, bpy.types.Operator, choose_file(GLOVES, several=True), ImportHelper):
    """Add the fingers of glove recordings (BVH, FBX, glTF, MANUS or Rokoko CSV) to this take as a new take."""

    bl_label = "Add Gloves"
    verb = "add-hands"
    needs = (TAKE, IDLE)

    side: choice("Hand", "Hand of a file with one hand", _HANDS)
    states_offset: switch("Set the Start", "Enter the start of the gloves instead of finding it by the wrists")
    offset: number("Gloves Start At", "Time of the first glove frame in the take", 0.0, *_TIMES, unit="TIME_ABSOLUTE")
    armature: _ARMATURE

    def call(self, context: bpy.types.Context) -> Call:
        from ...animation.takes import take_file

        take, recordings = context.scene.mocap.review.take, chosen_files(self)
        motion = take_file(take, "motion_file")
        for path in (motion, *recordings):
            if not path.is_file():
                raise FileMissing("This file does not exist.", where=str(path), hint="Choose a glove recording.")
        self._take = take.name
        folder = usable(files_folder(context.scene))
        self._out = next_path(folder, f"{motion.stem} gloves", ".npz")
        words = [str(motion), *map(str, recordings), *options(out=self._out)]
        if self.side != "NAMED":
            words.append(f"--side={self.side.lower()}")
        if self.states_offset:
            words.append(f"--offset={self.offset:g}")
        through_blender = any(path.suffix.lower() in THROUGH_BLENDER for path in recordings)
        if through_blender and self.armature:
            words.append(f"--armature={self.armature}")
        return Call(words, folder, through_blender)

    def received(self, context: bpy.types.Context, result: GlovesResult) -> str:
        from ...animation.takes import SolveFiles, take_file
        from .import_results import take_motion

        before = bpy.data.actions.get(self._take)
        source = None if before is None or not before.get("capture_file") else take_file(before, "capture_file")
        action = take_motion(context, SolveFiles(self._out, source, None, None), tell=self.tell)
        self.tell(*remarks(result), kind="WARNING")
        hands = sum(len(recording["sides"]) for recording in result["gloves"])
        return f"Baked '{action.name}' with the fingers of {counted(hands, 'hand')}"


_KINDS = (
    ("CAMERAS", "Cameras", "Keypoints in four views"),
    ("MARKERS", "Markers", "Optical markers as in a C3D file"),
)
SUFFIXES = (".npz", ".json", ".toml", ".txt", ".yml", ".yaml", *MARKER_SUFFIXES)
"""Captures, detections, calibrations, settings, and marker recordings."""


class MOCAP_OT_import_capture(SolverOperator, bpy.types.Operator, choose_file(SUFFIXES, several=True), ImportHelper):
    """Import a folder of detections and a calibration, or a marker recording, with cameras, footage and floor."""

    bl_label = "Import Capture"
    verb = "convert"
    is_of_capture = False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.execute(context) if is_chosen(self) else ImportHelper.invoke(self, context, event)

    def work(self, context: bpy.types.Context) -> Any:
        """Start reading, or bake a solved motion at once."""
        from ..._exchange.motion_file import is_motion
        from ...scene.bake import BakeSettings
        from .import_results import add_motion, set_up_said, takes_over

        chosen = chosen_files(self)[0]
        if not is_motion(chosen):
            return super().work(context)
        take_over = takes_over(context.scene, context.scene.mocap.reading.scene_setup)
        take = add_motion(context, chosen, BakeSettings(frame_start=context.scene.frame_start, set_scene=take_over))
        current.last = None
        return f"Baked '{take.action.name}'; {set_up_said(context.scene, take_over=take_over)}"

    def call(self, context: bpy.types.Context) -> Call:
        settings = context.scene.mocap
        self._source = source = capture_root(chosen_files(self)[0])
        folder = usable(capture_folder(files_folder(context.scene), source))
        if not settings.capture.file:
            settings.capture.source = stored(source)  # so that Read Again works if reading fails
        out = options(out=folder if is_session(source) else folder / "capture.npz", overwrite=True)
        return Call([str(source), *out, *settings.reading.arguments(), f"--sync={settings.solve.sync}"], folder)

    def received(self, context: bpy.types.Context, result: Any) -> None:
        """Set up the scene for each capture. The longest trial of a session sets the frame range."""
        from .import_results import takes_over

        scene = context.scene
        take_over = takes_over(scene, scene.mocap.reading.scene_setup)
        last = 1
        for part in result.get("captures", [result]):
            self._set_up(context, part, Path(part.get("source", self._source)))
            last = max(last, scene.mocap.capture.review.last)
        if take_over:
            scene.frame_end = max(scene.frame_end, last)

    def _set_up(self, context: bpy.types.Context, result: CaptureResult, source: Path) -> None:
        from .import_results import present_capture, set_up_said, take_capture, takes_over

        take_over = takes_over(context.scene, context.scene.mocap.reading.scene_setup)
        stage = take_capture(context.scene, result, source)
        context.scene.mocap.capture.source = stored(source)
        present_capture(context, stage)
        problems, cameras = len(result["problems"]), len(stage.cameras)
        look = f"; {counted(problems, 'problem')}, see the panel" if problems else ""
        seen_by = counted(cameras, "camera") if cameras else counted(result["markers"] or 0, "marker")
        found = f"{seen_by}, {counted(result['frames'], 'frame')}; {set_up_said(context.scene, take_over=take_over)}"
        self.finish(f"Capture '{result['name']}': {found}{look}", warn=problems)


class MOCAP_OT_demo_capture(SolverOperator, bpy.types.Operator):
    """Make a synthetic capture of a moving person to try the add-on without your own data."""

    bl_label = "Try the Demo Capture"
    verb = "demo-capture"
    is_of_capture = False

    kind: choice("Kind", "Kind of capture", _KINDS)

    def call(self, context: bpy.types.Context) -> Call:
        markers = self.kind == "MARKERS"
        folder = usable(capture_folder(files_folder(context.scene), Path("demo_markers" if markers else "demo")))
        return Call(options(out=folder / "capture.npz", overwrite=True, markers=markers), folder)

    def received(self, context: bpy.types.Context, result: CaptureResult) -> None:
        from .import_results import present_capture, take_capture

        stage = take_capture(context.scene, result)
        context.scene.mocap.capture.source = stored(result["capture"])
        present_capture(context, stage)


class MOCAP_FH_capture(ViewportDrop, bpy.types.FileHandler):
    """Import of files dropped on the 3D viewport. Blender passes no folders, so a file stands for its folder."""

    bl_idname = "MOCAP_FH_capture"
    bl_label = "Motion capture"
    bl_import_operator = "mocap.import_capture"
    bl_file_extensions = ";".join(SUFFIXES)


def draw_capture_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    self.layout.operator(MOCAP_OT_import_capture.bl_idname, text="Motion Capture (.npz, .c3d, .trc, .csv, folder)")
