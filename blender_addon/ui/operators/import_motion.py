"""The operator that brings a motion file, ours or of another program, into the scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy_extras.io_utils import ImportHelper

from ...conventions.file_paths import absolute
from ...conventions.naming import counted, next_path
from ...solving.take_paths import safe_name
from ..preferences import chosen_python
from ..project_files import RELATIVE, files_folder, usable
from ..properties import SCENE_SETUP_ITEMS
from .base import OfTake, SolverOperator, current

if TYPE_CHECKING:
    from ..._exchange.verb_results import ClipResult, GlovesResult, Remarks
    from ...scene.bake import BakeSettings

VERB = "motion"
"""Of both command lines."""
THROUGH_BLENDER = (".fbx", ".glb", ".gltf", ".vrm", ".blend")
"""Files that Blender's importers read; a second Blender does, so that the open file stays as it is."""
READ = (".npz", ".bvh", ".mvnx", ".c3d", *THROUGH_BLENDER)
"""Files that a motion is read from."""


class BringsMotion(SolverOperator):
    """Mixin of operators that start the verb ``motion``; the motion arrives as a body of its own."""

    is_of_capture = False

    def bake_settings(self, context: bpy.types.Context) -> BakeSettings:
        """Return where and how the motion is laid."""
        raise NotImplementedError

    def bring(self, context: bpy.types.Context, clip: Path, name: str, options: Sequence[str] = ()) -> set[str]:
        """Start the verb on a file.

        Args:
            context: of the window.
            clip: file with the motion.
            name: of the motion file.
            options: further ones of the verb.

        Raises:
            MocapError: the folder of takes cannot be written to, or the process not be started.
        """
        folder = usable(files_folder(context.scene))
        given = [str(clip), "--out", str(next_path(folder, safe_name(name), ".npz")), *options]
        if clip.suffix.lower() not in THROUGH_BLENDER:
            return self.launch(context, VERB, given, folder)
        from ...headless.child_verb import start_verb

        python = chosen_python(context)
        solve_with = ["--python", str(python)] if python else []
        return self.follow(context, start_verb(VERB, [*given, *solve_with], folder))

    def received(self, context: bpy.types.Context, result: ClipResult) -> set[str]:
        """Bake the motion and report what was detected."""
        from ...scene.session import undisturbed
        from ..project_files import bring_home
        from .import_results import add_motion, frame_body

        with undisturbed(context):
            take = add_motion(context, Path(result["motion"]), self.bake_settings(context))
        frame_body(context, take.armature)
        bring_home()
        for note in (*remarks(result), *take.notes):
            self.report({"WARNING"}, note)
        off_mm = result.get("distance_mm")
        near = "" if off_mm is None else f"; limbs are {off_mm:.1f} mm from the clip's (root mean square)"
        self.report({"INFO"}, f"Baked '{take.action.name}'{near}")
        return {"FINISHED"}


def remarks(result: Remarks) -> tuple[str, ...]:
    """Return what was found in a clip, warnings such as missing limbs first; the two lists may hold the same."""
    return tuple(dict.fromkeys((*result.get("problems", ()), *result.get("notes", ()))))


class MOCAP_OT_import_motion(BringsMotion, bpy.types.Operator, ImportHelper):
    """Adds a motion as a body of its own; that of another program is fitted in the solver's process first."""

    bl_idname = "mocap.import_motion"
    bl_label = "Import Motion"
    bl_description = (
        "Add a motion as a skinned, animated body. A solved one brings the cameras and detections of its capture; a "
        "clip of another program (BVH, FBX, glTF, VRM, MVNX, C3D segments, AMASS) is fitted to our body"
    )
    bl_options = {"REGISTER", "UNDO", "PRESET"}  # noqa: RUF012 - Blender reads a plain set

    filename_ext = ".npz"
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in READ), options={"HIDDEN"})
    capture_path: bpy.props.StringProperty(
        name="Capture", description="Capture file a solved motion comes from: adds cameras, footage and detections"
    )
    body_path: bpy.props.StringProperty(
        name="Body", description="Body file; empty for the one the motion was solved for, or the neutral one"
    )
    armature: bpy.props.StringProperty(
        name="Armature", description="Which armature of an FBX, glTF or Blender file, where several move"
    )
    clip: bpy.props.StringProperty(
        name="Action", description="Which action of an FBX, glTF or Blender file; empty for the one that it shows"
    )
    keep_height: bpy.props.BoolProperty(
        name="Keep Height", description="Leave a clip of another program as high as it is: not put on the floor"
    )
    scene_setup: bpy.props.EnumProperty(
        name="Scene Set-Up", description="Whose frame rate, range, resolution and camera count", items=SCENE_SETUP_ITEMS
    )
    floor: bpy.props.BoolProperty(name="Floor", description="Add a floor of metre tiles", default=True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Check whether objects can be added now and no run is under way."""
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit or pose mode first")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Bake a motion of ours at once; start the fit of any other."""
        from ..._exchange.motion_file import is_motion

        file = absolute(self.filepath)
        if not file.is_file() or is_motion(file):
            return self._bake(context, file)
        return self.bring(context, file, file.stem, self._options(file))

    def bake_settings(self, context: bpy.types.Context) -> BakeSettings:
        """Return where and how the motion is laid."""
        from ...scene.bake import BakeSettings
        from .import_results import takes_over

        take_over = takes_over(context.scene, self.scene_setup)
        return BakeSettings(frame_start=context.scene.frame_start, set_scene=take_over, floor=self.floor)

    def _options(self, file: Path) -> list[str]:
        named = {"--armature": self.armature, "--action": self.clip} if file.suffix.lower() in THROUGH_BLENDER else {}
        if self.body_path:
            named["--body"] = str(absolute(self.body_path))
        given = [f"{option}={value}" for option, value in named.items() if value]
        return [*given, *(["--keep-height"] if self.keep_height else [])]

    def _bake(self, context: bpy.types.Context, file: Path) -> set[str]:
        """Bake, select the armature and report what was made."""
        from .import_results import add_motion, set_up_said

        settings = self.bake_settings(context)
        take = add_motion(context, file, settings, _path(self.capture_path), _path(self.body_path))
        current.last = None
        for note in take.notes:
            self.report({"WARNING"}, note)
        message = f"Baked '{take.action.name}' with {counted(len(take.cameras), 'camera')}"
        self.report({"INFO"}, f"{message}; {set_up_said(context.scene, take_over=settings.set_scene)}")
        return {"FINISHED"}


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    self.layout.operator(
        MOCAP_OT_import_motion.bl_idname, text="Motion onto Body (.npz, .bvh, .fbx, .glb, .vrm, .mvnx, .c3d)"
    )


def _path(text: str) -> Path | None:
    return absolute(text) if text else None


class MOCAP_OT_motion_from_rig(BringsMotion, bpy.types.Operator):
    """Adds a body that moves as the actor does."""

    bl_idname = "mocap.motion_from_rig"
    bl_label = "Bring onto Body"
    bl_description = (
        "Add a body with the actor's proportions and motion, to clean up, edit and export like a solved take. The "
        "actor stays as it is"
    )

    _skeleton: Path | None = None
    """What the solver reads; removed when it has."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs an armature that is none of our bodies."""
        if foreign_actor(context) is None:
            cls.poll_message_set("Choose the armature that has the motion as the actor, or select it")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Write what its bones show, and start."""
        from ..._exchange.skeleton_file import write_skeleton
        from ...retarget.rig_actor import played_frames, skeleton_of_rig

        rig = foreign_actor(context)
        assert rig is not None  # see poll
        _, times = played_frames(rig)
        self._start = round(float(times[0]))
        skeleton = skeleton_of_rig(rig, context.scene)
        folder = usable(files_folder(context.scene))
        self._skeleton = next_path(folder, f"{safe_name(skeleton.name)} skeleton", ".npz")
        write_skeleton(self._skeleton, skeleton)
        try:
            return self.bring(context, self._skeleton, skeleton.name)
        except BaseException:
            self._remove()
            raise

    def bake_settings(self, context: bpy.types.Context) -> BakeSettings:
        """Return that the motion begins when the actor's does, and the scene stays set up as it is."""
        from ...scene.bake import BakeSettings

        return BakeSettings(frame_start=self._start, set_scene=False, floor=False)

    def cancel(self, context: bpy.types.Context) -> None:
        """End the run when Blender closes the window or opens another file."""
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


def foreign_actor(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the armature that is chosen as the actor or else active, if it is none of our bodies."""
    from ...retarget.actor_rig import is_actor

    settings = context.scene.mocap.retarget
    chosen = settings.actor
    rig = context.active_object if chosen is None or context.scene.objects.get(chosen.name) != chosen else chosen
    return None if rig is None or rig.type != "ARMATURE" or rig == settings.target or is_actor(rig) else rig


GLOVES_VERB = "add-hands"
"""Of both command lines."""
GLOVES_READ = (".bvh", ".csv", ".npz", *THROUGH_BLENDER)
"""Files that hands are read from."""


class MOCAP_OT_add_gloves(OfTake, bpy.types.Operator, ImportHelper):
    """Adds the fingers of glove recordings to the current take, as a take of its own."""

    bl_idname = "mocap.add_gloves"
    bl_label = "Add Gloves"
    bl_description = (
        "Add the fingers of a glove recording (BVH, FBX, glTF, MANUS or Rokoko CSV; one file, or one a hand) to this "
        "take. Body and wrists stay as solved; the result is a new take"
    )

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in GLOVES_READ), options={"HIDDEN"})
    side: bpy.props.EnumProperty(
        name="Hand", description="Which hand a file of one hand is of, where names do not show it",
        items=(
            ("NAMED", "By the Names", "As the file and its joints are called"),
            ("LEFT", "Left", "The left hand"),
            ("RIGHT", "Right", "The right hand"),
        ),
    )  # fmt: skip
    states_offset: bpy.props.BoolProperty(
        name="Set the Start", description="Enter when the gloves begin instead of finding it by the turns of the wrists"
    )
    offset: bpy.props.FloatProperty(name="Gloves Begin at", description="Time in the take", unit="TIME_ABSOLUTE")
    armature: bpy.props.StringProperty(
        name="Armature", description="Which armature of an FBX, glTF or Blender file, where several move"
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start the verb on the take's motion file."""
        from ..._exchange.errors import FileMissing
        from ...animation.takes import take_file

        take, recordings = context.scene.mocap.review.take, self._chosen()
        motion = take_file(take, "motion_file")
        for path in (motion, *recordings):
            if not path.is_file():
                raise FileMissing("This file is not there.", where=str(path), hint="Choose a recording of gloves.")
        self._take = take.name
        folder = usable(files_folder(context.scene))
        self._out = next_path(folder, f"{motion.stem} gloves", ".npz")
        given = [str(motion), *map(str, recordings), "--out", str(self._out)]
        if self.side != "NAMED":
            given.append(f"--side={self.side.lower()}")
        if self.states_offset:
            given.append(f"--offset={self.offset:g}")
        if not any(path.suffix.lower() in THROUGH_BLENDER for path in recordings):
            return self.launch(context, GLOVES_VERB, given, folder)
        from ...headless.child_verb import start_verb

        named = [f"--armature={self.armature}"] if self.armature else []
        python = chosen_python(context)
        solve_with = ["--python", str(python)] if python else []
        return self.follow(context, start_verb(GLOVES_VERB, [*given, *named, *solve_with], folder))

    def received(self, context: bpy.types.Context, result: GlovesResult) -> set[str]:
        """Bake the motion as a new take, on a body with fingers."""
        from ...animation.takes import SolveFiles, take_file
        from .import_results import take_motion

        former = bpy.data.actions.get(self._take)
        source = None if former is None or not former.get("capture_file") else take_file(former, "capture_file")
        action = take_motion(context, SolveFiles(self._out, source, None, None))
        for note in remarks(result):
            self.report({"WARNING"}, note)
        hands = sum(len(recording["sides"]) for recording in result["gloves"])
        self.report({"INFO"}, f"Baked '{action.name}' with the fingers of {counted(hands, 'hand')}")
        return {"FINISHED"}

    def _chosen(self) -> list[Path]:
        """Return the files that were chosen."""
        several = [absolute(self.directory) / item.name for item in self.files if item.name]
        return several or [absolute(self.filepath)]
