"""Fingers of gloves onto the current take: the verb ``add-hands`` in a process of its own, and its motion as a take."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy_extras.io_utils import ImportHelper

from ...conventions.file_paths import absolute
from ...conventions.naming import counted, next_path
from ..locations import RELATIVE, files_folder, usable
from ..preferences import chosen_python
from .foreign_motion import THROUGH_BLENDER, remarks
from .solver_operator import OfTake

if TYPE_CHECKING:
    from ..._exchange.verb_results import GlovesResult

VERB = "add-hands"
"""Of both command lines."""
READ = (".bvh", ".csv", ".npz", *THROUGH_BLENDER)
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
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in READ), options={"HIDDEN"})
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
            return self.launch(context, VERB, given, folder)
        from ...headless.child_verb import start_verb

        named = [f"--armature={self.armature}"] if self.armature else []
        python = chosen_python(context)
        solve_with = ["--python", str(python)] if python else []
        return self.follow(context, start_verb(VERB, [*given, *named, *solve_with], folder))

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
