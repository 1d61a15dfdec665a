"""Solving everybody: a job for each person of a capture, or of every capture of the scene, in one run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ...conventions.file_paths import file_of
from ...conventions.naming import counted
from .solver_operator import OfCapture

if TYPE_CHECKING:
    from ..._exchange.verb_results import SolveResult, TakeResult, TakesResult


class MOCAP_OT_solve_all(OfCapture, bpy.types.Operator):
    """Solves everybody that the captures show."""

    bl_idname = "mocap.solve_all"
    bl_label = "Solve All"
    bl_description = "Solve everybody one after another; each motion arrives as an action of a body of its own"

    scope: bpy.props.EnumProperty(
        name="Scope",
        items=(
            ("CAPTURE", "This Capture", "Everybody in this capture"),
            ("SCENE", "All Captures", "Everybody in every capture of the scene"),
        ),
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Write the jobs and start the solver on them."""
        from ..._exchange.job_file import write_job
        from ...animation.takes import SolveFiles
        from ..scene_job import portable_job, prepare_job

        settings = context.scene.mocap
        captures = list(settings.captures) if self.scope == "SCENE" else [settings.capture]
        self._files: dict[Path, SolveFiles] = {}
        arguments: list[str] = []
        folder = Path()
        for capture in captures:
            for person in range(max(1, len(capture.people))):
                job, path = prepare_job(context.scene, None, capture, person)
                write_job(path, portable_job(job, path.parent))
                self._files[job.out] = SolveFiles(job.out, job.capture, job.report, path)
                arguments += ["--job", str(path)]
                folder = path.parent
        return self.launch(context, "solve", arguments, folder)

    def received(self, context: bpy.types.Context, result: TakesResult | TakeResult) -> set[str]:
        """Bake each motion."""
        takes = result.get("takes", [result])
        for take in takes:
            self._bake(context, Path(take["motion"]), take)
        failed = result.get("failed", [])
        if failed:
            message = "; ".join(f"{item['name']}: {item['message']}" for item in failed)
            self.report({"WARNING"}, f"Solved {counted(len(takes), 'take')}; {len(failed)} failed: {message}")
        else:
            self.report({"INFO"}, f"Solved {counted(len(takes), 'take')}")
        return {"FINISHED"}

    def rescue(self, context: bpy.types.Context) -> str:
        """Bake what was finished before the run broke."""
        done = [motion for motion in self._files if motion.is_file()]
        for motion in done:
            self._bake(context, motion)
        return f"{len(done)} of {counted(len(self._files), 'take')} finished and arrived." if done else ""

    def _bake(self, context: bpy.types.Context, motion: Path, result: SolveResult | None = None) -> None:
        from .import_results import take_motion

        files = self._files[motion]
        captures = context.scene.mocap.captures
        capture = next((item for item in captures if file_of(item.file) == files.capture), None)
        take_motion(context, files, capture, result=result)
