"""Motions of other programs on our body: the verb ``motion`` in a process of its own, and its result in the scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ...conventions.naming import next_path
from ...solving.take_paths import safe_name
from ..locations import files_folder, usable
from ..preferences import chosen_python
from .solver_operator import SolverOperator

if TYPE_CHECKING:
    from ..._exchange.verb_results import ClipResult, Remarks
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
