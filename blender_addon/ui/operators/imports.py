"""Operators that import captures, motion files, other armatures' motion and glove recordings."""

from __future__ import annotations

from collections.abc import Callable
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
from . import base
from .base import Call, Need, SolverOperator, Steps, operator, options

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult, ClipResult, GlovesResult, Remarks
    from ...scene.bake import BakeSettings

THROUGH_BLENDER = (".fbx", ".glb", ".gltf", ".vrm", ".vrma", ".blend")
"""File types that a second Blender imports, so that the open file is not changed."""
NETWORKS = (".pt", ".pth", ".pkl", ".pickle", ".joblib", ".npy", ".json")
"""File types of neural networks that estimate a person's motion from one video."""
MOTIONS = (".npz", ".bvh", ".amc", ".asf", ".mvnx", ".c3d", *NETWORKS, *THROUGH_BLENDER)
GLOVES = (".bvh", ".csv", ".npz", *THROUGH_BLENDER)


def _bring(
    self: Any, context: bpy.types.Context, clip: Path, name: str, settings: Callable[[], BakeSettings], *more: str
) -> Steps:
    """Fit a clip to the add-on's body, save the motion file ``name``, and bake the motion onto a new body."""
    from ...scene.session import undisturbed
    from .import_results import add_motion, frame_body

    folder = usable(files_folder(context.scene))
    words = [str(clip), *options(out=next_path(folder, safe_name(name), ".npz")), *more]
    through_blender = clip.suffix.lower() in THROUGH_BLENDER
    result: ClipResult = yield Call("motion convert", words, folder, through_blender, of_capture=False)
    with undisturbed(context):
        take = add_motion(context, Path(result["motion"]), settings())
    frame_body(context, take.armature)
    bring_home()
    self.tell(*remarks(result), *take.notes, kind="WARNING")
    off_mm = result.get("distance_mm")
    near = "" if off_mm is None else f". The limbs differ from the clip by {off_mm:.1f} mm (root mean square)"
    return f"Baked '{take.action.name}'{near}"


def remarks(result: Remarks) -> tuple[str, ...]:
    """Return a clip's problems, then its notes, without duplicates."""
    return tuple(dict.fromkeys((*result.get("problems", ()), *result.get("notes", ()))))


_ARMATURE = text("Armature", "Name of the armature to import, if the file contains several animated ones")
_TIMES = -1e6, 1e6
"""Limits for accepted times, in seconds."""


class MOCAP_OT_import_motion(SolverOperator, bpy.types.Operator, base.choose_file(MOTIONS), ImportHelper):
    """Import a solved motion, or fit a clip to the add-on's body (BVH, FBX, glTF, VRM, AMASS and more)."""

    bl_label = "Import Motion"
    bl_options = base.UNDOABLE | base.PRESETS
    needs = (base.OBJECT_MODE, base.IDLE)

    filename_ext = ".npz"
    capture_path: text("Capture", "Capture file of a solved motion, to add its cameras, footage and detections")
    body_path: text("Body", "Body file (leave blank to use the solve's body, or the neutral one)")
    armature: _ARMATURE
    clip: text("Action", "Name of the action to import, if the file contains several (leave blank for the active one)")
    keep_height: switch("Keep Height", "Keep the height of a clip instead of placing it on the floor")
    scene_setup: SCENE_SETUP
    floor: switch("Floor", "Add a floor with one-metre tiles", on=True)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Bake a motion file of this product immediately. Fit any other clip to the body first."""
        from ..._exchange.motion_file import is_motion
        from ...scene.bake import BakeSettings
        from .import_results import takes_over

        file = absolute(self.filepath)

        def settings() -> BakeSettings:
            take_over = takes_over(context.scene, self.scene_setup)
            return BakeSettings(frame_start=context.scene.frame_start, set_scene=take_over, floor=self.floor)

        capture, body = (absolute(text) if text else None for text in (self.capture_path, self.body_path))
        if not file.is_file() or is_motion(file):
            return _bake_motion(self, context, file, settings(), capture, body)
        named = {"armature": self.armature, "action": self.clip} if file.suffix.lower() in THROUGH_BLENDER else {}
        given = [f"--{name}={value}" for name, value in {**named, "body": body}.items() if value]
        given += options(keep_height=self.keep_height)
        return (yield from _bring(self, context, file, file.stem, settings, *given))


def _bake_motion(self: Any, context: bpy.types.Context, file: Path, settings: BakeSettings, *paths: Path | None) -> str:
    from .import_results import add_motion, set_up_said

    take = add_motion(context, file, settings, *paths)
    base.current.last = None
    self.tell(*take.notes, kind="WARNING")
    cameras = f" with {counted(len(take.cameras), 'camera')}" if paths else ""
    return f"Baked '{take.action.name}'{cameras}. {set_up_said(context.scene, take_over=settings.set_scene)}"


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry for motions in File > Import."""
    text = "Motion onto Body (.npz, .bvh, .amc, .fbx, .glb, .vrm, .vrma, .mvnx, .c3d)"
    self.layout.operator("mocap.import_motion", text=text)


def foreign_actor(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the chosen actor or the active armature, unless it is one of the add-on's bodies."""
    from ...retarget.rig_actor import is_actor

    settings = context.scene.mocap.retarget
    chosen = settings.actor
    rig = context.active_object if chosen is None or context.scene.objects.get(chosen.name) != chosen else chosen
    return None if rig is None or rig.type != "ARMATURE" or rig == settings.target or is_actor(rig) else rig


@operator("Bring onto Body", Need("Select the armature with the motion, or choose it as the actor", foreign_actor))
def motion_from_rig(self: Any, context: bpy.types.Context) -> Steps:
    """Add a body with the actor's proportions and motion, to clean up, edit and export like a solved take."""
    from ..._exchange.skeleton_file import write_skeleton
    from ...retarget.rig_actor import played_frames, skeleton_of_rig
    from ...scene.bake import BakeSettings

    rig = foreign_actor(context)
    assert rig is not None  # guaranteed by the operator's need
    start = round(float(played_frames(rig)[1][0]))
    skeleton = skeleton_of_rig(rig, context.scene)
    path = next_path(usable(files_folder(context.scene)), f"{safe_name(skeleton.name)} skeleton", ".npz")
    try:
        write_skeleton(path, skeleton)
        settings = BakeSettings(frame_start=start, set_scene=False, floor=False)
        return (yield from _bring(self, context, path, skeleton.name, lambda: settings))
    finally:
        path.unlink(missing_ok=True)


class MOCAP_OT_add_gloves(SolverOperator, bpy.types.Operator, base.choose_file(GLOVES, several=True), ImportHelper):
    """Add finger motion from glove recordings (BVH, FBX, glTF or CSV) to this take, as a new take."""

    bl_label = "Add Gloves"
    needs = (base.TAKE, base.IDLE)

    side: choice("Hand", "Side of the hand, if the file contains only one", "add_gloves.side")
    states_offset: switch("Set the Start", "Enter the start time instead of estimating it from the wrist motion")
    offset: number("Gloves Start At", "Time of the first glove frame in the take", 0.0, *_TIMES, unit="TIME_ABSOLUTE")
    armature: _ARMATURE

    def steps(self, context: bpy.types.Context) -> Steps:
        from ...animation.takes import SolveFiles, take_file
        from .import_results import take_motion

        take, recordings = context.scene.mocap.review.take, base.chosen_files(self)
        name, motion = take.name, take_file(take, "motion_file")
        for path in (motion, *recordings):
            if not path.is_file():
                raise FileMissing("This file does not exist.", where=str(path), hint="Choose a glove recording.")
        folder = usable(files_folder(context.scene))
        out = next_path(folder, f"{motion.stem} gloves", ".npz")
        words = [str(motion), *map(str, recordings), *options(out=out)]
        words += [f"--side={self.side.lower()}"] if self.side != "NAMED" else []
        words += [f"--offset={self.offset:g}"] if self.states_offset else []
        through_blender = any(path.suffix.lower() in THROUGH_BLENDER for path in recordings)
        words += [f"--armature={self.armature}"] if through_blender and self.armature else []
        result: GlovesResult = yield Call("hands add", words, folder, through_blender)
        before = bpy.data.actions.get(name)
        source = None if before is None or not before.get("capture_file") else take_file(before, "capture_file")
        action = take_motion(context, SolveFiles(out, source, None, None), tell=self.tell)
        self.tell(*remarks(result), kind="WARNING")
        hands = sum(len(recording["sides"]) for recording in result["gloves"])
        return f"Baked '{action.name}' with the fingers from {counted(hands, 'hand')}"


SUFFIXES = (".npz", ".json", ".toml", ".txt", ".yml", ".yaml", *MARKER_SUFFIXES)
"""File types of captures, detections, calibrations, settings and marker recordings."""


class MOCAP_OT_import_capture(
    SolverOperator, bpy.types.Operator, base.choose_file(SUFFIXES, several=True), ImportHelper
):
    """Import detections with a calibration, or markers, and add cameras, footage and floor."""

    bl_label = "Import Capture"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.execute(context) if base.is_chosen(self) else ImportHelper.invoke(self, context, event)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Set up the scene for each capture, or bake a solved motion."""
        from ..._exchange.motion_file import is_motion
        from ...scene.bake import BakeSettings
        from .import_results import takes_over

        chosen, settings = base.chosen_files(self)[0], context.scene.mocap
        if is_motion(chosen):
            take_over = takes_over(context.scene, settings.reading.scene_setup)
            start = context.scene.frame_start
            return _bake_motion(self, context, chosen, BakeSettings(frame_start=start, set_scene=take_over))
        root = capture_root(chosen)
        folder = usable(capture_folder(files_folder(context.scene), root))
        if not settings.capture.file:
            settings.capture.source = stored(root)  # lets Read Again work if reading fails
        out = options(out=folder if is_session(root) else folder / "capture.npz", overwrite=True)
        words = [str(root), *out, *settings.reading.arguments(), f"--sync={settings.solve.sync}"]
        result = yield Call("convert", words, folder, of_capture=False)
        scene, last = context.scene, 1
        take_over = takes_over(scene, scene.mocap.reading.scene_setup)
        for part in result.get("captures", [result]):
            self._set_up(context, part, Path(part.get("source", root)))
            last = max(last, scene.mocap.capture.review.last)
        if take_over:
            scene.frame_end = max(scene.frame_end, last)
        return None

    def _set_up(self, context: bpy.types.Context, result: CaptureResult, source: Path) -> None:
        from .import_results import bring_capture, set_up_said, takes_over

        take_over = takes_over(context.scene, context.scene.mocap.reading.scene_setup)
        stage = bring_capture(context, result, source)
        problems, cameras = len(result["problems"]), len(stage.cameras)
        look = f". See {counted(problems, 'problem')} in the panel" if problems else ""
        seen_by = counted(cameras, "camera") if cameras else counted(result["markers"] or 0, "marker")
        found = f"{seen_by}, {counted(result['frames'], 'frame')}. {set_up_said(context.scene, take_over=take_over)}"
        self.finish(f"Capture '{result['name']}': {found}{look}", warn=problems)


@operator(
    "Try the Demo Capture",
    kind=choice("Kind", "Data to create: keypoints from four cameras, or optical markers", "demo_capture.kind"),
)
def demo_capture(self: Any, context: bpy.types.Context) -> Steps:
    """Create a synthetic capture of a moving person, to try the add-on without your own data."""
    from .import_results import bring_capture

    markers = self.kind == "MARKERS"
    folder = usable(capture_folder(files_folder(context.scene), Path("demo_markers" if markers else "demo")))
    words = options(out=folder / "capture.npz", overwrite=True, markers=markers)
    result: CaptureResult = yield Call("dataset demo", words, folder, of_capture=False)
    bring_capture(context, result, Path(result["capture"]))


class MOCAP_FH_capture(base.ViewportDrop, bpy.types.FileHandler):
    """Import a capture when one of its files is dropped on the 3D viewport."""

    bl_idname = "MOCAP_FH_capture"
    bl_label = "Motion capture"
    bl_import_operator = "mocap.import_capture"
    bl_file_extensions = ";".join(SUFFIXES)


def draw_capture_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry for captures in File > Import."""
    self.layout.operator("mocap.import_capture", text="Motion Capture (.npz, .c3d, .trc, .csv, folder)")
