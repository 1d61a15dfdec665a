"""Solving: a job file, the solver's process, and its motion as a new action."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from ..bake.solved_takes import Provenance, add_take, body_mesh
from ..body.shape import get_betas
from ..errors import AddonError, TakeMissing
from ..files.body_choice import body_path_of
from ..files.body_file import read_body
from ..files.motion_file import read_motion
from ..review.pinning import Stretch, resolve_of
from ..solving.job_file import Job, write_job
from ..solving.places import next_take
from .following import FollowsRun, current
from .locations import files_folder


class _Solves(FollowsRun):
    """What solving a take and solving a stretch of it have in common."""

    def solve(self, context: bpy.types.Context, stretch: Stretch | None) -> set[str]:
        """Write the job and start the solver."""
        scene = context.scene
        try:
            job, path = prepare_job(scene, stretch)
            write_job(path, job)
            self._provenance = Provenance(job.out, job.capture, job.report, path)
            return self.launch(context, "solve", ["--job", str(path)], path.parent)
        except AddonError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def received(self, context: bpy.types.Context, result: dict[str, Any]) -> set[str]:
        """Bake the motion as a new action."""
        action = take_motion(context, self._provenance)
        doubtful = result["unseen_frames"] + result["unsure_frames"]
        look = f"; {doubtful} frames deserve a look" if doubtful else ""
        self.report({"INFO"}, f"Solved '{action.name}' in {result['solve_s']:.1f} s{look}")
        return {"FINISHED"}


class MOCAP_OT_solve(_Solves, bpy.types.Operator):
    """Solves the capture into a new take."""

    bl_idname = "mocap.solve"
    bl_label = "Solve"
    bl_description = "Solve the capture in a process of its own; the motion arrives as a new action, older takes stay"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a capture."""
        if not context.scene.mocap.capture.file:
            cls.poll_message_set("Import a capture first")
            return False
        return super().poll(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        return self.solve(context, None)


class MOCAP_OT_resolve_range(_Solves, bpy.types.Operator):
    """Solves a stretch of the current take again."""

    bl_idname = "mocap.resolve_range"
    bl_label = "Solve Range Again"
    bl_description = "Solve the frames from First to Last again, with the pinned poses kept; the rest stays as it is"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a solved take."""
        if current_take(context.scene) is None:
            cls.poll_message_set("Solve the capture first")
            return False
        return super().poll(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        take = current_take(context.scene)
        assert take is not None
        review = context.scene.mocap.review
        pins = tuple((pin.frame, pin.job_values) for pin in review.pins)
        return self.solve(context, Stretch(take, review.first, review.last, pins))


def current_take(scene: bpy.types.Scene) -> bpy.types.Action | None:
    """Return the solved action the scene's body plays now."""
    armature = scene.mocap.review.armature
    animation = armature.animation_data if armature is not None else None
    action = animation.action if animation is not None else None
    return action if action is not None and "motion_file" in action else None


def prepare_job(scene: bpy.types.Scene, stretch: Stretch | None) -> tuple[Job, Path]:
    """Return the job of the scene's settings and the path it is to be written to.

    Raises:
        OutputNotWritable: takes cannot be written where they should go.
        TakeMissing: the capture, or the motion to solve again, is no longer on the disk.
    """
    settings = scene.mocap
    capture = Path(settings.capture.file)
    if not capture.is_file():
        raise TakeMissing("The capture file is gone.", where=str(capture), hint="Import the capture again.")
    folder = capture.parent if _writable(capture.parent) else files_folder(scene) / capture.parent.name
    take = next_take(folder)
    values = settings.solve.values()
    mesh = body_mesh(settings.review.armature) if settings.review.armature is not None else None
    if mesh is not None and (settings.solve.keep_shape or stretch is not None):
        values["betas"] = [round(float(v), 6) for v in get_betas(mesh)]
    job = Job(capture=capture, out=take.motion, report=take.report if settings.solve.report else None, settings=values)
    if stretch is not None:
        job = replace(job, resolve=resolve_of(stretch, scene))
    return job, take.job


def take_motion(context: bpy.types.Context, files: Provenance) -> bpy.types.Action:
    """Add the solved motion to the scene.

    Raises:
        AddonError: the motion or the body cannot be read, or do not belong together.
    """
    scene, settings = context.scene, context.scene.mocap
    motion = read_motion(files.motion)
    armature = settings.review.armature
    if armature is None and context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    name = f"{settings.capture.name} {files.motion.stem.replace('_', ' ')}"
    body = read_body(body_path_of(motion.provenance))
    parent = settings.capture.collection
    armature, action = add_take(scene, name, motion, body, armature, parent, settings.capture.frame_start)
    files.write(action)
    settings.review.armature = armature
    return action


class MOCAP_OT_show_log(bpy.types.Operator):
    """Shows what the solver said."""

    bl_idname = "mocap.show_log"
    bl_label = "Show Log"
    bl_description = "Show what the solver said, as a text in a window of its own"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a run."""
        return current.run is not None or current.last is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the log into a text and open it."""
        text = write_log()
        if not bpy.app.background:
            bpy.ops.wm.window_new()
            area = context.window_manager.windows[-1].screen.areas[0]
            area.type = "TEXT_EDITOR"
            area.spaces.active.text = text
        return {"FINISHED"}


def write_log() -> bpy.types.Text:
    """Write the log of the run under way, or of the last one, into a text of the file."""
    run = current.run or current.last
    assert run is not None
    text = next((text for text in bpy.data.texts if "mocap_log" in text), None)
    if text is None:
        text = bpy.data.texts.new("MoCap Log")
        text["mocap_log"] = True
    text.clear()
    text.write("\n".join(run.log) + "\n")
    return text


def _writable(folder: Path) -> bool:
    try:
        probe = folder / ".probe"
        probe.touch()
        probe.unlink()
    except OSError:
        return False
    return True
